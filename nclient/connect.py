"""Addresses: from a line of text to a robot. The only file that knows every backend and every transport.

    nserver://host[:port]/id?timeout_s=2&model=scout     an Nserver over TCP; port 7019, robot 1, an N150 where left out
    sim:WORLD?robot=n150&seed=1&noisy=1                  the emulator in this process (whatever is installed for it)

Rules: a scheme is a row of _SCHEMES, or an entry point of something that answers in this process. What is wrong with
an address is said before anything is opened, with the nearest thing that would be right.
"""

from __future__ import annotations

import contextlib
import difflib
import math
import os
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from types import TracebackType
from typing import Any
from urllib.parse import SplitResult, parse_qsl, urlsplit

from nclient.async_robot import AsyncRobot
from nclient.backends.backend import Backend
from nclient.backends.nserver import DEFAULT_TIMEOUT_S, NserverBackend
from nclient.errors import AddressError, ConnectionLost
from nclient.protocol.models import N150, Model, model_named
from nclient.robot import Robot
from nclient.transports import memory
from nclient.transports.byte_stream import ByteStream
from nclient.transports.tcp import CONNECT_TIMEOUT_S, TcpStream, names_of_this_machine

DEFAULT_ADDRESS = "nserver://localhost:7019/1"
DEFAULT_PORT = 7019
VARIABLE = "NOMAD_ROBOT"
"""The environment variable that names the default address."""
_EXAMPLE = "such as nserver://localhost:7019/1 or sim:thesis_room"
_NSERVER_OPTIONS = ("timeout_s", "model")
_MAX_ID = 0x7FFFFFFF


@dataclass(frozen=True, slots=True)
class Wanted:
    """What whoever connects says besides the address: time-out (the address wins), robot by number, made if need be."""

    timeout_s: float = DEFAULT_TIMEOUT_S
    robot_id: int | None = None
    create: bool = False


