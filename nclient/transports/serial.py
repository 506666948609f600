"""A serial port as a byte stream: a cable, a USB adapter, a radio modem, or the pseudo-terminal of an emulated robot.

    SerialStream            Linux: pyserial opens the port, poll() and the file descriptor take half the time
    PortableSerialStream    Windows, macOS, and ports of other machines: a thread and pyserial's own read and write

8 data bits, no parity, 1 stop bit, no flow control. Access is exclusive (flock, as other serial programs do); ports of
other machines are `rfc2217://host:port` and `socket://host:port`, as ser2net serves them.
This is the only module that imports serial.
"""

import contextlib
import errno
import os
import selectors
import sys
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import serial
from serial.tools import list_ports

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import ByteStream, Deadline

DEFAULT_BAUD: Final = 38400
WRITE_TIMEOUT_S: Final = 5.0
"""Maximum time to write a request; the longest one takes 70 ms at 38400 baud."""
_CHUNK: Final = 65536
_READ_SLICE_S: Final = 0.2
"""Longest read of the portable stream: `close` waits for it where a system cannot cancel it."""
_MAX_UNREAD: Final = 1 << 16
"""Unread bytes of the portable stream; further ones are dropped, as a terminal of the system does from 4096 on."""
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
                raise _closed_here(self.name)
            try:
                # The port nearly always takes everything at once; pyserial waits for the rest.
                sent = self._write_available(data)
                if sent < len(data):
                    self._port.write(data[sent:])
            except OSError as error:
                raise _lost(self.name, error) from error

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
            raise _closed_here(self.name)

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
            raise _lost(self.name, error) from error
        if not data:
            raise _lost(self.name, "it has ended")
        return data

    def _write_available(self, data: bytes) -> int:
        try:
            return os.write(self._file, data)
        except BlockingIOError:
            return 0


class PortableSerialStream:
    """An open serial port by pyserial's means alone: a thread reads, without termios, poll() and file descriptors.

    Parameters
    ----------
    port
        Name of the port, or a URL of pyserial.
    baud
        Bits per second. A raw socket has none.

    Raises
    ------
    ConnectionLost
        If the port cannot be opened; the message has the reason and a remedy.
    """

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self.name = port
        # pyserial has no lock for ports of other machines; rfc2217 has the write timeout of its socket, 5 s.
        more: dict[str, Any] = {} if port.startswith("rfc2217:") else {"write_timeout": WRITE_TIMEOUT_S}
        more |= {} if "://" in port else {"exclusive": True}
        # Without waiting for answers about flow control, which ser2net leaves out.
        url = f"{port}?ign_set_control" if port.startswith("rfc2217:") else port
        try:
            with warnings.catch_warnings():
                # pyserial's rfc2217 calls Thread.setDaemon.
                warnings.simplefilter("ignore", DeprecationWarning)
                self._port = serial.serial_for_url(url, baud, timeout=_READ_SLICE_S, **more)
        except _OPEN_ERRORS as error:
            raise ConnectionLost(_remedy(port, baud, error)) from error
        self._writing, self._arrived = threading.Lock(), threading.Condition()
        self._received = bytearray()
        self._failure: Exception | None = None
        self._closed = False
        self._reader = threading.Thread(target=self._read_all, name=f"serial {port}", daemon=True)
        self._reader.start()

    def send(self, data: bytes) -> None:
        """Send all bytes. Raises ConnectionLost."""
        with self._writing:
            if self._closed:
                raise _closed_here(self.name)
            try:
                self._port.write(data)
            except OSError as error:
                raise _lost(self.name, error) from error

    def receive(self, deadline: Deadline) -> bytes:
        """Return at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost if the port has gone."""
        with self._arrived:
            self._arrived.wait_for(self._has_news, deadline.remaining())
            if self._closed:
                raise _closed_here(self.name)
            if self._received:
                data = bytes(self._received)
                self._received.clear()
                return data
            if self._failure is not None:
                raise _lost(self.name, self._failure)
            raise ReplyTimeout(f"{self.name} was silent")

    def close(self) -> None:
        """Close the port; a `receive` in another thread ends with ConnectionLost. May be called twice."""
        with self._arrived:
            if self._closed:
                return
            self._closed = True
            self._arrived.notify_all()
        # The reader ends first: closing a port while it is read from is not safe on every system.
        if cancel := getattr(self._port, "cancel_read", None):
            with contextlib.suppress(OSError):
                cancel()
        self._reader.join()
        with self._writing, contextlib.suppress(OSError):
            # pyserial does not close a socket whose other end has gone.
            link = getattr(self._port, "_socket", None)
            self._port.close()
            if link is not None:
                link.close()

    def _has_news(self) -> bool:
        return bool(self._received) or self._closed or self._failure is not None

    def _read_all(self) -> None:
        """Read until the port is closed or fails; the read's own timeout looks after a missed cancel."""
        while not self._closed:
            try:
                # The first byte, and what has come with it.
                data = self._port.read(1)
                if data and (waiting := self._port.in_waiting):
                    data += self._port.read(waiting)
            except (*_OPEN_ERRORS, AttributeError, TypeError) as error:  # also those of pyserial after a loss
                with self._arrived:
                    self._failure = error
                    self._arrived.notify_all()
                return
            if data:
                with self._arrived:
                    self._received += data[: _MAX_UNREAD - len(self._received)]
                    self._arrived.notify_all()


