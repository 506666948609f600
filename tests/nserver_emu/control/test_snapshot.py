"""Snapshots: restored simulations continue bit for bit, damaged and malicious files are refused in bounded time."""

from __future__ import annotations

import json
import struct
import sys
import tracemalloc
from base64 import b64decode, b64encode
from collections.abc import Callable
from enum import IntEnum
from functools import cache
from math import inf, nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from nclient.errors import SnapshotError
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.control import snapshot
from nserver_emu.control.snapshot import decoder, validate_snapshot
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.graphics import MAX_POINTS, MAX_UTTERANCES, Figure
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import open_address
from nserver_emu.simulation.axis import Arm
from nserver_emu.simulation.sonar import MAX_EARLIER_PINGS
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.world import StartPose

VERSION_2_BODY = ("sonar_ring_radius_in", "sonar_angles_rad")
BOX = (4, 400, -100, 600, -100, 600, 100, 400, 100)


def busy() -> tuple[Emulator, WireClient]:
    """Return a noisy robot in motion, with pending sonar readings, an obstacle, drawings and speech."""
    emulator = Emulator(simulation(noisy=True, seed=5))
    client, _ = meet(emulator)
    client.ask("add_obstacle", *BOX)
    client.ask("draw_robot", 1, 2, 3, 4, 2)
    client.ask("refresh_all")
    client.send("tk", codec.encode_tcp_request(Call("tk", ("hello",))))
    client.ask("conf_tm", 4)
    client.ask("create_robot", 2, 1)
    client.ask("vm", 20, 100, 0)
    client.ask("connect_robot", 1, 1)
    client.ask("dp", 100, 200)
    client.ask("pr", 250, 900, -450)
    # No multiple of any period: rings, clock and command timeout are between two events.
    emulator.simulation.step(1.2345)
    return emulator, client


def future(emulator: Emulator, client: WireClient) -> list[object]:
    """Return the replies to a client over some simulated seconds."""
    replies: list[object] = []
    for _ in range(60):
        emulator.simulation.step(0.1)
        # Readings, encoders and the ground truth show every part of the robot's state.
        replies += [client.ask("gs"), client.ask("sim_truth").values]
    replies += [client.ask("vm", 50, -100, 30), client.ask("get_rpx").values]
    for _ in range(20):
        emulator.simulation.step(0.07)
        replies.append(client.ask("gs"))
    return replies


@pytest.mark.long
def test_restored_simulation_continues_bit_for_bit(tmp_path: Path) -> None:
    emulator, client = busy()
    snapshot.save(emulator, tmp_path / "saved.json")
    restored = Emulator(simulation())
    snapshot.restore(restored, tmp_path / "saved.json")
    assert restored.simulation.time_s == emulator.simulation.time_s
    assert restored.graphics.shapes == emulator.graphics.shapes
    pings = emulator.simulation.robots[1].sonar.pings
    assert restored.simulation.robots[1].sonar.pings == pings
    # The last pings come from different places: the robot has moved between them.
    assert len({ping.x_in for ping in pings if ping}) >= 3
    assert (restored.transcript, restored.transcript.maxlen) == (emulator.transcript, MAX_UTTERANCES)
    assert snapshot.dumps(restored) == snapshot.dumps(emulator)
    again, _ = meet(restored)
    assert future(restored, again) == future(emulator, client)
    assert again.ask("delete_obstacle", *BOX).kind == "simple"
    assert [path.name for path in tmp_path.iterdir()] == ["saved.json"]


@pytest.mark.long
def test_long_runs_are_saved_in_little_memory() -> None:
    """The process keeps the memory that a save requests and returns: it would look like a leak."""
    emulator = Emulator(simulation())
    emulator.pass_time(0.1)
    for trace in (emulator.traces.actual[1], emulator.traces.encoder[1]):
        for number in range(MAX_POINTS):
            trace.add(number + 1 / 3, 0.1 * number)
    # More than any real run: full traces and thousands of shapes.
    for number in range(2000):
        emulator.graphics.draw(Figure.LINE, (number, 1000, 2000, 3000), 1)
    tracemalloc.start()
    try:
        text = snapshot.dumps(emulator)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # The peak is bounded by the size of the text itself.
    assert most < 5 * len(text)
    restored = Emulator(simulation())
    snapshot.loads(restored, text)
    assert restored.traces.actual[1].points == emulator.traces.actual[1].points
    assert restored.graphics.numbered == emulator.graphics.numbered


