"""Addresses: from a line of text to a robot.

    nserver://host[:port]/id?timeout_s=2&model=scout     an Nserver over TCP; port 7019, robot 1, an N150 where left out
    sim:WORLD?robot=n150&seed=1&noisy=1                  the emulator in this process (whatever is installed for it)
    serial:///dev/ttyUSB0?model=n150&baud=38400          a robot on a cable, or an emulated one on a pseudo-terminal
    robotd://host[:port]?model=n200                      the same line over TCP; port 65001

Rules: what schemes and options there are stands in the two tables of nclient.schemes. What is wrong with an address
is said before anything is opened, with the nearest thing that would be right.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Generator
from types import TracebackType
from typing import Any

import nclient.address as text
from nclient.aio import AsyncRobot
from nclient.backends.base import Backend
from nclient.errors import AddressError, ConnectionLost
from nclient.protocol.types import MODELS
from nclient.robot import Robot
from nclient.schemes import Wanted, known_schemes, open_nserver, open_tcp, opening_of
from nclient.transports.tcp import TcpStream, names_of_this_machine

__all__ = ["Wanted", "address_or_default", "connect", "connect_async", "is_listening", "known_schemes", "open_backend",
           "open_line", "open_machine"]  # fmt: skip

DEFAULT_ADDRESS = "nserver://localhost:7019/1"
VARIABLE = "NOMAD_ROBOT"
"""The environment variable that names the default address."""


def connect(address: str | None = None, *, timeout_s: float | None = None) -> Robot:
    """A robot by its address; by NOMAD_ROBOT when none is given, else a local Nserver's first.

    `timeout_s`: how long an answer may take (5 s of a server, 1 s on a robot's own line where nothing is said);
    `timeout_s=` in the address wins. Where time runs by itself the robot's time-out of motion is set and fed, so that
    a program that is gone leaves a robot that stops (`tm_s=`, `feed=`). Raises AddressError, ConnectionLost,
    ReplyTimeout, RobotRefused (no robot of that number), or what an opener has against its world or start.
    """
    return Robot(open_backend(address, Wanted(timeout_s)))


def connect_async(address: str | None = None, *, timeout_s: float | None = None) -> Connecting:
    """The same for asyncio: `async with connect_async(address) as robot:`, or await it for a robot."""
    return Connecting(lambda: connect(address, timeout_s=timeout_s))


class Connecting:
    """A connection to come: await it, or enter it."""

    def __init__(self, opens: Callable[[], Robot]) -> None:
        self._opens = opens
        self._robot: AsyncRobot | None = None

    def __await__(self) -> Generator[Any, None, AsyncRobot]:
        return AsyncRobot.open(self._opens).__await__()

    async def __aenter__(self) -> AsyncRobot:
        self._robot = await self
        return await self._robot.__aenter__()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._robot is not None
        await self._robot.__aexit__(kind, error, trace)


def open_backend(address: str | None, wanted: Wanted) -> Backend:
    """What answers at an address, connected. Raises as `connect` does."""
    return opening_of(address_or_default(address), wanted).backend()


def address_or_default(address: str | None) -> str:
    """The address, or where none is given the one that NOMAD_ROBOT names, or a local Nserver's first robot."""
    return address or os.environ.get(VARIABLE) or DEFAULT_ADDRESS


def open_machine(name: str, port: int, wanted: Wanted) -> Backend:
    """What C programs name: a host, or host:port, which wins over `port`; or an address, as `open_backend` takes it.

    "" is NOMAD_ROBOT's address, as for a C program of today; where that says nothing, this machine.
    """
    address = _address_of(name)
    if address is None:
        return open_nserver(_find(name, port, wanted.timeout_s), wanted)
    try:
        return open_backend(address, wanted)
    except AddressError as error:
        raise error if name else AddressError(f"{VARIABLE}: {error}") from None


def open_line(model_number: int, device: str, conn: int, wanted: Wanted) -> Backend:
    """What C programs of the direct library name: a model's number, a device and its baud rate, or a host and its port.

    As that library: no time-out of motion set, nothing asked twice, nothing checked but the checksum.
    """
    models = {model.number: model.name for model in MODELS.values()}
    if model_number not in models:
        raise AddressError(f"a model's number is one of {', '.join(map(str, sorted(models)))}, not {model_number}")
    where = f"serial://{device}?baud={conn}&" if device.startswith("/") else f"robotd://{device}:{conn}?"
    bare = "&tm_s=0&retries=0&reconnect=0&checks=0"
    return open_backend(f"{where}model={models[model_number]}{bare}", wanted)


def is_listening(name: str, port: int) -> bool:
    """Whether there is somebody to connect to, with names as `open_machine` takes them."""
    try:
        address = _address_of(name)
        stream = _find(name, port, None) if address is None else opening_of(address, Wanted()).bare_stream()
    except (AddressError, ConnectionLost):
        return False
    stream.close()
    return True


def _find(name: str, port: int, timeout_s: float | None) -> TcpStream:
    """A stream to the host; where none is named, to the first name of this machine that answers."""
    host, colon, digits = name.rpartition(":")
    if colon and digits.isdecimal() and (":" not in host or host.endswith("]")):
        name, port = host.strip("[]"), int(digits)
    *others, last = (name,) if name else names_of_this_machine()
    for host in others:
        with contextlib.suppress(ConnectionLost):
            return open_tcp(host, port, timeout_s)
    return open_tcp(last, port, timeout_s)


def _address_of(name: str) -> str | None:
    """The address that a C program's machine is; None for a host, or where neither it nor NOMAD_ROBOT names any."""
    if not name:
        return os.environ.get(VARIABLE) or None
    return name if _is_address(name) else None


def _is_address(name: str) -> bool:
    """Whether it begins with a scheme: lab:7654 is a host and its port, whatever schemes there are."""
    return not name.partition(":")[2].isdecimal() and text.parsed(name).scheme in known_schemes()
