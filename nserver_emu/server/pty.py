"""Who opened and closed a file, in the order in which it happened, as Linux' inotify tells it.

    opened, closed, opened     ──>   changed() is True once: those who had it open are all gone, and somebody else came

Rules: the system notes an opening before whoever opened can write, and a closing before the file is let go. So who
reads the file first, and then asks here, never takes the next one's bytes for the last one's. Two openings, or two
closings, between two looks can be told as one: the first may make a change too many, the second hides one, until
`forget`. Elsewhere than on Linux nothing is told.

A pseudo-terminal behind a stable symbolic link: the port of an emulated robot's own line. POSIX only.

    PATH ──> /dev/pts/7 (the host's end)        fd (our end, raw, never blocks)

Rules: what is at PATH and is no symbolic link stays; a link that another daemon serves stays too, one that a killed
daemon left is replaced. Only our end is kept open, since the system tells that all hosts have left only then; whether
another came at once is comings.py's to tell.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import logging
import os
import select
import socket
import sys
import termios
import tty
from pathlib import Path
from typing import Final

from nclient.errors import ConnectionLost

log = logging.getLogger(__name__)

_CLOSED_WRITE, _CLOSED, _OPENED, _LOST = 0x8, 0x10, 0x20, 0x4000
_FIELDS: Final = 4
"""Of 32 bits in each notice: watch, event, cookie, length of a name, which is 0 where a file is watched."""
_NOTICES: Final = 65536
"""Bytes of what is told at once."""


class Comings:
    """See the head of this file. `fd` is readable when there is something to ask for; -1 where nothing is told."""

    def __init__(self) -> None:
        self.fd = -1
        self._watch = -1
        self._present = 0
        self._deserted = self._changed = False
        if sys.platform == "linux":
            self._libc = ctypes.CDLL(None, use_errno=True)
            self.fd = self._libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
            if self.fd < 0:
                log.warning("a host that comes at once after another will not be told from it: %s; "
                            "fs.inotify.max_user_instances may be too small", os.strerror(ctypes.get_errno()))

    def watch(self, path: str) -> None:
        """From now on it is about this file, which nobody has open."""
        self.forget()
        if self.fd >= 0:
            events = _CLOSED_WRITE | _CLOSED | _OPENED
            self._watch = self._libc.inotify_add_watch(self.fd, os.fsencode(path), events)

    def changed(self) -> bool:
        """Whether all who had it open are gone and somebody else came, since this was asked last."""
        self._look()
        changed, self._changed = self._changed, False
        return changed

    def forget(self) -> None:
        """Nobody has it open; whatever was told before is of no interest."""
        self._look()
        self._present = 0
        self._deserted = self._changed = False

    def close(self) -> None:
        """The end; twice is fine."""
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1

    def _look(self) -> None:
        if self.fd < 0:
            return
        try:
            told = os.read(self.fd, _NOTICES)
        except BlockingIOError:
            return
        fields = memoryview(told).cast("i")
        for watch, event in zip(fields[::_FIELDS], fields[1::_FIELDS], strict=True):
            if event & _LOST:
                self._changed = True
            elif watch == self._watch:
                self._note(event)

    def _note(self, event: int) -> None:
        if event & _OPENED:
            self._changed |= self._deserted
            self._deserted = False
            self._present += 1
        elif event & (_CLOSED | _CLOSED_WRITE):
            self._present = max(0, self._present - 1)
            self._deserted = not self._present


class PseudoTerminal:
    """See the head of this file. Raises ConnectionLost where it cannot be made, naming the remedy."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._claim = _claim(path)
        self.fd = -1
        self.device = ""
        """The host's end."""
        self.comings = Comings()
        """Who opened and closed the host's end."""
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
    def deserted(self) -> bool:
        """Whether no host has the other end open."""
        return any(event & select.POLLHUP for _, event in self._poll.poll(0))

    def read(self, most: int) -> bytes | None:
        """What a host has sent; none: not yet. None: the host has left."""
        try:
            return os.read(self.fd, most)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno != errno.EIO:
                raise
            return None

    def write(self, data: bytes) -> int:
        """Send as much as the host's end takes at once; how much that was. What nobody is there for is lost."""
        try:
            return os.write(self.fd, data)
        except BlockingIOError:
            return 0
        except OSError:
            return len(data)

    def clean(self) -> None:
        """After a host has left: what it did not read is gone, and its settings too."""
        other = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            tty.setraw(other, termios.TCSANOW)
            termios.tcflush(other, termios.TCIFLUSH)
        finally:
            os.close(other)
        self.comings.forget()

    def flush(self) -> None:
        """After a host has left and another came: what the first did not read is gone."""
        other = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        try:
            termios.tcflush(other, termios.TCIFLUSH)
        finally:
            os.close(other)

    def pull(self) -> None:
        """Unplug it, as far as the host can tell, and plug in another behind the same link."""
        self._let_go()
        self._open()

    def restore_link(self) -> bool:
        """Whether the link had been removed, and is there again."""
        if os.path.lexists(self.path):
            return False
        try:
            _link(self.path, self.device)
        except OSError:
            return False
        return True

    def close(self) -> None:
        """The end: the link goes too, if it is still ours. Twice is fine."""
        if self.fd >= 0:
            with contextlib.suppress(OSError):
                if self.path.readlink() == Path(self.device):
                    self.path.unlink()
            self._let_go()
        self.comings.close()
        if self._claim is not None:
            self._claim.close()

    def _open(self) -> None:
        fd, other = os.openpty()
        try:
            self.device = os.ttyname(other)
            tty.setraw(other, termios.TCSANOW)
            os.set_blocking(fd, False)
            _link(self.path, self.device)
        except BaseException:
            os.close(fd)
            raise
        finally:
            os.close(other)
        self.comings.watch(self.device)
        self.fd = fd
        self._poll.register(fd, select.POLLIN)

    def _let_go(self) -> None:
        self._poll.unregister(self.fd)
        os.close(self.fd)
        self.fd = -1


def _link(path: Path, device: str) -> None:
    """Let the link point there; whoever follows it meanwhile finds the old end or the new one."""
    if os.path.lexists(path) and not path.is_symlink():
        raise ConnectionLost(f"{path} is there and no symbolic link: it stays; name another path, or move it away")
    unfinished = path.with_name(f".{path.name}.{os.getpid()}")
    unfinished.unlink(missing_ok=True)
    unfinished.symlink_to(device)
    unfinished.replace(path)


def _claim(path: Path) -> socket.socket | None:
    """What tells other daemons that the path is served, until this process ends, however it ends; Linux only."""
    if sys.platform != "linux":
        return None
    name = hashlib.sha256(os.fsencode(path.parent.resolve() / path.name)).hexdigest()
    claim = socket.socket(socket.AF_UNIX)
    try:
        claim.bind(f"\0nserver {name}")
    except OSError as error:
        claim.close()
        raise ConnectionLost(f"{path} is the line of another nserver that runs; name another path") from error
    return claim