def _lost(port: str, reason: Exception | str) -> ConnectionLost:
    return ConnectionLost(f"{port} is gone ({reason}); is the cable in, and the robot's line still there?")


def _closed_here(port: str) -> ConnectionLost:
    return ConnectionLost(f"{port}: this end has closed the port")


def open_port(port: str, baud: int = DEFAULT_BAUD) -> ByteStream:
    """Open a port by its name or a URL of pyserial. Raises ConnectionLost as the streams do."""
    return PortableSerialStream(port, baud) if needs_portable(port) else SerialStream(port, baud)


def needs_portable(port: str) -> bool:
    """Return True for ports of other machines, and on systems whose poll() does not support terminals."""
    return "://" in port or sys.platform != "linux"


def ports() -> list[str]:
    """Return the device names of this machine's serial ports."""
    return [found.device for found in list_ports.comports()]


def _remedy(port: str, baud: int, error: Exception) -> str:
    """Return why a port cannot be opened, and what to do about it."""
    number = getattr(error, "errno", None)
    message = str(error)
    if "://" in port:
        return f"{port} cannot be opened: {message}; is ser2net, or another server of the port, running there?"
    if number == errno.ENOENT:
        there = ", ".join(ports()) or "none at all"
        return f"there is no port {port}; is the adapter plugged in? Ports there are: {there}"
    if number == errno.EACCES and "lock" not in message:
        return f"no permission to open {port}; most often the group dialout may: `sudo usermod -aG dialout $USER`"
    if "lock" in message or number in _BUSY:
        programs = ", ".join(users(port)) or "another program"
        return f"{port} is in use by {programs}; one program at a time can talk to a robot"
    if isinstance(error, (ValueError, OverflowError)):
        return f"{port} cannot be opened at {baud} baud: {message}"
    return f"{port} cannot be opened: {message}"


def users(port: str) -> Iterator[str]:
    """Yield name and process id of the programs that have the port open, as far as this user may see them."""
    device, own = os.path.realpath(port), str(os.getpid())
    for process in _PROCESSES.glob("[0-9]*"):
        # Processes end while they are listed, and those of other users are not readable.
        with contextlib.suppress(OSError):
            if any(os.path.realpath(link) == device for link in (process / "fd").iterdir()):
                name = (process / "comm").read_text().strip()
                yield "this very program" if process.name == own else f"{name} (process {process.name})"
