"""A recording once more: a fresh emulator gets the recorded requests, and must say the recorded bytes.

    steps ──> simulation     out ──> session.receive     in ──> session's answers, compared     close ──> leave

Rules: entries in their order, since the daemon wrote them as it worked. A client's recording of `sim:` is followed as
well. Nothing here knows a clock or a socket; the first difference ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from nclient.errors import NomadError, RecordingError
from nclient.protocol.types import get_model
from nclient.recording.format import IN, OUT, Entry, Recording
from nclient.recording.recorder import HANDSHAKE_FIRST, TCP
from nserver_emu.persistence.recording import DAEMON, beginning_of
from nserver_emu.server.client_registry import CLOSED_RETENTION_S, ClientRegistry
from nserver_emu.server.handlers.runtime_settings import change_obstacle, put_world, show_world, switch_noise
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import SCHEME, InProcess, open_address
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.server.session import BaseSession, Session

LONGEST_STEP_S: Final = 250.0
"""What a daemon makes up for at once, a quarter of a second, at its fastest; what a client may step is less."""
_SHOWN = 12
_NONSENSE: Final = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError)
"""What values lead to that no daemon wrote."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """How far the emulator said the same: answers and their bytes, and the first difference, empty for none."""

    answers: int
    size: int
    difference: str = ""


class _NeverOpened(Exception):
    """An entry is of a connection that did not come, or has gone."""


class Again(Protocol):
    """What is asked once more: gives an answer at each entry that is one."""

    def follow(self, entry: Entry) -> bytes: ...


def replay(recording: Recording) -> Outcome:
    """Ask an emulator as the recording's header describes it once more.

    Raises RecordingError where that cannot be, or what a daemon's start and its owner's commands may raise.
    """
    try:
        again = _emulator(recording)
    except NomadError:
        raise
    except _NONSENSE as error:
        raise RecordingError(
            f"{recording.name}, line 1: does not tell how the simulation began ({error!r:.80})"
        ) from None
    answers = size = 0
    for entry in recording.entries:
        try:
            said = again.follow(entry)
        except _NeverOpened:
            raise RecordingError(
                f"{recording.name}, line {entry.line}: connection {entry.connection!r} was never opened"
            ) from None
        except NomadError:
            raise
        except _NONSENSE as error:
            raise RecordingError(
                f"{recording.name}, line {entry.line}: nothing that a daemon writes ({error!r:.80}); take it out"
            ) from None
        if said != entry.data and entry.kind == IN:
            return Outcome(answers, size, _difference(recording, entry, said))
        answers += entry.kind == IN and bool(said)
        size += len(said) if entry.kind == IN else 0
    return Outcome(answers, size)


def _emulator(recording: Recording) -> Again:
    header = recording.header
    if header.get("real_robots"):
        raise RecordingError(f"{recording.name}: real robots answered, which no emulator can be again; "
                             f"`nomad play` answers as they did")
    if header.get("by") == DAEMON:
        return _DaemonAgain(recording)
    address = str(header.get("address", ""))
    if address.startswith(f"{SCHEME}:"):
        return _InProcessAgain(open_address(address))
    raise RecordingError(
        f"{recording.name}: recorded at {address or 'an unknown place'}, which no emulator can be again; "
        f"`nomad play` answers as it did"
    )


class _DaemonAgain:
    """Sessions around an emulator, stepped as the daemon stepped it."""

    def __init__(self, recording: Recording) -> None:
        self._emulator = beginning_of(recording.header, recording.name).emulator()
        self._emulator.port = recording.header["port"]
        self._most = recording.header["requests_a_turn"]
        self._sessions: dict[str, BaseSession[Any]] = {}
        self._greetings: dict[str, bytes] = {}
        self._line_clock_s = 0.0
        self._client_registry = ClientRegistry()
        self._leaving: list[tuple[float, str]] = []

    def follow(self, entry: Entry) -> bytes:
        self._pass_time(entry)
        for name, what in entry.more.items():
            if name in _CHANGES:
                _CHANGES[name](self._emulator, what)
        match entry.kind:
            case "open":
                self._open(entry)
            case "out":
                self._session(entry).receive(entry.data)
            case "in":
                return self._turn(entry)
            case "close":
                self._close(entry)
        return b""

    def _pass_time(self, entry: Entry) -> None:
        """The time that the entry says had passed before it, and who was forgotten meanwhile."""
        while self._leaving and self._leaving[0][0] <= entry.time_s:
            self._client_registry.remove(self._leaving.pop(0)[1])
        for dt_s, count in entry.more.get("steps", ()):
            if dt_s > LONGEST_STEP_S:
                raise ValueError(f"a step of {dt_s} s")
            for _ in range(count):
                self._emulator.pass_time(dt_s)
        self._line_clock_s = entry.more.get("at", self._line_clock_s)

    def _open(self, entry: Entry) -> None:
        answer, name, host = self._emulator.answer, entry.connection, _host(entry.connection)
        wire, model = entry.more["wire"], get_model(entry.more["model"])
        if wire == TCP:
            self._client_registry.add_pending(name, host)
            self._sessions[name] = Session(
                answer, name, lambda wide: self._client_registry.lookup(name, host, wide),
                self._emulator.allowed.frame,
            )
            return
        robot_id = entry.more["robot_id"]
        wire_state = self._emulator.serial_wire_state(robot_id)
        line = SerialSession(answer, robot_id, model, lambda: self._line_clock_s, name, wire_state)
        self._sessions[name] = line
        self._greetings[name] = line.greeting if wire == HANDSHAKE_FIRST else b""

    def _session(self, entry: Entry) -> BaseSession[Any]:
        session = self._sessions.get(entry.connection)
        if session is None:
            raise _NeverOpened
        return session

    def _close(self, entry: Entry) -> None:
        session = self._session(entry)
        del self._sessions[entry.connection]
        if session.closing:
            self._client_registry.remove(entry.connection, disconnected=True)
        else:
            self._leaving.append((entry.time_s + CLOSED_RETENTION_S, entry.connection))
        self._emulator.on_disconnect(session.context)

    def _turn(self, entry: Entry) -> bytes:
        """What the daemon did at such an entry: greet, look whether time has brought an answer, or take a turn."""
        name = entry.connection
        session = self._session(entry)
        if greeting := self._greetings.pop(name, b""):
            return greeting
        if entry.more.get("by_time"):
            return session.tick()
        if not session.ready:
            session.tick()  # half a frame was given up, and what is behind it found
        before = session.identity
        said = session.process_requests(self._most)
        if session.identity != before:
            self._client_registry.register(name, _host(name), session.identity)
        return said


def _pace(emulator: Emulator, what: tuple[float | None, bool]) -> None:
    emulator.clock.factor, emulator.clock.paused = what
    emulator.clock.check()
    emulator.invalidate_state_cache()


def _hold(emulator: Emulator, what: Mapping[str, Any]) -> None:
    for robot_id in what.get("robots", ()):
        emulator.hold(robot_id, what["by"])


def _release(emulator: Emulator, robot_ids: list[int]) -> None:
    for robot_id in robot_ids:
        emulator.estop.release(robot_id)


_CHANGES: Final[Mapping[str, Callable[[Emulator, Any], object]]] = {
    "pace": _pace,
    "noise": switch_noise,
    "hold": _hold,
    "release": _release,
    "shown": lambda emulator, _: show_world(emulator),
    "obstacle": change_obstacle,
    "world": lambda emulator, what: put_world(emulator, **what),
}
"""What was done to the simulation by no request, as the daemon has it written down (daemon.py, control.py)."""


class _InProcessAgain:
    """The emulator of a `sim:` address."""

    def __init__(self, end: InProcess) -> None:
        self._end = end

    def follow(self, entry: Entry) -> bytes:
        if entry.kind == OUT:
            self._end.send(entry.data)
        return self._end.receive() if entry.kind == IN else b""


def _host(name: str) -> str:
    return name.rpartition(":")[0]


def _difference(recording: Recording, entry: Entry, said: bytes) -> str:
    at = next((k for k, (a, b) in enumerate(zip(said, entry.data, strict=False)) if a != b),
              min(len(said), len(entry.data)))
    return (
        f"{recording.name}, line {entry.line}: from byte {at} on {_hex(said, at)} instead of {_hex(entry.data, at)} "
        f"({len(said)} and {len(entry.data)} bytes)"
    )


def _hex(data: bytes, at: int) -> str:
    return data[at:][:_SHOWN].hex() or "nothing"