def test_tracks_are_saved_as_little_endian_doubles() -> None:
    emulator = Emulator(simulation())
    emulator.pass_time(0.1)
    x_in, y_in = emulator.traces.actual[1].points[0]
    points, _total, _jumps = json.loads(snapshot.dumps(emulator))["state"]["traces"][0]["1"]
    # Little-endian doubles, whatever the machine.
    assert b64decode(points) == struct.pack("<2d", x_in, y_in)


@pytest.mark.long
@pytest.mark.parametrize("setup", ["ideal", "noisy", "measured", "building", "worn"])
def test_three_models_with_all_sensors_continue_bit_for_bit(setup: str) -> None:
    others = (("n200", StartPose(70.0, 70.0, 1.0)), ("scout", StartPose(75.0, 25.0, 2.0)))
    config = SimulationConfig(start=StartPose(20.0, 20.0, 0.5), seed=6, setup=setup, others=others)

    def clients(emulator: Emulator) -> list[WireClient]:
        connected = [meet(emulator)[0] for _ in range(3)]
        for robot_id, client in enumerate(connected, start=1):
            client.ask("connect_robot", robot_id, 1)
        return connected

    def replies_of(emulator: Emulator, clients: list[WireClient]) -> list[object]:
        replies: list[object] = []
        for number in range(6):
            emulator.pass_time(0.23)
            for client in clients:
                # Each sensor is queried by its own command, as State does not have all of them.
                names = ("gs", "get_cp", "get_ir", "get_sn", "get_ls", "get_bp", "sim_truth")
                replies += [client.ask(name) for name in names]
            replies += [emulator.traces.to_state(), emulator.graphics.to_state()]
            # A motion in the middle also compares how both robots react.
            if number == 3:
                clients[2].ask("vm", -80, 50, 0)
            arm = emulator.arms[2]
            replies += [arm.lift.position_in, arm.grip.position_in, arm.is_still()]
        return replies

    emulator = Emulator(config.simulation())
    first = clients(emulator)
    for client in first:
        # Every sensor with stamps, another order of the rings, a command timeout and the arm.
        client.ask("ct", *EVERYTHING.with_position(31).smask)
        client.ask("vm", 70, 60, 50)
        client.ask("conf_sn", 2, *range(16))
        client.ask("conf_ir", 4, *range(16))
        client.ask("conf_tm", 2)
    first[1].ask("conf_cp", 2)
    first[1].ask("arm_mv", 2, 1000, 1, 50)
    emulator.pass_time(1.37)
    restored = Emulator(SimulationConfig().simulation())
    snapshot.loads(restored, snapshot.dumps(emulator))
    again = clients(restored)
    for client in again:
        client.ask("ct", *EVERYTHING.with_position(31).smask)
    # The new clients have read the state once; so must the old ones, as some slots repeat the last value.
    for client in first:
        client.ask("gs")
    assert replies_of(restored, again) == replies_of(emulator, first)
    assert snapshot.dumps(restored) == snapshot.dumps(emulator)


@pytest.mark.long
def test_saving_changes_nothing() -> None:
    (one, client), (other, watched) = busy(), busy()
    # Saving three times must not draw a random number or advance anything.
    for _ in range(3):
        snapshot.dumps(other)
    assert future(one, client) == future(other, watched)


def test_unwritable_and_missing_files_are_errors(tmp_path: Path) -> None:
    emulator, _ = busy()
    with pytest.raises(SnapshotError, match="written"):
        snapshot.save(emulator, tmp_path / "nowhere" / "saved.json")
    with pytest.raises(SnapshotError, match="read"):
        snapshot.restore(emulator, tmp_path / "nothing.json")


def test_too_long_snapshots_are_neither_read_nor_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    emulator, path = Emulator(simulation()), tmp_path / "saved.json"
    length = len(snapshot.dumps(emulator))
    # Exactly as long as allowed, then one byte longer.
    monkeypatch.setattr(snapshot, "SNAPSHOT_BYTES", length)
    snapshot.save(emulator, path)
    snapshot.restore(emulator, path)
    monkeypatch.setattr(snapshot, "SNAPSHOT_BYTES", length - 1)
    with pytest.raises(SnapshotError, match=rf"saved\.json.* {length - 1} bytes"):
        snapshot.restore(emulator, path)
    emulator.simulation.step(0.1)
    before = path.read_text()
    with pytest.raises(SnapshotError, match=r"saved\.json.*written.*--limit-graphics"):
        snapshot.save(emulator, path)
    # The old file stays, and no temporary file is left.
    assert path.read_text() == before
    assert [each.name for each in tmp_path.iterdir()] == ["saved.json"]


