"""A recording is asked once more, every byte is the same: lockstep, real time, noise, several robots and clients."""

from __future__ import annotations

import asyncio
import dataclasses
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from nclient.errors import RecordingError
from nclient.faults.plan import Direction, Nak, Plan, Rule
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import N150
from nclient.recording.format import Entry, Recording, RecordingWriter, read_recording
from nclient.recording.recorder import Recorder, RecordingStream
from nclient.transports.stream import Deadline, MemoryStream
from nserver_emu.control import snapshot
from nserver_emu.control.commands import answer_line
from nserver_emu.control.recording import MAX_STEP_S, RunHeader, replay
from nserver_emu.server.config import SimulationConfig, pose_from_text
from nserver_emu.server.connection import MAX_REQUESTS_PER_TURN
from nserver_emu.server.daemon import MAX_CATCH_UP_S
from nserver_emu.server.handlers.table import MAX_STEP_MS
from nserver_emu.server.inprocess import open_address
from nserver_emu.server.server_state import MAX_TIME_FACTOR, Allowed, SimulationClock
from tests.nserver_emu.server.lockstep_run import request
from tests.nserver_emu.server.running_server import Client, RunningServer, running_server
from worlds.io import SHIPPED, format_world, load_world

pytestmark = pytest.mark.long

REAL_TIME = RunHeader(SimulationConfig(), SimulationClock(), Allowed())
# Lockstep makes time follow from the requests, noise makes wrong draws visible.
LOCKSTEP = RunHeader(SimulationConfig(noisy=True, seed=5), SimulationClock(lockstep_s=0.1), Allowed())
THREE = SimulationConfig(
    world="several_walls", start=pose_from_text("5,5,0,0"), seed=3, setup="measured",
    others=(("n200", None), ("scout", pose_from_text("80,5,90,0"))),
)  # fmt: skip


async def recorded(
    path: Path, run_header: RunHeader, scenario: Callable[[RunningServer], Awaitable[None]], speed: float | None = 1.0
) -> Recording:
    """Return the recording of a daemon that ran the scenario."""

    def record(server: RunningServer) -> None:
        # The header has everything that decides replies: what the replay must not guess.
        numbers = {"port": server.port, "requests_a_turn": MAX_REQUESTS_PER_TURN}
        server.daemon.record(path, run_header.to_json("2026-01-01T00:00:00", **numbers))

    async with running_server(speed, run_header.create_emulator(), record) as server:
        await scenario(server)
    return read_recording(path)


async def converse(client: Client, first: int, count: int) -> None:
    for number in range(first, first + count):
        call = request(number)
        await client.ask(call.name, *call.args)


async def talk_of(server: RunningServer, robot_id: int, count: int) -> None:
    client = await server.open_client()
    assert (await client.ask("connect_robot", robot_id, robot_id)).values == (server.port,)
    # Motions and questions differ by robot, so that swapped connections would be detected.
    await client.ask("vm", 60, 100 * robot_id, -50)
    await converse(client, robot_id * 1000 + 1, count)


async def three_at_once(server: RunningServer) -> None:
    await asyncio.gather(*[talk_of(server, robot_id, 15) for robot_id in (1, 2, 3)])