def connect(address: str | None = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> Robot:
    """A robot by its address; by NOMAD_ROBOT when none is given, else a local Nserver's first.

    `timeout_s`: how long an answer may take; `timeout_s=` in the address wins. Raises AddressError, ConnectionLost,
    ReplyTimeout, RobotRefused (no robot of that number), or what an opener has against its world or start.
    """
    return Robot(open_backend(address, Wanted(timeout_s)))


def connect_async(address: str | None = None, *, timeout_s: float = DEFAULT_TIMEOUT_S) -> Connecting:
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
    text = (address or os.environ.get(VARIABLE) or DEFAULT_ADDRESS).strip()
    scheme, colon, _ = text.partition(":")
    scheme = scheme.lower()
    opener = _SCHEMES.get(scheme) if colon else None
    if opener is not None:
        return opener(text, wanted)
    if not colon or scheme not in memory.schemes():
        raise _no_scheme(text, scheme)
    return _in_process(text, scheme, wanted)


def open_machine(name: str, port: int, wanted: Wanted) -> Backend:
    """What C programs name: a host, "" for this machine, host:port, which wins over `port`; or an address."""
    if _is_address(name):
        return open_backend(name, wanted)
    return _open_nserver(_find(name, port, wanted.timeout_s), wanted)


def is_listening(name: str, port: int) -> bool:
    """Whether there is somebody to connect to, with names as `open_machine` takes them."""
    try:
        if not _is_address(name):
            stream = _find(name, port, CONNECT_TIMEOUT_S)
        elif name.lower().startswith("nserver:"):
            stream = _open_tcp(*_host_and_port(name), CONNECT_TIMEOUT_S)
        else:
            return True
    except (AddressError, ConnectionLost):
        return False
    stream.close()
    return True


def known_schemes() -> tuple[str, ...]:
    """The address schemes there are."""
    return tuple(sorted({*_SCHEMES, *memory.schemes()}))


def _nserver(text: str, wanted: Wanted) -> Backend:
    """nserver://host[:port]/id?options"""
    host, port = _host_and_port(text)
    parts = urlsplit(text)
    options = _options(text, parts.query, _NSERVER_OPTIONS)
    timeout_s = _timeout(text, options.get("timeout_s", str(wanted.timeout_s)))
    model = model_named(options.get("model", N150.name))
    robot_id = _robot_id(text, parts) if wanted.robot_id is None else wanted.robot_id
    stream = _open_tcp(host, port, timeout_s)
    return _open_nserver(stream, Wanted(timeout_s, robot_id, wanted.create), model)


def _host_and_port(text: str) -> tuple[str, int]:
    """Of an Nserver's address. Raises AddressError."""
    if not text.partition(":")[2].startswith("//"):
        raise AddressError(f"{text!r}: an Nserver's address is nserver://host[:port]/id, {_EXAMPLE}")
    try:
        parts = urlsplit(text)
        port = parts.port
    except ValueError as error:
        raise AddressError(f"{text!r}: {error}; an address is nserver://host[:port]/id") from None
    return parts.hostname or "localhost", DEFAULT_PORT if port is None else port


def _in_process(text: str, scheme: str, wanted: Wanted) -> Backend:
    """scheme:anything; the opener reads it, but for the robot's model, which the client must know as well."""
    named = dict(parse_qsl(text.partition("?")[2])).get("robot", N150.name)
    return _open_nserver(memory.open_in_process(scheme, text), wanted, model_named(named))


def _open_nserver(stream: ByteStream, wanted: Wanted, model: Model = N150) -> Backend:
    robot_id = 1 if wanted.robot_id is None else wanted.robot_id
    return NserverBackend(stream, robot_id=robot_id, model=model, timeout_s=wanted.timeout_s, create=wanted.create)


def _open_tcp(host: str, port: int, timeout_s: float) -> TcpStream:
    return TcpStream(host, port, max(timeout_s, CONNECT_TIMEOUT_S))


def _find(name: str, port: int, timeout_s: float) -> TcpStream:
    """A stream to the host; where none is named, to the first name of this machine that answers."""
    host, colon, digits = name.rpartition(":")
    if colon and digits.isdecimal() and (":" not in host or host.endswith("]")):
        name, port = host.strip("[]"), int(digits)
    *others, last = (name,) if name else names_of_this_machine()
    for host in others:
        with contextlib.suppress(ConnectionLost):
            return _open_tcp(host, port, timeout_s)
    return _open_tcp(last, port, timeout_s)


_SCHEMES: dict[str, Callable[[str, Wanted], Backend]] = {"nserver": _nserver}
"""Schemes that this package serves by itself."""


def _is_address(name: str) -> bool:
    scheme, colon, rest = name.partition(":")
    return bool(colon) and not rest.isdecimal() and scheme.lower() in known_schemes()


def _no_scheme(text: str, scheme: str) -> AddressError:
    known = known_schemes()
    near = difflib.get_close_matches(scheme, known, n=1)
    hint = f"did you mean {near[0]}:? " if near else ""
    return AddressError(f"{text!r} is no address: {hint}There are {', '.join(f'{name}:' for name in known)} {_EXAMPLE}")


def _options(text: str, query: str, known: Iterable[str]) -> dict[str, str]:
    options = dict(parse_qsl(query, keep_blank_values=True))
    for name in options:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise AddressError(f"{text!r}: no option {name!r}{hint} There are {', '.join(known)}.")
    return options


def _timeout(text: str, given: str) -> float:
    try:
        timeout_s = float(given)
    except ValueError:
        timeout_s = math.nan
    if not 0 < timeout_s < math.inf:
        raise AddressError(f"{text!r}: timeout_s is a number of seconds above 0, not {given!r}")
    return timeout_s


def _robot_id(text: str, parts: SplitResult) -> int:
    number = parts.path.strip("/") or "1"
    if not (number.isascii() and number.isdecimal()) or not 1 <= int(number) <= _MAX_ID or parts.fragment:
        raise AddressError(f"{text!r}: what follows the host is the robot's number, 1 or more, not {parts.path!r}")
    return int(number)