# Damaged and malicious files


def check_refused(text: str, match: str) -> None:
    """Check that a text is refused with bounded work and leaves the emulator unchanged."""
    emulator, client = busy()
    before, calls = client.ask("gs"), [0]

    # Function calls are counted by the profiler: the work of a refusal is bounded on any machine.
    def count(_frame: object, event: str, _argument: object) -> None:
        calls[0] += event == "call"

    sys.setprofile(count)
    try:
        with pytest.raises(SnapshotError, match=match):
            snapshot.loads(emulator, text)
    finally:
        sys.setprofile(None)
    # Most take some thousand calls; the largest trial, of a robot that must be stepped, a million. A hang never ends.
    assert calls[0] < 2_000_000
    assert client.ask("gs") == before


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("", "no snapshot"),
        ("[]", "no snapshot"),
        ('{"nomad_recording": 1}\n{"out": "00"}\n', "no snapshot"),
        ('name = "a world"\n', "no snapshot"),
        ('{"as": "nserver snapshot"}', "no snapshot"),
        ('{"format": "nserver snapshot", "version": "0.', "damaged"),
        ('{"format": "nserver snapshot", "version": "0.1", "root": {"ref": 0}, "objects": []}', "version 1.*0.1.*3"),
        ('{"format": "nserver snapshot", "format_version": 4, "version": "9.0"}', "version 4.*9.0.*3"),
        ('{"format": "nserver snapshot", "format_version": 2}', "damaged"),
        ('{"format": "nserver snapshot", "root": ' + "[" * 100_000, "damaged"),
        ('{"format": "nserver snapshot", "format_version": 2, "state": ' + "[" * 100_000, "damaged"),
    ],
)
def test_other_files_and_versions_are_refused(text: str, match: str) -> None:
    check_refused(text, match)


@cache
def saved_text() -> str:
    emulator, _ = busy()
    emulator.arms[1] = Arm()
    return snapshot.dumps(emulator)


def saved() -> dict[str, Any]:
    whole: dict[str, Any] = json.loads(saved_text())
    return whole


def set_in(whole: dict[str, Any], path: tuple[str | int, ...], value: object) -> None:
    """Replace the value at a path of keys and indices within the state."""
    part: Any = whole["state"]
    for key in path[:-1]:
        part = part[key]
    # The path must exist, otherwise the test would change nothing.
    assert path[-1] in (range(len(part)) if isinstance(part, list) else part)
    part[path[-1]] = value


