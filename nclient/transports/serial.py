"""A serial port as a byte stream: a cable, a USB adapter, a radio modem, or the pseudo-terminal of an emulated robot.

8 data bits, no parity, 1 stop bit, no flow control. Access is exclusive (flock, as other serial programs do).
pyserial opens and configures the port; bytes are then read and written through its file descriptor, which takes half
the time and needs a system whose poll() supports terminals. This is the only module that imports serial.
"""

import contextlib
import errno
import os
import selectors
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import serial
from serial.tools import list_ports

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import Deadline

DEFAULT_BAUD: Final = 38400
WRITE_TIMEOUT_S: Final = 5.0
"""Maximum time to write a request; the longest one takes 70 ms at 38400 baud."""
_CHUNK: Final = 65536
_BUSY: Final = frozenset({errno.EAGAIN, errno.EBUSY, errno.EACCES})
_PROCESSES: Final = Path("/proc")
if sys.platform == "win32":
    _OPEN_ERRORS: tuple[type[Exception], ...] = (OSError, ValueError, OverflowError)
else:
    import termios

    # termios.error: the port disappears while it is opened.
    _OPEN_ERRORS = (OSError, ValueError, OverflowError, termios.error)


class SerialStream:
    """An open serial port.

    Parameters
    ----------
    port
        Path of the device.
    baud
        Bits per second.

    Raises
    ------
    ConnectionLost
        If the port cannot be opened; the message has the reason and a remedy.
    """

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self.name = port
        self._closed = False
        self._reading, self._writing = threading.Lock(), threading.Lock()
        try:
            self._port = serial.Serial(port, baud, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except _OPEN_ERRORS as error:
            raise ConnectionLost(_remedy(port, baud, error)) from error
        self._file = self._port.fileno()
        # `close` writes to this pipe, which wakes a `receive` in another thread.
        self._wake_reader, self._wake_writer = os.pipe()
        # poll(): select() does not support file descriptors above 1023.
        self._selector = selectors.PollSelector()
        for file in (self._file, self._wake_reader):
            self._selector.register(file, selectors.EVENT_READ)

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises ConnectionLost."""
        with self._writing:
            if self._closed:
                raise self._closed_here()
            try:
                # The port nearly always takes everything at once; pyserial waits for the rest.
                sent = self._write_available(data)
                if sent < len(data):
                    self._port.write(data[sent:])
            except OSError as error:
                raise self._lost(error) from error

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost if the port has gone."""
        with self._reading:
            while not self._closed:
                wait_s = deadline.remaining()
                ready = [key.fd for key, _ in self._selector.select(wait_s)]
                if self._file in ready:
                    return self._read()
                if not ready and wait_s <= 0:
                    raise ReplyTimeout(f"{self.name} was silent")
            raise self._closed_here()

    def close(self) -> None:
        """Close the port; a `receive` in another thread ends with ConnectionLost. May be called twice."""
        # Wake a reader first: it has the lock that is taken below.
        if self._closed:
            return
        self._closed = True
        os.write(self._wake_writer, b"x")
        # Both locks: no other thread uses the file descriptors any more when they are closed.
        with self._reading, self._writing:
            self._selector.close()
            self._port.close()
            os.close(self._wake_writer)
            os.close(self._wake_reader)

    def _read(self) -> bytes:
        try:
            data = os.read(self._file, _CHUNK)
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost("it has ended")
        return data

    def _write_available(self, data: bytes) -> int:
        try:
            return os.write(self._file, data)
        except BlockingIOError:
            return 0

    def _lost(self, reason: OSError | str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} is gone ({reason}); is the cable in, and the robot's line still there?")

    def _closed_here(self) -> ConnectionLost:
        return ConnectionLost(f"{self.name}: this end has closed the port")


def ports() -> list[str]:
    """Return the device names of this machine's serial ports."""
    return [found.device for found in list_ports.comports()]


def _remedy(port: str, baud: int, error: Exception) -> str:
    """Return why a port cannot be opened, and what to do about it."""
    number = getattr(error, "errno", None)
    message = str(error)
    if number == errno.ENOENT:
        there = ", ".join(ports()) or "none at all"
        return f"there is no port {port}; is the adapter plugged in? Ports there are: {there}"
    if number == errno.EACCES and "lock" not in message:
        return f"no permission to open {port}; most often the group dialout may: `sudo usermod -aG dialout $USER`"
    if "lock" in message or number in _BUSY:
        users = ", ".join(_users(port)) or "another program"
        return f"{port} is in use by {users}; one program at a time can talk to a robot"
    if isinstance(error, (ValueError, OverflowError)):
        return f"{port} cannot be opened at {baud} baud: {message}"
    return f"{port} cannot be opened: {message}"


def _users(port: str) -> Iterator[str]:
    """Yield name and process id of the programs that have the port open, as far as this user may see them."""
    device, own = os.path.realpath(port), str(os.getpid())
    for process in _PROCESSES.glob("[0-9]*"):
        # Processes end while they are listed, and those of other users are not readable.
        with contextlib.suppress(OSError):
            if any(os.path.realpath(link) == device for link in (process / "fd").iterdir()):
                name = (process / "comm").read_text().strip()
                yield "this very program" if process.name == own else f"{name} (process {process.name})"