async def test_a_lockstep_recording_replays_byte_by_byte(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        await converse(await server.connect_client(), 0, 120)

    recording = await recorded(tmp_path / "run.log", LOCKSTEP, scenario)
    outcome = replay(recording)
    # 120 requests and CONNECT.
    assert (outcome.answers, outcome.difference) == (121, "")
    # Every byte that clients received was compared.
    assert outcome.size == sum(len(entry.data) for entry in recording.entries if entry.kind == "in")


@pytest.mark.parametrize(
    ("pace", "speed"),
    [
        (SimulationClock(), 1.0),
        (SimulationClock(factor=5.0), 5.0),
        (SimulationClock(factor=None), None),
        (SimulationClock(lockstep_s=0.05), 1.0),
    ],
)
async def test_three_noisy_robots_and_as_many_clients(
    tmp_path: Path, pace: SimulationClock, speed: float | None
) -> None:
    recording = await recorded(tmp_path / "run.log", RunHeader(THREE, pace, Allowed()), three_at_once, speed)
    outcome = replay(recording)
    # Three clients: CONNECT, vm and 15 requests each.
    assert (outcome.answers, outcome.difference) == (3 * 17, "")
    assert len(recording.connections()) == 3


async def test_replay_of_closed_pipelining_and_unconnected_clients(tmp_path: Path) -> None:
    """One motion stops as its client vanishes, another's many requests wait their turn, a third knows the robot."""

    async def scenario(server: RunningServer) -> None:
        driver, watcher = await server.connect_client(), await server.connect_client()
        await driver.ask("vm", 100, 0, 0)
        # ws defers its reply, so that 300 requests wait behind it and are answered in many turns.
        watcher.writer.write(
            codec.encode_tcp_request(Call("ws", (1, 1, 1, 2))) + codec.encode_tcp_request(Call("gs")) * 300
        )
        driver.writer.close()
        for name in ("ws", *["gs"] * 300):
            await watcher.reply(name)
        # Without CONNECT: it continues the robot of a client of this address.
        other = await server.open_client()
        assert (await other.ask("gs")).slots[38] == 0
        watcher.writer.write(codec.encode_tcp_request(Call("disconnect_robot", (1, 1))))
        assert await watcher.reader.read() == b""
        await other.ask("gs")

    for lockstep_s in (None, 0.1):
        run_header = RunHeader(
            SimulationConfig(noisy=True), SimulationClock(factor=50.0, lockstep_s=lockstep_s), Allowed()
        )
        # At 50 times real time, and in lockstep.
        outcome = replay(await recorded(tmp_path / "run.log", run_header, scenario, 50.0))
        assert outcome.answers > 5
        assert outcome.difference == ""


async def test_replay_repeats_control_commands_but_no_faults(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        client, shown = await server.connect_client(), []
        await client.ask("vm", 100, 0, 0)
        for command, argument in (("speed", 20), ("pause", None), ("step", 0.5), ("resume", None), ("speed", "max")):
            line = json.dumps({"command": command, "argument": argument}).encode()
            assert json.loads(answer_line(server.daemon, line))["ok"]
            shown.append((await client.ask("gs")).slots[0])
        assert shown == [200, 0, 0, 200, 9999]
        # The fault plan answers vm itself, so the request never reaches the session and is not in the recording.
        refusing = Rule("no", (Nak(),), commands=("vm",), directions=frozenset({Direction.REQUEST}))
        server.daemon.faults.put(Plan((refusing,)), server.daemon.lines())
        assert (await client.ask("vm", 0, 0, 0)).kind == "error"
        assert (await client.ask("gs")).slots[38] == 100

    recording = await recorded(
        tmp_path / "run.log", RunHeader(SimulationConfig(noisy=True), SimulationClock(), Allowed()), scenario
    )
    # 5b = 91 is the type of an ERROR reply.
    assert not any(entry.kind == "in" and entry.data[1:2] == b"\x5b" for entry in recording.entries)
    # CONNECT, vm, five times gs after commands, and the last gs.
    assert (replay(recording).answers, replay(recording).difference) == (8, "")


async def test_replay_repeats_changes_of_noise_and_world(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        client = await server.connect_client()
        other = format_world(load_world("several_walls"))
        for command, argument in (
            ("noise", "sensors=measured motion=noisy robot=1"), ("world set", {"text": other, "file": "w.toml"}),
            ("noise", {"sensors": "noisy"}),
        ):  # fmt: skip
            # Each change must affect the motion or the readings of the next reply.
            await client.ask("pr", 50, 300, 0)
            line = json.dumps({"command": command, "argument": argument}).encode()
            assert json.loads(answer_line(server.daemon, line))["ok"]
            server.daemon.step(1.5)
            await client.ask("gs")

    recording = await recorded(tmp_path / "run.log", REAL_TIME, scenario)
    outcome = replay(recording)
    # CONNECT, then pr and gs three times.
    assert (outcome.answers, outcome.difference) == (7, "")
    # Counter-check: without the recorded change the replay differs.
    filtered = dataclasses.replace(recording, entries=tuple(e for e in recording.entries if "noise" not in e.more))
    assert replay(filtered).difference


async def test_replay_repeats_changes_of_obstacles_and_worlds(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        def control(command: str, argument: object = None) -> dict[str, Any]:
            line = json.dumps({"command": command, "argument": argument}).encode()
            answer = json.loads(answer_line(server.daemon, line))
            assert answer["ok"]
            reply: dict[str, Any] = answer["said"]
            return reply

        client = await server.connect_client()
        await client.ask("add_obstacle", 3, 200, -100, 260, -100, 260, 100)
        # An obstacle is found by its corners, 20 in = 200 tenths.
        control("obstacle", {"corners": [[20, -10], [26, -10], [26, 10]], "by": [-2.345, 0]})
        server.daemon.step(1.5)
        await client.ask("gs")
        # Exported and restored as text: the replay must restore the same object.
        before = control("world show")["text"]
        await client.ask("new_world")
        control("world set", {"text": before, "file": "before"})
        server.daemon.step(1.5)
        await client.ask("gs")
        control("obstacle", {"corners": [[17.655, -10], [23.655, -10], [23.655, 10]]})
        server.daemon.step(1.5)
        await client.ask("gs")
        # A door that is opened, and a walker.
        control("door", {"put": [[25, -20], [25, 20]], "name": "gate"})
        server.daemon.step(1.5)
        control("door", "gate open")
        control("walker", {"put": [[60, 3], [60, 20]]})
        server.daemon.step(1.5)
        await client.ask("gs")
        # A wall, and a world in which the robot has no room, so that it is placed at a start.
        control("wall", {"put": [[30, -20], [30, 20]]})
        server.daemon.step(1.5)
        await client.ask("gs")
        room = "[[room]]\ncorners_in = [[500, 500], [600, 500], [600, 600], [500, 600]]\n"
        far = f"{room}[[start]]\nx_in = 550\ny_in = 550"
        control("world set", {"text": far, "file": "far.toml", "places": True})
        server.daemon.step(1.5)
        await client.ask("gs")

    recording = await recorded(tmp_path / "run.log", REAL_TIME, scenario)
    # CONNECT, add_obstacle, new_world and six times gs.
    assert (replay(recording).answers, replay(recording).difference) == (9, "")
    # Counter-check for each kind of change.
    for change in ("wall", "world", "door", "walker"):
        filtered = dataclasses.replace(recording, entries=tuple(e for e in recording.entries if change not in e.more))
        assert replay(filtered).difference
    filtered = dataclasses.replace(recording, entries=tuple(e for e in recording.entries if "obstacle" not in e.more))
    assert replay(filtered).difference


async def test_replay_repeats_emergency_stops(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        client = await server.connect_client()
        await client.ask("vm", 100, 0, 0)
        server.daemon.step(0.5)
        server.daemon.hold([1], "viewer 1")
        for _ in range(3):
            # Error 7: held.
            assert (await client.ask("vm", 100, 0, 0)).values == (7,)
            server.daemon.step(0.5)
        server.daemon.release([1])
        assert (await client.ask("vm", 100, 0, 0)).slots[38] == 100

    recording = await recorded(tmp_path / "run.log", REAL_TIME, scenario)
    outcome = replay(recording)
    assert (outcome.answers, outcome.difference) == (6, "")
    filtered = dataclasses.replace(recording, entries=tuple(e for e in recording.entries if "hold" not in e.more))
    assert replay(filtered).difference
    # A recording of an earlier version does not say that clients were informed: they got the state.
    for entry in recording.entries:
        if "hold" in entry.more:
            del entry.more["hold"]["informs"]
    # The recorded reply: type 005b, one word, 7.
    assert "instead of 5b000100000007" in replay(recording).difference


async def test_replay_of_a_run_that_continued_a_snapshot(tmp_path: Path) -> None:
    emulator = LOCKSTEP.create_emulator()
    emulator.simulation.robots[1].set_velocities(10.0, 0.1, 0.0)
    emulator.simulation.step(1.0)
    snapshot.save(emulator, tmp_path / "saved.json")

    async def scenario(server: RunningServer) -> None:
        client = await server.connect_client()
        assert (await client.ask("gs")).slots[34] > 50
        await converse(client, 0, 20)

    run_header = dataclasses.replace(LOCKSTEP, restored=tmp_path / "saved.json")
    recording = await recorded(tmp_path / "run.log", run_header, scenario)
    # The snapshot is part of the recording: the file itself may be overwritten in the end.
    (tmp_path / "saved.json").write_text("what the daemon saved in the end")
    assert replay(recording).difference == ""


@pytest.mark.parametrize("field", ["world", "setup", "model_file"])
async def test_a_changed_file_is_named(field: str, tmp_path: Path) -> None:
    """Else the first other byte would be blamed."""
    mine = tmp_path / "mine.toml"
    room = SHIPPED.joinpath("thesis_room.toml").read_text()
    model = '[[model]]\nname = "mine"\nlike = "n150"\n'
    mine.write_text({"world": room, "setup": 'base = "noisy"'}.get(field, model))
    path: Any = mine if field == "model_file" else str(mine)
    run_header = dataclasses.replace(LOCKSTEP, config=SimulationConfig(**{field: path}))

    async def scenario(server: RunningServer) -> None:
        await converse(await server.connect_client(), 0, 2)

    recording = await recorded(tmp_path / "run.log", run_header, scenario)
    assert replay(recording).difference == ""
    # One more newline changes nothing in the world, but the file is not the recorded one.
    mine.write_text(mine.read_text() + "\n")
    with pytest.raises(RecordingError, match=f"run.log.*{mine}.*changed"):
        replay(recording)


async def test_a_difference_is_reported_with_its_position(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        await converse(await server.connect_client(), 0, 60)

    path = tmp_path / "run.log"
    await recorded(path, LOCKSTEP, scenario)
    # Another seed: the first noisy reading differs.
    path.write_text(path.read_text().replace('"seed":5', '"seed":6', 1))
    outcome = replay(read_recording(path))
    assert 0 < outcome.answers < 61
    assert outcome.difference.startswith(f"{path}, line ")
    assert " instead of " in outcome.difference


async def test_missing_bytes_at_the_end_are_a_difference(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        await server.connect_client()

    recording = await recorded(tmp_path / "run.log", LOCKSTEP, scenario)
    (answer,) = (entry for entry in recording.entries if entry.kind == "in")
    longer = dataclasses.replace(answer, data=answer.data + b"\x07")
    changed = dataclasses.replace(
        recording, entries=tuple(longer if entry is answer else entry for entry in recording.entries)
    )
    # The reply to CONNECT has 8 bytes: a header of 4 and one word.
    assert "from byte 8 on nothing instead of 07 (8 and 9 bytes)" in replay(changed).difference


def test_a_client_recording_of_an_in_process_emulator(tmp_path: Path) -> None:
    address = "sim:thesis_room?noisy=1&seed=4"
    # Two runs: a recording in process has no real times and must be equal byte by byte.
    whole = []
    for _ in range(2):
        recorder = Recorder(RecordingWriter(tmp_path / "run.log", {"address": address}))
        stream = RecordingStream(MemoryStream(open_address(address)), recorder.open("", "tcp", N150))
        for call in (Call("connect_robot", (1, 1)), *map(request, range(50))):
            stream.send(codec.encode_tcp_request(call))
            stream.receive(Deadline.after(0))
        stream.close()
        recorder.close()
        whole.append((tmp_path / "run.log").read_bytes())
    assert whole[0] == whole[1]
    outcome = replay(read_recording(tmp_path / "run.log"))
    assert (outcome.answers, outcome.difference) == (51, "")


def test_recordings_that_cannot_be_replayed(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    RecordingWriter(path, {"address": "serial:///dev/ttyUSB0"}).close()
    with pytest.raises(RecordingError, match=r"serial:///dev/ttyUSB0.*nomad play"):
        replay(read_recording(path))
    RecordingWriter(path, LOCKSTEP.to_json("", port=1, requests_a_turn=20, real_robots=1)).close()
    with pytest.raises(RecordingError, match="real robots"):
        replay(read_recording(path))
    RecordingWriter(path, {"by": "nserver"}).close()
    with pytest.raises(RecordingError, match=r"line 1.*description"):
        replay(read_recording(path))
    head = LOCKSTEP.to_json("", port=1, requests_a_turn=20)
    recorder = Recorder(RecordingWriter(path, head), lambda: 0.0)
    recorder.open("a", "tcp", N150).to_robot(b"")
    recorder.close()
    # Without "open" there is no connection "a".
    path.write_text(path.read_text().replace('"event":"open"', '"event":"time"'))
    with pytest.raises(RecordingError, match=r"line 3: .*'a' .*never"):
        replay(read_recording(path))


@pytest.mark.parametrize(("changes", "message"), [
    # Numbers beyond the longest step of a server, and entries of another shape.
    ({"steps": 3}, "line 2: not an entry of a server"), ({"steps": [["x", 1]]}, "line 2: not an entry"),
    ({"steps": [[float("nan"), 1]]}, "line 2: not an entry"), ({"steps": [[10**400, 1]]}, "line 2: not an entry"),
    ({"steps": [[250.1, 1]]}, "line 2: not an entry"), ({"steps": [[1e300, 1]]}, r"a step of 1e\+300 s"),
    ({"pace": 5}, "line 2: not an entry"), ({"pace": [1e9, False]}, "line 2: not an entry"),
    ({"hold": []}, "line 2: not an entry"),
    ({"world": 3}, "line 2: not an entry"),
    ({"hold": {"robots": [1]}}, r"line 2: not an entry of a server \(KeyError\('by'\)\)"),
    ({"hold": {"robots": [9], "by": "a"}}, "line 2: not an entry of a server"),
])  # fmt: skip
def test_invalid_entries_are_named(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = tmp_path / "run.log"
    writer = RecordingWriter(path, LOCKSTEP.to_json("", port=1, requests_a_turn=20))
    writer.write(Entry(0.0, "time", more=changes))
    writer.close()
    with pytest.raises(RecordingError, match=message):
        replay(read_recording(path))


@pytest.mark.parametrize("missing", ["wire", "model"])
def test_opening_entries_with_missing_values_are_named(tmp_path: Path, missing: str) -> None:
    path = tmp_path / "run.log"
    writer = RecordingWriter(path, LOCKSTEP.to_json("", port=1, requests_a_turn=20))
    fields = {"wire": "tcp", "model": "n150"}
    del fields[missing]
    writer.write(Entry(0.0, "open", "a", more=fields))
    writer.close()
    with pytest.raises(RecordingError, match=rf"line 2: .*KeyError\('{missing}'\)"):
        replay(read_recording(path))


@pytest.mark.parametrize("kind", ["out", "in", "close"])
def test_entries_of_closed_connections_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "run.log"
    writer = RecordingWriter(path, LOCKSTEP.to_json("", port=1, requests_a_turn=20))
    for each in ("open", "close", kind):
        writer.write(Entry(0.0, each, "a", more={"wire": "tcp", "model": "n150"} if each == "open" else {}))
    writer.close()
    with pytest.raises(RecordingError, match=r"line 4: .*'a' .*never"):
        replay(read_recording(path))


def test_the_step_limit_covers_all_steps_of_a_server() -> None:
    # The longest step: the highest time factor times the longest catch-up, or the longest step on request.
    assert MAX_STEP_S >= MAX_TIME_FACTOR * MAX_CATCH_UP_S
    assert MAX_STEP_S >= MAX_STEP_MS / 1000


@pytest.mark.parametrize(("part", "wrong"), [
    ("pace", {"lockstep_s": 1e300}), ("pace", {"factor": -1.0}), ("pace", {"paused": 3}),
    ("setting", {"seed": "x"}), ("setting", {"world": 3}), ("setting", {"robot": None}),
    ("setting", {"start": {"x_in": 1}}),
])  # fmt: skip
def test_invalid_headers_are_refused(tmp_path: Path, part: str, wrong: dict[str, Any]) -> None:
    head = LOCKSTEP.to_json("", port=1, requests_a_turn=20)
    path = tmp_path / "run.log"
    RecordingWriter(path, head | {part: head[part] | wrong}).close()
    with pytest.raises(RecordingError, match=r"line 1.*description"):
        replay(read_recording(path))


def test_a_header_survives_a_round_trip(tmp_path: Path) -> None:
    saved, models = tmp_path / "saved.json", tmp_path / "models.toml"
    saved.write_text("all of it")
    models.touch()
    setting = dataclasses.replace(THREE, model_file=models)
    run_header = RunHeader(
        setting, SimulationClock(None, True, 0.25), Allowed(quit=True), saved, snapshot_text="all of it"
    )
    RecordingWriter(tmp_path / "run.log", run_header.to_json("", port=1, requests_a_turn=2)).close()
    assert RunHeader.from_json(read_recording(tmp_path / "run.log").header, "run.log") == run_header


def test_a_world_file_is_found_from_another_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_text("")
    head = dataclasses.replace(LOCKSTEP, config=SimulationConfig("mine.toml")).to_json("", port=1, requests_a_turn=2)
    assert head["setting"]["world"] == str(tmp_path / "mine.toml")