ROBOT = ("simulation", "robots", "1")
SONAR = (*ROBOT, "sonar")
AXIS = (*ROBOT, "drive", 2, 0)
DEEP: list[Any] = []
for _ in range(500):
    DEEP = [DEEP]


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "value"),
    [
        # Times and intervals that would make a step endless.
        (("simulation", "time_ps"), 10**30),
        (("simulation", "time_ps"), -1),
        ((*SONAR, 7), -(10**30)),
        ((*SONAR, 5), -1),
        ((*SONAR, 5), 0),
        ((*SONAR, 4), []),
        ((*SONAR, 4), [[16]]),
        ((*SONAR, 6), -1),
        ((*SONAR, 3), [[0.0, 0.0, 0.0, 0, [0.0, 0.0]]] * (MAX_EARLIER_PINGS + 1)),
        ((*SONAR, 3), [[0.0, 0.0, 0.0, 10**15, [0.0]]]),
        ((*ROBOT, "deadline_ps"), 0),
        ((*ROBOT, "timeout_ps"), 1),
        ((*ROBOT, "compass", 3), 10**30),
        # Numbers that no simulation has.
        ((*ROBOT, "chassis", 0), 1e308),
        ((*ROBOT, "encoders", 0), inf),
        ((*ROBOT, "encoders", 0), nan),
        ((*ROBOT, "encoders", 3), 10**400),
        ((*ROBOT, "chassis", 2), True),
        ((*SONAR, 0), [5] * 15),
        ((*SONAR, 0), [256] * 16),
        ((*ROBOT, "rngs"), []),
        ((*ROBOT, "rngs", 0, 0), -1),
        # Motions beyond the limits of an axis.
        ((*AXIS, 0), 7),
        ((*AXIS, 0), True),
        ((*AXIS, 1), 1e6),
        ((*AXIS, 2), 0.0),
        ((*AXIS, 4), [[1.0, 1.0, 0.0]] * 9),
        ((*AXIS, 4), [[0.0, 1.0, 0.0]]),
        ((*AXIS, 4), [[1.0, 1e6, 0.0]]),
        ((*AXIS, 4), [[1e9, 1.0, 1e9]]),
        ((*AXIS, 4), [[None, 1.0, 1.0]]),
        ((*AXIS, 5), -1.0),
        # Models, setups and worlds that cannot be simulated.
        ((*ROBOT, "model", "body", "radius_in"), 0.0),
        ((*ROBOT, "model", "body", "ring", "angles_rad"), []),
        ((*ROBOT, "model", "axes", 0, "top_speed"), 1e9),
        ((*ROBOT, "model", "track_in"), 1e-9),
        ((*ROBOT, "model", "has_light_sensors"), True),
        ((*ROBOT, "setup", "clock_step_s"), -1.0),
        ((*ROBOT, "setup", "sonar", "offsets_in"), []),
        ((*ROBOT, "setup", "sonar", "type"), "os:system"),
        ((*ROBOT, "setup", "sonar", "type"), "polaroid"),
        (("simulation", "world", "starts"), []),
        (("simulation", "world", "obstacles", 0, "corners_in"), [[0.0, 0.0]]),
        (("simulation", "group", 0, 1), []),
        (("simulation", "robots"), {}),
        (("simulation", "robots"), {"no": {}}),
        (("simulation", "seed"), -1),
        # Other parts.
        (("clock", "factor"), 1e9),
        (("arms", "1", 2), 1e9),
        (("arms", "1", 0, 0), -1.0),
        (("arms",), {"7": [[0.0, [0, 1.0, 1.0, 0.0, [], 0.0]], [0.0, [0, 1.0, 1.0, 0.0, [], 0.0]], 0.0]}),
        (("traces", 0, "1", 0), b64encode(b"odd").decode()),
        (("traces", 0, "1", 0), b64encode(struct.pack("<2d", nan, 0.0)).decode()),
        (("traces", 0, "1", 0), "not base64"),
        (("graphics", 1), {"sonar": "often"}),
        (("transcript",), [[0.0, 1, 2]]),
        # Structure.
        (("simulation",), []),
        (("simulation", "robots"), []),
        (("transcript",), {}),
        (("simulation", "world", "rooms"), DEEP),
        (("simulation", "world", "name"), 3),
        ((*ROBOT, "powered"), 1),
        ((*ROBOT, "infrared"), [[], [], 0, [], 0]),
    ],
)
def test_impossible_values_are_refused(path: tuple[str | int, ...], value: object) -> None:
    whole = saved()
    set_in(whole, path, value)
    check_refused(json.dumps(whole), "damaged")


@pytest.mark.long
@pytest.mark.parametrize("name", ["drive", "rngs"])
def test_missing_and_additional_fields_are_refused(name: str) -> None:
    whole = saved()
    # A field is removed, then one is added.
    del whole["state"]["simulation"]["robots"]["1"][name]
    check_refused(json.dumps(whole), "RobotState")
    whole = saved()
    whole["state"]["simulation"]["robots"]["1"]["__class__"] = 1
    check_refused(json.dumps(whole), "RobotState")


def test_values_a_state_cannot_hold_are_not_saved() -> None:
    emulator, _ = busy()
    # NaN is no JSON.
    emulator.clock.factor = nan
    with pytest.raises(ValueError, match="JSON"):
        snapshot.dumps(emulator)


def test_a_group_with_realistic_sonars_passes_the_trial() -> None:
    validate_snapshot(open_address("sim:thesis_room?robots=8&setup=measured").emulator.simulation.to_state())


def test_the_trial_refuses_overflowing_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    state = open_address("sim:thesis_room").emulator.simulation.to_state()
    # 1e308 squared overflows: the trial computes with errors of numpy switched on.
    monkeypatch.setattr("nserver_emu.control.snapshot.state_slots", lambda *_: np.array([1e308]) * 1e308)
    with pytest.raises(FloatingPointError):
        validate_snapshot(state)


class Colour(IntEnum):
    RED = 1


class Row(NamedTuple):
    name: str
    colour: Colour
    sizes: tuple[float, ...]
    parent: int | None
    by_number: dict[int, bool]


