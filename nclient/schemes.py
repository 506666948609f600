"""What an address can say: a table of schemes and a table of options. The only file that knows every backend.

    SCHEMES   nserver:, sim:, replay:    who is at the other end: how the stream is opened, what is spoken over it
    OPTIONS   ?timeout_s=2&model=scout   what one says of it: how the text is read, which wrapper it puts on

    Robot ─> outermost backend wrapper ─> ... ─> backend ─> outermost stream wrapper ─> ... ─> stream

Rules: a new option is a new row, a new scheme a new row. Rows of wrappers stand inside out: what comes later in the
table is put around what came before. A wrapper is put on only where its option is given (or a scheme's default) and
is not 0. All that is wrong with an address is said before anything is opened.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from nclient import address as text
from nclient.address import Address, nearest
from nclient.backends.backend import Backend
from nclient.backends.nserver import DEFAULT_TIMEOUT_S, NserverBackend
from nclient.errors import AddressError, RecordingError
from nclient.faults.faulty_line import FaultyLine
from nclient.faults.injector import Injector
from nclient.faults.language import LineLanguage, TcpLanguage
from nclient.faults.plan import Plan
from nclient.faults.plan_file import load_plan
from nclient.faults.stream import FaultyStream
from nclient.protocol.models import N150, Model, model_named
from nclient.recording.follower import HELLO_FIRST, TCP
from nclient.recording.log import read_recording
from nclient.recording.player import ORDERS, STRICT, PlayedPeer, Player
from nclient.recording.script import script_of
from nclient.recording.stream import ProgramsRecording, Recorded
from nclient.transports import memory
from nclient.transports.byte_stream import ByteStream
from nclient.transports.memory import MemoryStream
from nclient.transports.tcp import CONNECT_TIMEOUT_S, TcpStream

DEFAULT_PORT = 7019
EXAMPLES = "such as nserver://localhost:7019/1 or sim:thesis_room"
_MAX_ID = 0x7FFFFFFF


@dataclass(frozen=True, slots=True)
class Wanted:
    """What whoever connects says besides the address: time-out (the address wins), robot by number, made if need be."""

    timeout_s: float | None = None
    robot_id: int | None = None
    create: bool = False


@dataclass(slots=True)
class Opening:
    """One address on its way to a backend; the same one each time that it is opened again.

    `values`: the options, read, with the scheme's defaults; `kept`: what a wrapper keeps from one opening of the
    stream to the next (a file that is open, a count).
    """

    address: Address
    scheme: Scheme
    wanted: Wanted
    values: Mapping[str, Any]
    kept: dict[str, Any] = field(default_factory=dict)

    @property
    def model(self) -> Model:
        """The robot's model, as the address says."""
        model: Model = self.values.get("model", N150)
        return model

    @property
    def timeout_s(self) -> float | None:
        """How long an answer may take, where anybody said."""
        timeout_s: float | None = self.values.get("timeout_s", self.wanted.timeout_s)
        return timeout_s

    def stream(self) -> ByteStream:
        """The stream with its wrappers."""
        stream = self.scheme.opens(self)
        for option, value in self._given():
            if option.stream is not None:
                stream = option.stream(stream, value, self)
        return stream

    def bare_stream(self) -> ByteStream:
        """The stream without its wrappers: for those who only want to know whether somebody is there."""
        return self.scheme.opens(self)

    def talk(self) -> Backend:
        """A conversation over a new stream, without the backend's wrappers."""
        return self.scheme.talks(self.stream(), self)

    def backend(self) -> Backend:
        """A conversation with all wrappers."""
        backend = self.talk()
        try:
            for option, value in self._given():
                if option.backend is not None:
                    backend = option.backend(backend, value, self)
        except BaseException:
            backend.close()
            raise
        return backend

    def _given(self) -> Iterator[tuple[Option, Any]]:
        return ((option, self.values[option.name]) for option in OPTIONS if self.values.get(option.name))


