"""Recordings and saved states of a server: the header, the replay, the options beside them, the file of --save.

The header has all that starts the same simulation again:

    header   world, robot, start, others, noise, setup, seed | pace | permissions | snapshot | port

Whatever changes a reply must be in the header or in an entry. Files of world, models and setup are stored by name, with
a digest that shows whether they have changed since; a snapshot is stored as a whole, because a server that was restored
from it may overwrite it.

    steps --> simulation     out --> session.receive     in --> replies, compared     close --> disconnect

A replay gives the recorded requests to a new emulator in their order, which is that of the server, and compares the
replies byte by byte; the first difference ends it. A client's recording of `sim:` can be replayed as well. No clock, no
socket.

Rules for options beside --restore and --replay, whose files decide world, robots, seed and setup.

    --restore FILE                  FILE must exist; options that it decides are refused
    --replay FILE                   the same; it decides the snapshot as well, and no file is written
    --save FILE --restore FILE      a persistent run: without FILE it starts as the options say, later FILE decides and
                                    they are ignored

Wrong usage names the options and exits with 2 before anything starts. If any option of the simulation's clock is given,
all of the clock is as the options say; otherwise it is as in the snapshot.

The file of --save: written at the end, at SIGUSR1, and at intervals of real time (--autosave).

    event loop: simulation to text --> thread: write, flush, rename          the loop does not wait for the disk

An older state never replaces a newer one. A failing disk does not stop the run: the first failure is logged, every
later save is attempted, and the first success is logged again.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import logging
import os
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from hashlib import file_digest
from pathlib import Path
from typing import Any, Final

from nclient.common.arguments import number
from nclient.errors import NomadError, RecordingError, SnapshotError, version
from nclient.protocol.types import get_model
from nclient.recording.format import IN, OUT, Entry, Recording
from nclient.recording.recorder import HANDSHAKE_FIRST, TCP
from nserver_emu.control import snapshot
from nserver_emu.server.config import SimulationConfig, read_setups
from nserver_emu.server.connection import end_task
from nserver_emu.server.handlers import runtime_settings
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import SCHEME, InProcess, open_address
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.server.session import CLOSED_RETENTION_S, BaseSession, ClientRegistry, Session
from nserver_emu.simulation.noise import SUFFIX
from worlds.io import DEFAULT_WORLD, world_names
from worlds.world import StartPose

log = logging.getLogger(__name__)

DECIDED: Final = ("robot", "robots", "model_file", "start", "seed", "setup", "noisy")
"""Options, by their names in the namespace, that a snapshot or a recording decides."""

_WRITES: Final = ("save", "autosave", "record")

CLOCK: Final = ("speed", "paused", "lockstep")
"""Options of the simulation's clock."""

_NOT_GIVEN: Final = "\0not given"


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str]) -> None:
    """Exit with a usage error if an option is given that a snapshot or a recording decides."""
    if options.autosave is not None and options.save is None:
        parser.error("--autosave needs a file: add --save FILE")
    if options.replay is not None:
        _check_beside(parser, options, words, "replay", "recording", (*DECIDED, "restore"))
        if written := _as_written(given_options(parser, words, _WRITES)):
            parser.error(f"argument --replay: it compares and stops, and writes no file: leave out "
                         f"{', '.join(written)}")
    elif options.restore is not None and not _is_persistent(options):
        _check_beside(parser, options, words, "restore", "snapshot", DECIDED)


def _check_beside(parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str], option: str,
                  file: str, decided: Iterable[str]) -> None:
    # Options, worlds and old setup files that the file decides.
    conflicts = _as_written(given_options(parser, words, decided))
    if len(options.files) > len(options.setups):
        conflicts.append(f"the world {options.world}")
    with contextlib.suppress(NomadError):  # reported when the files are read for the simulation
        if read_setups(options.setups).robot:
            conflicts.append("the robot of a setup file")
    if conflicts:
        parser.error(f"argument --{option}: the {file} has a world, robots, a seed and a setup of its own: leave out "
                     f"{', '.join(conflicts)}")