def test_values_are_decoded_by_their_declarations() -> None:
    decode: Callable[[Any], Any] = decoder(Row)
    row = decode(["a", 1, [1, 2.5], None, {"3": True}])
    assert row == Row("a", Colour.RED, (1.0, 2.5), None, {3: True})
    # An integer in JSON becomes a float where the declaration has one.
    assert type(row.sizes[0]) is float
    for damaged in (
        ["a", 1, [1], None], ["a", 2, [], None, {}], ["a", 1.0, [], None, {}], ["a", 1, "12", None, {}],
        [1, 1, [], None, {}], ["a", 1, [], 0.5, {}], ["a", 1, [], None, {"x": True}], ["a", 1, [], None, {"1": 1}],
        {"name": "a"},
    ):  # fmt: skip
        with pytest.raises((ValueError, KeyError)):
            decode(damaged)


SHAPE = [1, ["line", [1, 2, 3, 4], "Blue", False]]


@pytest.mark.parametrize(
    ("path", "value"),
    [
        # A line with three numbers, a colour that is markup, a number beyond a word, shapes out of order, ...
        (("graphics",), [1, {}, [[1, ["line", [1, 2, 3], "Blue", False]]], []]),
        (("graphics",), [1, {}, [[1, ["line", [1, 2, 3, 4], "<script>", False]]], []]),
        (("graphics",), [1, {}, [[1, ["line", [1, 2, 3, 2**40], "Blue", False]]], []]),
        (("graphics",), [2, {}, [[2, SHAPE[1]], [1, ["arc", [0] * 6, "Blue", False]]], []]),
        (("graphics",), [0, {}, [SHAPE], []]),
        (("graphics",), [3, {}, [SHAPE], [[9, 1]]]),
        (("traces",), [{"1": ["", 3, [4]]}, {}, 0]),
        (("traces",), [{"1": ["", 3, [2, 1]]}, {}, 0]),
        (("traces",), [{"1": ["AAAAAAAA8H8AAAAAAADwfw==", 1, []]}, {}, 0]),
        (("simulation", "world", "rooms"), [{"corners_in": [[0, 0], [1e9, 0], [0, 9]], "name": ""}]),
        # One wall more than the most that are read.
        pytest.param(("simulation", "world", "inner_walls"), [[0, 0, 1, 1]] * 100_001, marks=pytest.mark.long),
        (("simulation", "world", "starts"),
         [{"x_in": 0, "y_in": 0, "steering_rad": 0, "turret_rad": 0}] * 1001),
    ],
)  # fmt: skip
def test_values_that_would_fail_later_are_refused(path: tuple[str | int, ...], value: object) -> None:
    whole = saved()
    set_in(whole, path, value)
    check_refused(json.dumps(whole), "damaged")


@pytest.mark.long
@pytest.mark.parametrize(
    ("path", "value", "named"),
    [
        ((*ROBOT, "powered"), 1, r"state\.simulation\.robots\[1\]\.powered: expected true"),
        (("simulation", "world", "rooms"), [5], r"state\.simulation\.world\.rooms\[0\]: expected an object"),
        (("graphics",), [1, {}, [[1, ["oval", [], "Blue", False]]], []], r"graphics\[2\]\[0\]\[1\]\[0\]: .*oval"),
    ],
)
def test_a_wrong_type_is_named_by_its_key(path: tuple[str | int, ...], value: object, named: str) -> None:
    whole = saved()
    set_in(whole, path, value)
    check_refused(json.dumps(whole), named)


@pytest.mark.parametrize("filling", ["[],", "{},", "1,"])
def test_a_huge_text_is_refused_before_it_is_read(filling: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Limits are lowered, so that the test's text can be short.
    monkeypatch.setattr(snapshot, "MAX_CONTAINERS", 500_000)
    monkeypatch.setattr(snapshot, "MAX_VALUES", 500_000)
    text = '{"format": "nserver snapshot", "format_version": 3, "state": [' + filling * 600_000 + "0]}"
    emulator, _ = busy()
    tracemalloc.start()
    try:
        with pytest.raises(SnapshotError, match="at most 500000"):
            snapshot.loads(emulator, text)
        # Less than a megabyte: the text was not parsed into objects.
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_snapshots_of_version_2_have_the_rings_of_nomads() -> None:
    emulator, client = busy()
    whole = json.loads(snapshot.dumps(emulator))
    # In version 2 the ring was two fields of the body, and the firing order had single sonars.
    for robot in whole["state"]["simulation"]["robots"].values():
        ring = robot["model"]["body"].pop("ring")
        robot["model"]["body"].update(zip(VERSION_2_BODY, (ring["radius_in"], ring["angles_rad"]), strict=True))
        robot["sonar"][4] = [sonar for (sonar,) in robot["sonar"][4]]
    expected = future(emulator, client)
    again, other = busy()
    snapshot.loads(again, json.dumps(whole | {"format_version": 2}))
    assert future(again, other) == expected
