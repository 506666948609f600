"""Readers of files written by the programs, which users may edit: recordings, snapshots, saved estimates.

A recording is also formatted and replayed, as `nomad dump` and `replay:` do. The emulator into which a snapshot is
loaded is reset after each input.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, Final

from fuzz.mutation import any_of, mutate_bytes, mutate_json
from fuzz.reader import Reader, input_file
from localization.live import estimate
from nclient.errors import EstimateFileError, NomadError, RecordingError, SnapshotError
from nclient.protocol.codec import encode_serial_request, encode_tcp_request
from nclient.protocol.commands import Call
from nclient.protocol.types import MODELS, serial_wire_state
from nclient.recording.format import FORMAT, IN, OUT, VERSION, Entry, as_object, format_entry, read_recording
from nclient.recording.recorder import TCP, FrameDecoder
from nclient.recording.replayer import LOOSE, Player, find_state_reply, load_exchanges
from nserver_emu.control import snapshot
from nserver_emu.control.recording import RunHeader, replay
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.inprocess import open_address
from nserver_emu.server.server_state import Allowed, SimulationClock
from nserver_emu.server.session import Session

MAX_STEPS: Final = 100
"""Time steps, or seconds, that a recording may contain; more would exceed the time limit of an input."""


def _recording(data: bytes) -> None:
    recording = read_recording(input_file(data, ".log"))
    for entry in recording.entries:
        for _ in format_entry(entry, with_bytes=True):
            pass
    # Each connection can be replayed on its own.
    for name in recording.connections():
        script = load_exchanges(recording, name)
        find_state_reply(script, 0)
        player = Player(script, LOOSE)
        for entry in recording.entries:
            if entry.kind == OUT and entry.connection == name:
                player.answers(entry.data)


def _replay(data: bytes) -> None:
    """Replay a recording as `nserver --replay` does; recordings of long times are skipped."""
    recording = read_recording(input_file(data, ".log"))
    steps = [step for entry in recording.entries for step in _steps(entry.more.get("steps"))]
    if sum(steps) <= MAX_STEPS:
        replay(recording)


def _steps(entries: object) -> Iterator[float]:
    """Yield the number of steps of each valid entry."""
    for entry in entries if isinstance(entries, list) else []:
        if isinstance(entry, list) and len(entry) == 2 and all(isinstance(part, int | float) for part in entry):
            yield max(min(entry[1], 2 * MAX_STEPS), 0) * min(max(entry[0], 1), 2 * MAX_STEPS)


def _snapshot(data: bytes) -> None:
    emulator = _emulator()
    # Reset the emulator afterwards, also after a partial restore that failed.
    before = {part: getattr(emulator, part) for part in snapshot.SAVED_PARTS}
    try:
        snapshot.restore(emulator, input_file(data, ".snapshot"))
    finally:
        for part, value in before.items():
            setattr(emulator, part, value)


@functools.cache
def _emulator() -> Any:
    """Return the parts of an emulator that a snapshot changes."""
    emulator = open_address("sim:thesis_room?robot=scout").emulator
    axis_ownership = SimpleNamespace(release_all=lambda _: None)
    parts = {part: getattr(emulator, part) for part in snapshot.SAVED_PARTS}
    return SimpleNamespace(**parts, axis_ownership=axis_ownership, invalidate_state_cache=lambda: None)


# Valid inputs


def _recording_seeds() -> list[bytes]:
    return [_client_recording("tcp", "n150"), _client_recording("serial", "n150"), _client_recording("hello", "n200")]


def _client_recording(wire: str, model: str) -> bytes:
    """Return a recording of some exchanges with a simulated robot."""
    line = wire != "tcp"
    robot = open_address(f"sim:thesis_room?robot={model}&line={int(line)}")
    follower = FrameDecoder(wire, MODELS[model])
    calls = ([] if line else [Call("connect_robot", (1, 7))]) + [Call("vm", (10, 0, 0)), Call("get_sn"), Call("st")]
    entries = [Entry(0.0, "open", "1", more={"wire": wire, "model": model})]
    for number, call in enumerate(calls):
        request = encode_serial_request(call, serial_wire_state(MODELS[model])) if line else encode_tcp_request(call)
        robot.send(request)
        entries.append(Entry(0.1 * number, OUT, "1", request, tuple(follower.to_robot(request))))
        reply = robot.receive()
        entries.append(Entry(0.1 * number + 0.05, IN, "1", reply, tuple(follower.to_host(reply))))
    header = {"format": FORMAT, "version": VERSION, "wire": wire, "model": model}
    return "\n".join(json.dumps(value) for value in (header, *map(as_object, entries))).encode() + b"\n"


def _server_seeds() -> list[bytes]:
    """Return recordings of a server with one client, in real time and in lockstep."""
    return [
        _server_recording(SimulationClock(), [[0.1, 3], [0.25, 1]]),
        _server_recording(SimulationClock(lockstep_s=0.5), []),
    ]


def _server_recording(pace: SimulationClock, steps: list[list[float]]) -> bytes:
    run_header = RunHeader(SimulationConfig(noisy=True), pace, Allowed(control=True))
    emulator = run_header.create_emulator()
    emulator.port = 7019
    session = Session(emulator.answer, "127.0.0.1:1")
    entries = [Entry(0.0, "open", session.name, more={"wire": TCP, "model": "n150"})]
    for number, call in enumerate((Call("connect_robot", (1, 7)), Call("vm", (50, 0, 90)), Call("gs"), Call("st"))):
        request = encode_tcp_request(call)
        entries.append(Entry(float(number), OUT, session.name, request, more={"steps": steps} if steps else {}))
        for dt_s, count in steps:
            for _ in range(int(count)):
                emulator.pass_time(dt_s)
        session.receive(request)
        entries.append(Entry(float(number), IN, session.name, session.process_requests(MAX_STEPS)))
    entries.append(Entry(4.0, "close", session.name))
    top = {"format": FORMAT, "version": VERSION} | run_header.to_json("", port=7019, requests_a_turn=5, real_robots=0)
    return "\n".join(json.dumps(value) for value in (top, *map(as_object, entries))).encode() + b"\n"


def _snapshot_seeds() -> list[bytes]:
    return [snapshot.dumps(open_address(f"sim:thesis_room?{options}").emulator).encode()
            for options in ("robot=scout", "robot=n150&noisy=1", "setup=measured")]  # fmt: skip


def _estimate_seeds() -> list[bytes]:
    values = {
        "format": estimate.FORMAT, "world": "thesis_room", "walls": "x", "body": "n150", "clock_s": 3.5,
        "encoders": [1.0, 2.0, 0.5], "turret_rad": 0.1, "mean": [1.0, 2.0, 0.5],
        "cov": [[1.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 0.1]],
    }  # fmt: skip
    wheels: dict[str, Any] = {"mean": [1.0] * 5, "cov": [[float(i == k) for i in range(5)] for k in range(5)]}
    return [json.dumps(value).encode() for value in (values, values | wheels)]


_TREE = any_of(mutate_json, mutate_json, mutate_json, mutate_bytes)

READERS = (
    Reader("recordings", "recordings: read, format, play", _recording, (RecordingError,), _recording_seeds, _TREE,
           max_size=16384),
    Reader("replays", "recordings, replayed with --replay", _replay, (NomadError,), _server_seeds, _TREE,
           max_size=16384),
    Reader("snapshots", "saved simulations", _snapshot, (SnapshotError,), _snapshot_seeds, _TREE, max_size=32768),
    Reader("saved_estimates", "saved estimates (--resume)", lambda data: estimate.load(input_file(data, ".json")),
           (EstimateFileError,), _estimate_seeds, _TREE),
)  # fmt: skip