@dataclass(frozen=True, slots=True)
class Option:
    """A row: a name, how its text is read (unit and range there), the wrapper it puts on, the schemes that have it."""

    name: str
    read: text.Reader
    stream: Callable[[ByteStream, Any, Opening], ByteStream] | None = None
    backend: Callable[[Backend, Any, Opening], Backend] | None = None
    schemes: frozenset[str] | None = None
    """None: every scheme."""


@dataclass(frozen=True, slots=True)
class Scheme:
    """A row: how such an address looks, how its stream is opened, and what is spoken over it."""

    form: str
    opens: Callable[[Opening], ByteStream]
    talks: Callable[[ByteStream, Opening], Backend]
    defaults: Mapping[str, Any] = field(default_factory=dict)
    reads_the_rest: bool = False
    """Whether who answers reads the options that are not ours, and has its own to say about them."""
    line: str = TCP
    """The language as recordings name it (nclient.recording.follower.LINES)."""


def opening_of(given: str, wanted: Wanted) -> Opening:
    """An address, understood and not opened. Raises AddressError with the nearest that would be right."""
    address = text.parsed(given)
    scheme = _scheme_named(address)
    readers = {row.name: row.read for row in OPTIONS if row.schemes is None or address.scheme in row.schemes}
    values = address.read(readers, others=scheme.reads_the_rest)
    opening = Opening(address, scheme, wanted, {**scheme.defaults, **values})
    if scheme is _IN_PROCESS:
        opening.values = {"model": model_named(address.options.get("robot", N150.name)), **opening.values}
    return opening


def known_schemes() -> tuple[str, ...]:
    """The address schemes there are."""
    return tuple(sorted({*SCHEMES, *memory.schemes()}))


def open_nserver(stream: ByteStream, wanted: Wanted, model: Model = N150) -> NserverBackend:
    """The conversation with an Nserver at the other end of a stream."""
    robot_id = 1 if wanted.robot_id is None else wanted.robot_id
    timeout_s = DEFAULT_TIMEOUT_S if wanted.timeout_s is None else wanted.timeout_s
    return NserverBackend(stream, robot_id=robot_id, model=model, timeout_s=timeout_s, create=wanted.create)


def open_tcp(host: str, port: int, timeout_s: float | None) -> TcpStream:
    """A TCP connection, with the time-out of answers where that is longer than one's patience."""
    return TcpStream(host, port, max(timeout_s or 0.0, CONNECT_TIMEOUT_S))


def _scheme_named(address: Address) -> Scheme:
    if address.scheme in SCHEMES:
        return SCHEMES[address.scheme]
    if address.scheme in memory.schemes():
        return _IN_PROCESS
    known = known_schemes()
    named = address.scheme or address.text.partition("/")[0].lower()
    hint = nearest(named, known, after=":? ")
    names = ", ".join(f"{name}:" for name in known)
    raise AddressError(f"{address.text!r} is no address: {hint}There are {names} {EXAMPLES}")


def _nserver_stream(opening: Opening) -> ByteStream:
    """nserver://host[:port]/id: the id is looked at before anything is opened."""
    parts = opening.address.parts(opening.scheme.form)
    _robot_id(opening)
    port = DEFAULT_PORT if parts.port is None else parts.port
    return open_tcp(parts.hostname or "localhost", port, opening.timeout_s)


def _nserver_talk(stream: ByteStream, opening: Opening) -> Backend:
    wanted = Wanted(opening.timeout_s, _robot_id(opening), opening.wanted.create)
    return open_nserver(stream, wanted, opening.model)


def _robot_id(opening: Opening) -> int:
    if opening.wanted.robot_id is not None:
        return opening.wanted.robot_id
    parts = opening.address.parts(opening.scheme.form)
    number = parts.path.strip("/") or "1"
    if not (number.isascii() and number.isdecimal()) or not 1 <= int(number) <= _MAX_ID or parts.fragment:
        raise AddressError(
            f"{opening.address.text!r}: what follows the host is the robot's number, 1 or more, not {parts.path!r}"
        )
    return int(number)


def _of_every_scheme() -> list[str]:
    return [option.name for option in OPTIONS if option.schemes is None]


def _memory_stream(opening: Opening) -> ByteStream:
    """scheme:anything; the opener reads it, without the options that are the client's."""
    return memory.open_in_process(opening.address.scheme, opening.address.without(_of_every_scheme()))


