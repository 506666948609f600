"""A pseudo-terminal behind a stable symbolic link: the port of a simulated robot's serial line. POSIX only.

    PATH -> /dev/pts/7 (the host's end)        fd (the server's end, raw, non-blocking)

A file at PATH that is no symbolic link is not replaced, nor is a link that another running server uses; a link left by
a killed server is replaced. Until then the system may give the number of its terminal to another program, and a client
that reconnects would write to that one: remove such a link if no server is started again.

Only the server's end stays open here: the system reports a hang-up (EIO, POLLHUP) when the last host closes its end. A
host that opens the link immediately after another closed it, before the server has seen the hang-up, is not recognised
as a new host.

A host that sets another baud rate than the robot's gets nonsense, and the robot gets nothing of it, as on a cable. A
change of the rate is noticed within 2 ms, less than a request and its reply take on a cable at usual rates.
"""

import contextlib
import errno
import hashlib
import os
import select
import socket
import sys
import termios
import time
import tty
from pathlib import Path
from typing import Final

from nclient.errors import ConnectionLost

DEFAULT_BAUD: Final = 38400
"""Baud rate of the robot's line."""
_INPUT_SPEED, _OUTPUT_SPEED = 4, 5  # places in the settings of termios
# To read the baud rate takes as long as to read a request.
_BAUD_CHECK_INTERVAL_S: Final = 0.002


class PseudoTerminal:
    """A pseudo-terminal with a symbolic link to the host's end.

    Raises
    ------
    ConnectionLost
        If it cannot be created; the message names the remedy.
    """

    def __init__(self, path: Path, bauds: tuple[int, ...] = (DEFAULT_BAUD,)) -> None:
        self.path = path
        # Speeds as termios numbers them; it has no numbers for unusual ones.
        self._speeds = {getattr(termios, f"B{baud}", None) for baud in bauds}
        self._claim = _claim(path)
        # The server's end, -1 while closed.
        self.fd = -1
        # Path of the host's end.
        self.device = ""
        # True if the host's baud rate was the robot's when last checked, and the time from which it is checked again.
        self._is_own_baud = True
        self._next_baud_check_s = 0.0
        self._poll = select.poll()
        try:
            self._open()
        except ConnectionLost:
            self.close()
            raise
        except OSError as error:
            self.close()
            raise ConnectionLost(f"cannot make the serial link {path}: {error.strerror}") from error

    @property
    def is_closed(self) -> bool:
        """True if no host has the other end open."""
        return any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def read(self, max_bytes: int) -> bytes | None:
        """Return bytes from the host, empty if there are none yet, None if the host closed its end."""
        try:
            data = os.read(self.fd, max_bytes)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return None
        if not self._has_own_baud():
            self.write(data)
            return b""
        return data

    def write(self, data: bytes) -> int:
        """Write as much as the host's buffer takes and return the number of bytes; without a host all is discarded."""
        try:
            return os.write(self.fd, data if self._has_own_baud() else _nonsense(data))
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)

    def reset(self) -> None:
        """Discard what a host has not read and restore raw mode, after it closed its end."""
        self._next_baud_check_s = 0.0
        other = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            self._set_raw(other)
            termios.tcflush(other, termios.TCIFLUSH)
        finally:
            os.close(other)

    def replace(self) -> None:
        """Hang up on the host, as an unplugged adapter does, and put a new pseudo-terminal behind the link."""
        old, self.fd = self.fd, -1
        self._poll.unregister(old)
        try:
            self._open()
        finally:
            # Not before the link leads to the new one: another program may get the number of a closed terminal.
            os.close(old)

    def restore_link(self) -> bool:
        """Create the link again if it was removed; return True if so."""
        if not os.path.lexists(self.path):
            with contextlib.suppress(OSError):
                _link(self.path, self.device)
                return True
        return False

    def close(self) -> None:
        """Close both and remove the link if it is still this one's; idempotent."""
        if self.fd >= 0:
            with contextlib.suppress(OSError):
                if self.path.readlink() == Path(self.device):
                    self.path.unlink()
            self._release()
        if self._claim is not None:
            self._claim.close()

    def _open(self) -> None:
        fd, other = os.openpty()
        try:
            self.device = os.ttyname(other)
            self._set_raw(other)
            os.set_blocking(fd, False)
            _link(self.path, self.device)
        except BaseException:
            os.close(fd)
            raise
        finally:
            # The host's end is opened by hosts only: an own descriptor would hide their hang-up.
            os.close(other)
        self.fd = fd
        self._next_baud_check_s = 0.0
        self._poll.register(fd, select.POLLIN)

    def _has_own_baud(self) -> bool:
        """Return True if the host has set a baud rate of the robot, which both ends of a pseudo-terminal show."""
        now_s = time.monotonic()
        # A host with a wrong rate may correct it and send at once.
        if now_s >= self._next_baud_check_s or not self._is_own_baud:
            self._next_baud_check_s = now_s + _BAUD_CHECK_INTERVAL_S
            # If the terminal has gone, the caller's next access reports it.
            with contextlib.suppress(termios.error):
                self._is_own_baud = termios.tcgetattr(self.fd)[_OUTPUT_SPEED] in self._speeds
        return self._is_own_baud

    @staticmethod
    def _set_raw(file: int) -> None:
        """Set raw mode and the robot's baud rate: hosts that set none find the port so."""
        tty.setraw(file, termios.TCSANOW)
        settings = termios.tcgetattr(file)
        settings[_INPUT_SPEED] = settings[_OUTPUT_SPEED] = termios.B38400
        termios.tcsetattr(file, termios.TCSANOW, settings)

    def _release(self) -> None:
        self._poll.unregister(self.fd)
        os.close(self.fd)
        self.fd = -1


def _nonsense(data: bytes) -> bytes:
    """Return what bytes look like at another baud rate: as many others, none of which begins a frame."""
    return bytes(0x80 | (byte * 167 + 73 * k) & 0xFF for k, byte in enumerate(data))


def _link(path: Path, device: str) -> None:
    """Point the link to a device atomically: a host that opens it meanwhile gets the old or the new end."""
    if os.path.lexists(path) and not path.is_symlink():
        raise ConnectionLost(f"{path} exists and is no symbolic link; choose another path, or move it away")
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    temporary.unlink(missing_ok=True)
    temporary.symlink_to(device)
    temporary.replace(path)


def _claim(path: Path) -> socket.socket | None:
    """Reserve the path until this process ends, however it ends (an abstract Unix socket; Linux only)."""
    if sys.platform != "linux":
        return None
    name = hashlib.sha256(os.fsencode(path.parent.resolve() / path.name)).hexdigest()
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0nserver {name}")
    except OSError as error:
        claim.close()
        raise ConnectionLost(f"{path} is the serial line of another running nserver; choose another path") from error
    return claim
