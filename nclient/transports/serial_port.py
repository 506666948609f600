"""Bytes over a serial port: a cable, a USB adapter, a radio modem, or the pseudo-terminal of an emulated robot.

    8 data bits, no parity, 1 stop bit, no flow control; one program at a time (flock, as other serial programs do)

Rules: the only room that imports serial. What the port has against being opened is said with its remedy; what breaks
later (unplugged, the other end of a pseudo-terminal gone) is ConnectionLost. The port's own time-out stays as it is
set at first, and `receive` counts slices of it: to change it costs a question to the driver each time.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import serial
from serial.tools import list_ports

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.byte_stream import Deadline

DEFAULT_BAUD = 38400
WRITE_TIMEOUT_S = 5.0
"""How long the port may take to swallow a request (a host's longest takes 70 ms at 38400 baud)."""
_SLICE_S = 0.02
"""How far past its deadline a wait may run."""
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
        self._reading = threading.Lock()
        try:
            self._port = serial.Serial(
                port, baud, timeout=_SLICE_S, write_timeout=WRITE_TIMEOUT_S, exclusive=True, xonxoff=False, rtscts=False
            )
        except _TROUBLE as error:
            raise ConnectionLost(_remedy(port, baud, error)) from error

    def send(self, data: bytes) -> None:
        """Send all of it. Raises ConnectionLost."""
        try:
            self._port.write(data)
        except OSError as error:
            raise self._lost(error) from error

    def receive(self, deadline: Deadline) -> bytes:
        """What has come, at least one byte. Raises ReplyTimeout at the deadline, ConnectionLost when it is gone."""
        with self._reading:
            while True:
                data = self._read(wait=deadline.remaining() > 0)
                if data:
                    return data
                if self._closed:
                    raise ConnectionLost(f"{self.name}: this end has closed the port")
                if not deadline.remaining():
                    raise ReplyTimeout(f"{self.name} was silent")

    def close(self) -> None:
        """Close the port; what waits in `receive` on another thread ends with ConnectionLost. Twice is fine."""
        self._closed = True
        with contextlib.suppress(OSError, TypeError, AttributeError):  # closed already; or no such call on this system
            self._port.cancel_read()
        with self._reading, contextlib.suppress(OSError):
            self._port.close()

    def _read(self, *, wait: bool) -> bytes:
        """What is there; where that is nothing, what comes within a slice. Empty when nothing does."""
        try:
            size = self._port.in_waiting
            if size or not wait:
                return bytes(self._port.read(size)) if size else b""
            first = bytes(self._port.read(1))
            return first + bytes(self._port.read(self._port.in_waiting)) if first else b""
        except (OSError, TypeError) as error:  # TypeError: pyserial's, of a port closed under its read
            raise self._lost(error) from error

    def _lost(self, error: Exception) -> ConnectionLost:
        if self._closed:
            return ConnectionLost(f"{self.name}: this end has closed the port")
        return ConnectionLost(f"{self.name} is gone ({error}); is the cable in, and the robot's line still there?")


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