def _as_written(names: Iterable[str]) -> list[str]:
    """Return options as users write them, by their names in the namespace."""
    return [f"--{name.replace('_', '-')}" for name in names]


def resolve_restore(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Decide whether a persistent run starts or continues; if it continues, reset the options that its file decides."""
    # Only a run that is restored from the file it saves to.
    if options.restore is None or not _is_persistent(options):
        return
    if not os.path.lexists(options.restore):
        log.warning("%s: not there yet: the simulation begins, and is saved there", options.restore)
        options.restore = None
        return
    # The file decides: options that say how to start have no effect any more.
    for name in DECIDED:
        setattr(options, name, parser.get_default(name))
    options.world = DEFAULT_WORLD
    log.info("goes on from %s, with the world, the robots, the seed and the setup that are in it", options.restore)


def _is_persistent(options: argparse.Namespace) -> bool:
    """Return True if the file to restore from is also the file to save to."""
    return options.save is not None and options.save.absolute() == options.restore.absolute()


def keeps_pace(parser: argparse.ArgumentParser, words: Sequence[str]) -> bool:
    """Return True if a restored simulation continues with the clock of its snapshot."""
    return not given_options(parser, words, CLOCK)


def given_options(parser: argparse.ArgumentParser, words: Sequence[str], names: Iterable[str]) -> list[str]:
    """Return the options among `names` that a valid command line contains."""
    # Parse again with a sentinel in place of each default: options that keep it were not given.
    defaults = {name: None if parser.get_default(name) is None else _NOT_GIVEN for name in names}
    parsed = vars(parser.parse_args(list(words), argparse.Namespace(**defaults)))
    return [name for name in defaults if parsed[name] != defaults[name]]


MIN_INTERVAL_S, MAX_INTERVAL_S = 1.0, 86_400.0
_ENDING: Final = "saving"
"""Ending of the temporary file."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --save and --autosave."""
    parser.add_argument("--save", type=Path, metavar="FILE",
                        help="save the simulation to FILE at the end and at SIGUSR1")
    interval = number(f"seconds from {MIN_INTERVAL_S:g} to {MAX_INTERVAL_S:g}", MIN_INTERVAL_S, MAX_INTERVAL_S)
    parser.add_argument("--autosave", type=interval, metavar="SECONDS",
                        help="also save at this interval of real time, so that --restore can continue a killed run")


class SaveFile:
    """A file to which the state of an emulator is saved repeatedly."""

    def __init__(self, emulator: Emulator, path: Path) -> None:
        self._emulator, self._path = emulator, path
        self._numbers = itertools.count(1)
        self._written = 0
        self._lock = threading.Lock()
        self._failing = False

    def save(self) -> None:
        """Save the current state. Raises SnapshotError if the file cannot be written."""
        self._write(next(self._numbers), snapshot.dumps(self._emulator))

    async def save_in_thread(self) -> None:
        """Save the current state without blocking the event loop; log failures."""
        number, text = next(self._numbers), snapshot.dumps(self._emulator)
        try:
            await asyncio.to_thread(self._write, number, text)
        except SnapshotError as error:
            # Only the first failure of a series is logged.
            if not self._failing:
                log.error("not saved: %s; the run goes on, and it is tried again each time", error)
            self._failing = True
        else:
            if self._failing:
                log.warning("%s: saved again", self._path)
            self._failing = False

    def _write(self, number: int, text: str) -> None:
        # Threads may finish in another order than they were started.
        with self._lock:
            if number > self._written:
                snapshot.write(text, self._path, _ENDING)
                self._written = number


@contextlib.asynccontextmanager
async def autosaved(file: SaveFile | None, interval_s: float | None) -> AsyncIterator[None]:
    """Save at an interval while the context is open; without a file or an interval, do nothing."""
    # Cancelled at the end: the final save is the caller's.
    saving = asyncio.create_task(_save_repeatedly(file, interval_s)) if file and interval_s else None
    try:
        yield
    finally:
        await end_task(saving)


async def _save_repeatedly(file: SaveFile, interval_s: float) -> None:
    while True:
        await asyncio.sleep(interval_s)
        await file.save_in_thread()


SERVER: Final = "nserver"
"""Value of "by" in the header of a server's recording."""


@dataclass(frozen=True, slots=True)
class RunHeader:
    """The initial conditions of a server's simulation.

    Attributes
    ----------
    config
        World, robots, seed and setup.
    clock
        Relation of simulated to real time.
    allowed
        Permissions and limits of clients.
    restored
        File of the snapshot that the run continues; None: none.
    keeps_pace
        True: with the clock of the snapshot, not with `clock`.
    snapshot_text
        Contents of that file at the time; None: read it.
    """

    config: SimulationConfig
    clock: SimulationClock
    allowed: Allowed
    restored: Path | None = None
    keeps_pace: bool = False
    snapshot_text: str | None = None

    def create_emulator(self) -> Emulator:
        """Return the simulation in its initial state. Raises the errors of a server's start."""
        # The configuration decides the kind of the emulator; a snapshot then replaces its state.
        emulator = Emulator(self.config.simulation(), clock=replace(self.clock), allowed=self.allowed)
        if self.restored:
            text = self.snapshot_text or snapshot.text_of(self.restored)
            snapshot.loads(emulator, text, str(self.restored))
            emulator.clock = emulator.clock if self.keeps_pace else replace(self.clock)
        return emulator

    def to_json(self, started: str, **server: int) -> dict[str, Any]:
        """Return the header of a recording. Raises SnapshotError if the snapshot can no longer be read.

        Parameters
        ----------
        started
            Start of the run, ISO 8601.
        server
            `port`, the reply to a connection; `requests_a_turn`, processed before it is another client's turn;
            `real_robots`, the number of robots that reply in place of the simulation.
        """
        # Absolute paths: a replay may run in another folder.
        files = {name: str(path.absolute()) for name, path in _files(self.config).items()}
        restored = self.restored
        return {
            "package": version(), "started": started, "by": SERVER, "time": "simulated",
            "setting": asdict(self.config) | {"model_file": None} | files,
            "digests": {path: _digest(Path(path)) for path in files.values()},
            "pace": asdict(self.clock), "allowed": asdict(self.allowed), "keeps_pace": self.keeps_pace,
            "restored": restored and str(restored.absolute()), "snapshot": restored and snapshot.text_of(restored),
        } | server  # fmt: skip

    @classmethod
    def from_json(cls, header: Mapping[str, Any], name: str) -> RunHeader:
        """Return the initial conditions of a recording; `name` is its file in errors.

        Raises
        ------
        RecordingError
            If a file that the header names has changed.
        KeyError, TypeError, ValueError
            If the header lacks something, or has a wrong value.
        """
        # 1. Values.
        values = dict(header["setting"])
        others = tuple((model, _start(start)) for model, start in values["others"])
        changes = {"start": _start(values["start"]), "others": others, "model_file": _path(values["model_file"])}
        config = SimulationConfig(**values | changes)
        clock, allowed = SimulationClock(**header["pace"]), Allowed(**header["allowed"])
        clock.check()
        digests = dict(header.get("digests", {}))
        # 2. Files that are stored by name.
        for path in map(str, _files(config).values()):
            if path in digests and _digest(Path(path)) not in ("", digests[path]):
                raise RecordingError(f"{name}: {path} has changed since the recording; restore its previous contents")
        restored, text = _path(header.get("restored")), header.get("snapshot")
        return cls(config, clock, allowed, restored, bool(header.get("keeps_pace")), text and str(text))


def _files(config: SimulationConfig) -> dict[str, Path]:
    """Return the files that a configuration names, by its fields."""
    named: dict[str, Path] = {}
    if config.world not in world_names():
        named["world"] = Path(config.world)
    if config.setup.endswith(SUFFIX):
        named["setup"] = Path(config.setup)
    if config.model_file is not None:
        named["model_file"] = config.model_file
    return named


def _digest(path: Path) -> str:
    """Return the digest of a file; "" if it cannot be read, which its reader reports."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as file:
            return file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


def _start(values: Mapping[str, float] | None) -> StartPose | None:
    return None if values is None else StartPose(**values)


def _path(text: str | None) -> Path | None:
    return Path(text) if text else None


MAX_STEP_S: Final = 250.0
"""The longest step that a server writes: a quarter of a second of real time at its top speed. Clients' steps are
shorter."""

_SHOWN_BYTES: Final = 12
"""Bytes shown of each side of a difference."""

_INVALID: Final = (TypeError, ValueError, LookupError, AttributeError, ArithmeticError, RecursionError)
"""Errors caused by values that no server writes."""


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """The number of equal replies and of their bytes, and the first difference, "" for none."""

    answers: int
    size: int
    difference: str = ""


@contextlib.contextmanager
def _invalid_as(place: str, what: str, remedy: str = "") -> Iterator[None]:
    """Turn errors that values cause which no server writes into RecordingError; NomadErrors pass."""
    try:
        yield
    except NomadError:
        raise
    except _INVALID as error:
        raise RecordingError(f"{place}: {what} ({error!r:.80}){remedy}") from None


def replay(recording: Recording) -> ReplayResult:
    """Send the requests of a recording to an emulator that starts as its header describes, and compare the replies.

    Raises
    ------
    RecordingError
        If the recording cannot be replayed; other NomadErrors of a server's start and of control commands.
    """
    # 1. The emulator.
    with _invalid_as(f"{recording.name}, line 1", "no valid description of the simulation"):
        follow = _follower(recording)
    # 2. Each entry, up to the first difference.
    answers = size = 0
    for entry in recording.entries:
        with _invalid_as(f"{recording.name}, line {entry.line}", "not an entry of a server", "; remove it"):
            reply = follow(entry)
        if reply != entry.data and entry.kind == IN:
            return ReplayResult(answers, size, _difference(recording, entry, reply))
        answers += entry.kind == IN and bool(reply)
        size += len(reply) if entry.kind == IN else 0
    return ReplayResult(answers, size)


def _follower(recording: Recording) -> Callable[[Entry], bytes]:
    """Return the function that does what an entry says with a new emulator, and returns the reply."""
    header = recording.header
    if header.get("real_robots"):
        raise RecordingError(f"{recording.name}: recorded with real robots, which no emulator can repeat; use "
                             f"`nomad play` to send the recorded replies")
    if header.get("by") == SERVER:
        return _ServerReplayer(recording).follow
    address = str(header.get("address", ""))
    if address.startswith(f"{SCHEME}:"):
        return partial(_follow_in_process, open_address(address))
    raise RecordingError(f"{recording.name}: recorded at {address or 'an unknown address'}, which no emulator can "
                         "repeat; use `nomad play` to send the recorded replies")


class _ServerReplayer:
    """The sessions of a server and its emulator, without clock and sockets."""

    def __init__(self, recording: Recording) -> None:
        self._emulator = RunHeader.from_json(recording.header, recording.name).create_emulator()
        self._emulator.port = recording.header["port"]
        self._name = recording.name
        self._max_requests = recording.header["requests_a_turn"]
        self._sessions: dict[str, BaseSession[Any]] = {}
        self._greetings: dict[str, bytes] = {}
        self._line_clock_s = 0.0
        self._client_registry = ClientRegistry()
        self._closed: list[tuple[float, str]] = []

    def follow(self, entry: Entry) -> bytes:
        self._advance(entry)
        for name, value in entry.more.items():
            _apply_change(self._emulator, name, value)
        match entry.kind:
            case "open":
                self._open(entry)
            case "out":
                self._session(entry).receive(entry.data)
            case "in":
                return self._process(entry)
            case "close":
                self._close(entry)
        return b""

    def _advance(self, entry: Entry) -> None:
        """Advance by the steps before an entry, and remove clients that were closed long enough ago."""
        while self._closed and self._closed[0][0] <= entry.time_s:
            self._client_registry.remove(self._closed.pop(0)[1])
        for dt_s, count in entry.more.get("steps", ()):
            # A longer step would block for as long as it takes.
            if dt_s > MAX_STEP_S:
                raise ValueError(f"a step of {dt_s} s")
            for _ in range(count):
                self._emulator.pass_time(dt_s)
        self._line_clock_s = entry.more.get("at", self._line_clock_s)

    def _open(self, entry: Entry) -> None:
        answer, name, host = self._emulator.answer, entry.connection, _host(entry.connection)
        wire, model = entry.more["wire"], get_model(entry.more["model"])
        # TCP sessions choose their word size by the client; serial sessions belong to a robot.
        if wire == TCP:
            self._client_registry.add_pending(name, host)
            self._sessions[name] = Session(
                answer, name, lambda wide: self._client_registry.lookup(name, host, wide),
                self._emulator.allowed.frame,
            )  # fmt: skip
            return
        robot_id = entry.more["robot_id"]
        wire_state = self._emulator.serial_wire_state(robot_id)
        line = SerialSession(answer, robot_id, model, lambda: self._line_clock_s, name, wire_state)
        self._sessions[name] = line
        self._greetings[name] = line.greeting if wire == HANDSHAKE_FIRST else b""

    def _session(self, entry: Entry) -> BaseSession[Any]:
        session = self._sessions.get(entry.connection)
        if session is None:
            raise RecordingError(f"{self._name}, line {entry.line}: connection {entry.connection!r} was never opened")
        return session

    def _close(self, entry: Entry) -> None:
        session = self._session(entry)
        del self._sessions[entry.connection]
        # An orderly disconnect frees the identity at once, a lost connection later.
        if session.closing:
            self._client_registry.remove(entry.connection, disconnected=True)
        else:
            self._closed.append((entry.time_s + CLOSED_RETENTION_S, entry.connection))
        self._emulator.on_disconnect(session.context)

    def _process(self, entry: Entry) -> bytes:
        """Do what the server did at such an entry: send the greeting, poll a deferred reply, or process requests."""
        name = entry.connection
        session = self._session(entry)
        # 1. The greeting of a serial line.
        if greeting := self._greetings.pop(name, b""):
            return greeting
        # 2. A reply that became ready by time.
        if entry.more.get("by_time"):
            return session.tick()
        if not session.ready:
            session.tick()  # discards an incomplete frame, so that the one behind it is found
            if isinstance(session, Session):
                session.assume_32_bit_words()
        # 3. A turn; the handshake of a TCP client registers its identity.
        before = session.identity
        reply = session.process_requests(self._max_requests)
        if session.identity != before:
            self._client_registry.register(name, _host(name), session.identity)
        return reply


def _apply_change(emulator: Emulator, name: str, value: Any) -> None:
    """Apply a change that was not made by a request, as the server and its control socket record it."""
    match name:
        case "pace":
            emulator.clock.factor, emulator.clock.paused = value
            emulator.clock.check()
            emulator.invalidate_state_cache()
        case "noise":
            runtime_settings.switch_noise(emulator, value)
        case "hold":
            for robot_id in value.get("robots", ()):
                emulator.hold(robot_id, value["by"], is_silent=not value.get("informs"))
        case "release":
            for robot_id in value:
                emulator.release(robot_id)
        case "shown":
            runtime_settings.show_world(emulator)
        case "world":
            runtime_settings.put_world(emulator, **value)
        case kind if kind in runtime_settings.CHANGES:
            runtime_settings.CHANGES[kind](emulator, value)


def _follow_in_process(end: InProcess, entry: Entry) -> bytes:
    """Do what an entry of a client of a `sim:` address says."""
    if entry.kind == OUT:
        end.send(entry.data)
    return end.receive() if entry.kind == IN else b""


def _host(name: str) -> str:
    return name.rpartition(":")[0]


def _difference(recording: Recording, entry: Entry, reply: bytes) -> str:
    at = next((k for k, (a, b) in enumerate(zip(reply, entry.data, strict=False)) if a != b),
              min(len(reply), len(entry.data)))  # fmt: skip
    return (f"{recording.name}, line {entry.line}: from byte {at} on {_hex(reply, at)} instead of "
            f"{_hex(entry.data, at)} ({len(reply)} and {len(entry.data)} bytes)")


def _hex(data: bytes, at: int) -> str:
    return data[at:][:_SHOWN_BYTES].hex() or "nothing"
