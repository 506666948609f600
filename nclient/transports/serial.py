"""Bytes over a serial port: a cable, a USB adapter, a radio modem, or the pseudo-terminal of an emulated robot.

    8 data bits, no parity, 1 stop bit, no flow control; one program at a time (flock, as other serial programs do)

Rules: the only room that imports serial. What the port has against being opened is said with its remedy; what breaks
later (unplugged, the other end of a pseudo-terminal gone) is ConnectionLost. pyserial opens the port and sets it up;
bytes are read and written as any file's, which costs half as much and needs a system that has poll for them.
"""

from __future__ import annotations

import contextlib
import errno
import os
import selectors
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import serial
from serial.tools import list_ports

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import Deadline

DEFAULT_BAUD = 38400
WRITE_TIMEOUT_S = 5.0
"""How long the port may take to swallow a request (a host's longest takes 70 ms at 38400 baud)."""
_CHUNK = 65536
_BUSY = frozenset({errno.EAGAIN, errno.EBUSY, errno.EACCES})
_PROCESSES = Path("/proc")
if sys.platform == "win32":
    _TROUBLE: tuple[type[Exception], ...] = (OSError, ValueError, OverflowError)
else:
    import termios

    _TROUBLE = (OSError, ValueError, OverflowError, termios.error)
    """What opening a port raises; the last where the port goes away meanwhile."""


class SerialStream:
    """An open port. Raises ConnectionLost where it cannot be opened: which port, why, and what helps."""

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self.name = port
        self._closed = False
        self._reading, self._writing = threading.Lock(), threading.Lock()
        try:
            self._port = serial.Serial(port, baud, write_timeout=WRITE_TIMEOUT_S, exclusive=True)
        except _TROUBLE as error:
            raise ConnectionLost(_remedy(port, baud, error)) from error
        self._file = self._port.fileno()
        self._woken, self._wake = os.pipe()
        self._waiting = selectors.PollSelector()  # select() knows no file beyond the 1024th
        for file in (self._file, self._woken):
            self._waiting.register(file, selectors.EVENT_READ)

    def send(self, data: bytes) -> None:
        """Send all of it. Raises ConnectionLost."""
        with self._writing:
            if self._closed:
                raise self._left()
            try:
                sent = self._write(data)
                if sent < len(data):
                    self._port.write(data[sent:])
            except OSError as error:
                raise self._lost(error) from error

    def receive(self, deadline: Deadline) -> bytes:
        """What has come, at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost when it is gone."""
        with self._reading:
            while not self._closed:
                wait_s = deadline.remaining()
                ready = [key.fd for key, _ in self._waiting.select(wait_s)]
                if self._file in ready:
                    return self._read()
                if not ready and wait_s <= 0:
                    raise ReplyTimeout(f"{self.name} was silent")
            raise self._left()

    def close(self) -> None:
        """Close the port; what waits in `receive` on another thread ends with ConnectionLost. Twice is fine."""
        if self._closed:
            return
        self._closed = True
        os.write(self._wake, b"x")
        with self._reading, self._writing:
            self._waiting.close()
            self._port.close()
            os.close(self._wake)
            os.close(self._woken)

    def _read(self) -> bytes:
        try:
            data = os.read(self._file, _CHUNK)
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            raise self._lost("it has ended")
        return data

    def _write(self, data: bytes) -> int:
        """How much the port takes at once: nearly always all."""
        try:
            return os.write(self._file, data)
        except BlockingIOError:
            return 0

    def _lost(self, why: OSError | str) -> ConnectionLost:
        return ConnectionLost(f"{self.name} is gone ({why}); is the cable in, and the robot's line still there?")

    def _left(self) -> ConnectionLost:
        return ConnectionLost(f"{self.name}: this end has closed the port")


def _remedy(port: str, baud: int, error: Exception) -> str:
    """Why a port cannot be opened, and what helps."""
    number = getattr(error, "errno", None)
    said = str(error)
    if number == errno.ENOENT:
        there = ", ".join(ports()) or "none at all"
        return f"there is no port {port}; is the adapter plugged in? Ports there are: {there}"
    if number == errno.EACCES and "lock" not in said:
        return f"no permission to open {port}; most often the group dialout may: `sudo usermod -aG dialout $USER`"
    if "lock" in said or number in _BUSY:
        users = ", ".join(_users(port)) or "another program"
        return f"{port} is in use by {users}; one program at a time can talk to a robot"
    if isinstance(error, (ValueError, OverflowError)):
        return f"{port} cannot be opened at {baud} baud: {said}"
    return f"{port} cannot be opened: {said}"


def ports() -> list[str]:
    """The serial ports that this machine knows of."""
    return [found.device for found in list_ports.comports()]


def _users(port: str) -> Iterator[str]:
    """Who else has the port open, as far as this user may see: name and process id."""
    device, own = os.path.realpath(port), str(os.getpid())
    for process in _PROCESSES.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if any(os.path.realpath(link) == device for link in (process / "fd").iterdir()):
                name = (process / "comm").read_text().strip()
                yield "this very program" if process.name == own else f"{name} (process {process.name})"