def _memory_talk(stream: ByteStream, opening: Opening) -> Backend:
    return open_nserver(stream, opening.wanted, opening.model)


def _recorded(stream: ByteStream, path: str, opening: Opening) -> ByteStream:
    """The innermost wrapper: what really went over the line. The same file however often the stream is opened."""
    recording = opening.kept.get("record")
    if recording is None:
        try:
            recording = opening.kept["record"] = _recording(Path(path), opening)
        except RecordingError:
            stream.close()
            raise
    recorded: ByteStream = recording.around(stream)
    return recorded


def _recording(path: Path, opening: Opening) -> ProgramsRecording:
    """Who answers in this process has a time of its own, which the robot's clock tells."""
    line = _line_of(opening)
    what = Recorded(opening.address.without(_of_every_scheme()), line, opening.model)
    if opening.scheme in (_IN_PROCESS, SCHEMES["replay"]):
        return ProgramsRecording(path, what)
    start_s = time.monotonic()
    return ProgramsRecording(path, what, lambda: time.monotonic() - start_s, datetime.now(UTC))


def _faulty(stream: ByteStream, plan: Plan, opening: Opening) -> ByteStream:
    """Around the recording: what the program gets to see. One count however often the stream is opened."""
    kept = opening.kept
    if "faults" not in kept:
        kept["faults"] = Injector(plan, opening.address.scheme, time.monotonic())
    line = _line_of(opening)
    greets = line == HELLO_FIRST or (opening.address.scheme == "robotd" and opening.model.sends_mask)
    language = TcpLanguage(wide=False) if line == TCP else LineLanguage(greets)
    return FaultyStream(stream, FaultyLine(language, kept["faults"]), time.monotonic, time.sleep)


def _line_of(opening: Opening) -> str:
    """What is spoken over the stream, as recordings name it."""
    line: str = opening.kept["script"].line if "script" in opening.kept else opening.scheme.line
    return line


def _replay_stream(opening: Opening) -> ByteStream:
    """replay:FILE: the connection asked for, else the first, then the next each time that it is opened anew."""
    path = unquote(opening.address.text.partition(":")[2].partition("?")[0])
    recording = opening.kept.setdefault("recording", None) or read_recording(Path(path))
    names, opened = recording.connections(), opening.kept.get("opened", 0)
    name = opening.values.get("connection") or (names[min(opened, len(names) - 1)] if names else "")
    script = script_of(recording, name)
    opening.kept |= {"recording": recording, "opened": opened + 1, "script": script}
    opening.values = {"model": script.model, **opening.values}
    return MemoryStream(PlayedPeer(Player(script, opening.values.get("order", STRICT))))


def _replay_talk(stream: ByteStream, opening: Opening) -> Backend:
    """In the language that was recorded."""
    script = opening.kept["script"]
    if script.line != TCP:
        return SCHEMES["serial"].talks(stream, opening)
    return open_nserver(stream, Wanted(opening.timeout_s, script.robot_id), script.model)


SCHEMES: dict[str, Scheme] = {
    "nserver": Scheme("nserver://host[:port]/id, " + EXAMPLES, _nserver_stream, _nserver_talk),
    "replay": Scheme("replay:FILE", _replay_stream, _replay_talk),
}
"""Schemes that this package serves by itself; others are entry points of what answers in this process."""
_IN_PROCESS = Scheme("scheme:what", _memory_stream, _memory_talk, reads_the_rest=True)

_NSERVER = frozenset({"nserver"})
_REPLAY = frozenset({"replay"})

OPTIONS: tuple[Option, ...] = (
    Option("timeout_s", text.seconds, schemes=_NSERVER),
    Option("model", model_named, schemes=_NSERVER),
    Option("order", text.one_of(ORDERS), schemes=_REPLAY),
    Option("connection", text.path, schemes=_REPLAY),
    # around the stream, inside out
    Option("record", text.path, stream=_recorded),
    Option("faults", lambda path: load_plan(Path(text.path(path))), stream=_faulty),
    # around the backend, inside out
)
