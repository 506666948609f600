"""Readers of files that the programs write, and anybody can change: recordings, snapshots, kept estimates.

Rules: as in files.py. A recording is also looked through as `nomad dump` and replay: do; the emulator that a snapshot
is read into goes back to what it was, so that each input meets the same.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, Final

from fuzz.mutating import bytes_changed, either, tree_changed
from fuzz.place import file_of
from fuzz.reader import Reader
from localization.live import saved_estimate
from nclient.errors import EstimateFileError, NomadError, RecordingError, SnapshotError
from nclient.protocol.codec import line_request, tcp_request
from nclient.protocol.commands import Call
from nclient.protocol.types import MODELS
from nclient.protocol.wire_state import line_terms
from nclient.recording.format import FORMAT, IN, OUT, VERSION, Entry, as_object, read_recording
from nclient.recording.readable import lines_of
from nclient.recording.recorder import TCP, Follower
from nclient.recording.replayer import LOOSE, Player, script_of, state_before
from nserver_emu.persistence import snapshot
from nserver_emu.persistence.recording import Beginning, header
from nserver_emu.persistence.replay import replay
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.context import Allowed, SimulationClock
from nserver_emu.server.inprocess import open_address
from nserver_emu.server.session import Session

MOST_STEPS: Final = 100
"""Pieces of time, or seconds, that a recording asks to pass: more takes longer than an input may."""


def _recording(data: bytes) -> None:
    recording = read_recording(file_of(data, ".log"))
    for entry in recording.entries:
        for _ in lines_of(entry, with_bytes=True):
            pass
    for name in recording.connections():
        script = script_of(recording, name)
        state_before(script, 0)
        player = Player(script, LOOSE)
        for entry in recording.entries:
            if entry.kind == OUT and entry.connection == name:
                player.answers(entry.data)


def _again(data: bytes) -> None:
    """As `nserver --replay` does; one that says that much time passed takes its time, and is left out."""
    recording = read_recording(file_of(data, ".log"))
    steps = [step for entry in recording.entries for step in _steps(entry.more.get("steps"))]
    if sum(steps) <= MOST_STEPS:
        replay(recording)


def _steps(told: object) -> Iterator[float]:
    """How often time passes, so far as what should say so does."""
    for piece in told if isinstance(told, list) else []:
        if isinstance(piece, list) and len(piece) == 2 and all(isinstance(part, int | float) for part in piece):
            yield max(min(piece[1], 2 * MOST_STEPS), 0) * min(max(piece[0], 1), 2 * MOST_STEPS)


def _snapshot(data: bytes) -> None:
    emulator = _emulator()
    before = {part: getattr(emulator, part) for part in snapshot.KEPT}
    try:
        snapshot.restore(emulator, file_of(data, ".snapshot"))
    finally:
        for part, value in before.items():
            setattr(emulator, part, value)


@functools.cache
def _emulator() -> Any:
    """An emulator, as far as a snapshot changes it."""
    emulator = open_address("sim:thesis_room?robot=scout").emulator
    drivers = SimpleNamespace(release_all=lambda _: None)
    parts = {part: getattr(emulator, part) for part in snapshot.KEPT}
    return SimpleNamespace(**parts, drivers=drivers, invalidate_state_cache=lambda: None)


# seeds


def _recording_seeds() -> list[bytes]:
    return [_written("tcp", "n150"), _written("serial", "n150"), _written("hello", "n200")]


def _written(wire: str, model: str) -> bytes:
    """A recording of one exchange with a simulated robot."""
    line = wire != "tcp"
    end = open_address(f"sim:thesis_room?robot={model}&line={int(line)}")
    follower = Follower(wire, MODELS[model])
    calls = ([] if line else [Call("connect_robot", (1, 7))]) + [Call("vm", (10, 0, 0)), Call("get_sn"), Call("st")]
    entries = [Entry(0.0, "open", "1", more={"wire": wire, "model": model})]
    for number, call in enumerate(calls):
        asked = line_request(call, line_terms(MODELS[model])) if line else tcp_request(call)
        end.send(asked)
        entries.append(Entry(0.1 * number, OUT, "1", asked, tuple(follower.to_robot(asked))))
        said = end.receive()
        entries.append(Entry(0.1 * number + 0.05, IN, "1", said, tuple(follower.to_host(said))))
    header = {"format": FORMAT, "version": VERSION, "wire": wire, "model": model}
    return "\n".join(json.dumps(whole) for whole in (header, *map(as_object, entries))).encode() + b"\n"


def _daemon_seeds() -> list[bytes]:
    """What a daemon writes of one client, in real time and in lockstep."""
    return [_evening(SimulationClock(), [[0.1, 3], [0.25, 1]]), _evening(SimulationClock(lockstep_s=0.5), [])]


def _evening(pace: SimulationClock, steps: list[list[float]]) -> bytes:
    beginning = Beginning(SimulationConfig(noisy=True), pace, Allowed(control=True))
    emulator = beginning.emulator()
    emulator.port = 7019
    session = Session(emulator.answer, "127.0.0.1:1")
    entries = [Entry(0.0, "open", session.name, more={"wire": TCP, "model": "n150"})]
    for number, call in enumerate((Call("connect_robot", (1, 7)), Call("vm", (50, 0, 90)), Call("gs"), Call("st"))):
        asked = tcp_request(call)
        entries.append(Entry(float(number), OUT, session.name, asked, more={"steps": steps} if steps else {}))
        for dt_s, count in steps:
            for _ in range(int(count)):
                emulator.pass_time(dt_s)
        session.receive(asked)
        entries.append(Entry(float(number), IN, session.name, session.process_requests(MOST_STEPS)))
    entries.append(Entry(4.0, "close", session.name))
    top = {"format": FORMAT, "version": VERSION} | header(beginning, "", port=7019, requests_a_turn=5, real_robots=0)
    return "\n".join(json.dumps(whole) for whole in (top, *map(as_object, entries))).encode() + b"\n"


def _snapshot_seeds() -> list[bytes]:
    return [snapshot.dumps(open_address(f"sim:thesis_room?{options}").emulator).encode()
            for options in ("robot=scout", "robot=n150&noisy=1", "setup=measured")]  # fmt: skip


def _kept_seeds() -> list[bytes]:
    values = {
        "format": saved_estimate.FORMAT, "world": "thesis_room", "walls": "x", "body": "n150", "clock_s": 3.5,
        "encoders": [1.0, 2.0, 0.5], "turret_rad": 0.1, "mean": [1.0, 2.0, 0.5],
        "cov": [[1.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 0.1]],
    }  # fmt: skip
    wheels: dict[str, Any] = {"mean": [1.0] * 5, "cov": [[float(i == k) for i in range(5)] for k in range(5)]}
    return [json.dumps(whole).encode() for whole in (values, values | wheels)]


_TREE = either(tree_changed, tree_changed, tree_changed, bytes_changed)

READERS = (
    Reader("recordings", "recordings: read, shown, played", _recording, (RecordingError,), _recording_seeds, _TREE,
           longest=16384),
    Reader("replays", "recordings, asked again (--replay)", _again, (NomadError,), _daemon_seeds, _TREE, longest=16384),
    Reader("snapshots", "saved simulations", _snapshot, (SnapshotError,), _snapshot_seeds, _TREE, longest=32768),
    Reader("kept_estimates", "saved estimates (--resume)", lambda data: saved_estimate.load(file_of(data, ".json")),
           (EstimateFileError,), _kept_seeds, _TREE),
)  # fmt: skip
