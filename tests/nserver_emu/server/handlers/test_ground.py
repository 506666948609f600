"""The world's commands over the wire: obstacles that sonars and wheels meet, places, predictions."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.server_state import Allowed
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation.models import N200
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.world import StartPose

BOX = (400, -100, 600, -100, 600, 100, 400, 100)
"""A box ahead of the robot at the origin, in tenths: its near face is 40 in away."""


@pytest.fixture
def emulator() -> Emulator:
    return Emulator(simulation())


@pytest.fixture
def client(emulator: Emulator) -> WireClient:
    return meet(emulator)[0]


def ahead(emulator: Emulator, client: WireClient) -> int:
    """Return the reading of the front sonar after a whole ring."""
    emulator.simulation.step(1.0)
    reading: int = client.ask("get_sn").slots[17]
    return reading


def test_an_obstacle_affects_sonar_and_wheels_until_deleted(emulator: Emulator, client: WireClient) -> None:
    empty = ahead(emulator, client)
    assert client.ask("add_obstacle", 4, *BOX).values == (0,)
    # From the sonar ring (9.06 in) to the near face.
    assert ahead(emulator, client) == round(40 - 9.06)
    client.ask("vm", 200, 0, 0)
    emulator.simulation.step(5.0)
    # The body (9.72 in) touches the face: 40 - 9.72 in.
    assert client.ask("get_rc").slots[34] == pytest.approx(400 - 97.2, abs=1)
    client.ask("place_robot", 0, 0, 0, 0)
    assert client.ask("delete_obstacle", 4, *BOX).values == (0,)
    client.ask("st")
    client.ask("place_robot", 0, 0, 0, 0)
    assert ahead(emulator, client) == empty


@pytest.mark.parametrize("first", range(4))
@pytest.mark.parametrize("direction", [1, -1])
def test_an_obstacle_is_found_from_any_corner_and_direction(client: WireClient, first: int, direction: int) -> None:
    # Four first corners and two directions: eight descriptions of the same polygon.
    corners = [BOX[k : k + 2] for k in range(0, 8, 2)][::direction]
    client.ask("add_obstacle", 4, *BOX)
    turned = [number for corner in corners[first:] + corners[:first] for number in corner]
    assert client.ask("delete_obstacle", 4, *turned).values == (0,)
    assert client.ask("delete_obstacle", 4, *BOX).values == (2,)


def test_a_moved_obstacle_answers_where_its_corners_are_now(emulator: Emulator, client: WireClient) -> None:
    client.ask("add_obstacle", 4, *BOX)
    # x + 5.0 in, y - 2.0 in.
    moved = tuple(at + (50 if k % 2 == 0 else -20) for k, at in enumerate(BOX))
    assert client.ask("move_obstacle", 4, *BOX, 50, -20).values == (4, *moved)
    assert ahead(emulator, client) == round(45 - 9.06)
    assert client.ask("move_obstacle", 4, *BOX, 50, -20).values == (2,)
    # 40 in to the left it would overlap the robot.
    assert client.ask("move_obstacle", 4, *moved, -400, 0).values == (2,)
    assert client.ask("delete_obstacle", 4, *moved).values == (0,)


@pytest.mark.parametrize(
    "args",
    [
        (1, 400, 0),
        (2, 400, 0, 500, 0),
        (3, 400, 0, 500, 0, 600, 0),
        (3, 400, 0, 400, 0, 500, 100),
        (4, 400, 0, 500, 100, 500, 0, 400, 100),
        (4, -50, -50, 50, -50, 50, 50, -50, 50),
        (4, -500, -500, 500, -500, 500, 500, -500, 500),
        (3, 80, 0, 200, -50, 200, 50),
    ],
    ids=["a point", "a line", "no area", "a corner twice", "crossed", "in the robot", "around it", "into its rim"],
)
def test_what_is_no_obstacle_or_stands_in_a_robot_is_refused(
    emulator: Emulator, client: WireClient, args: tuple[int, ...]
) -> None:
    assert client.ask("add_obstacle", *args).values == (2,)
    assert emulator.simulation.world.obstacles == ()


def test_obstacles_have_a_limit(emulator: Emulator, client: WireClient) -> None:
    emulator.allowed = Allowed(obstacles=2)
    replies = [client.ask("add_obstacle", 4, *BOX) for _ in range(3)]
    assert [reply.values for reply in replies] == [(0,), (0,), (5,)]


def test_a_new_world_has_no_obstacles_but_all_its_walls(emulator: Emulator, client: WireClient) -> None:
    client.ask("add_obstacle", 4, *BOX)
    walls = emulator.simulation.world.fixed_walls
    assert client.ask("new_world").values == (0,)
    assert emulator.simulation.world.obstacles == ()
    assert (emulator.simulation.world.walls == walls).all()


def test_a_robot_cannot_be_placed_where_an_obstacle_stands(client: WireClient) -> None:
    client.ask("add_obstacle", 4, *BOX)
    # Inside the box; overlapping its face (31.0 + 9.72 > 40); just clear of it (30.2 + 9.72 < 40).
    assert client.ask("place_robot", 500, 0, 0, 0).values == (2,)
    assert client.ask("place_robot", 310, 0, 0, 0).values == (2,)
    assert client.ask("place_robot", 302, 0, 0, 0).values == (0,)


def test_a_robot_cannot_be_placed_on_another(client: WireClient) -> None:
    client.ask("create_robot", 2, 1)
    client.ask("place_robot", 300, 0, 0, 0)
    # 19.0 in are less than two radii of 9.72 in. Its own disc does not count.
    assert client.ask("place_robot", 190, 0, 0, 0).values == (2,)
    assert client.ask("place_robot", 301, 0, 900, 0).values == (0,)


def test_a_prediction_sees_the_other_robots(client: WireClient) -> None:
    client.ask("create_robot", 2, 1)
    client.ask("place_robot", 600, 600, 0, 0)
    client.ask("connect_robot", 1, 1)
    # Distance of the centres, minus the other robot's radius and the sonar ring.
    assert client.ask("predict_sensors", 300, 600, 0, 0).values[17] == round(30 - 9.72 - 9.06)


def test_get_rpx_returns_actual_positions_by_robot_number(client: WireClient) -> None:
    client.ask("create_robot", 7, 1)
    client.ask("place_robot", 500, 600, 900, 450)
    client.ask("dp", 1, 2)
    # Number of robots, then x, y and steering of each; dp does not change the actual position.
    assert client.ask("get_rpx").values == (2, 0, 0, 0, 500, 600, 900)


def test_without_a_window_the_pose_clicked_is_the_actual_one(client: WireClient) -> None:
    client.ask("place_robot", 100, 200, 900, 450)
    client.ask("dp", 0, 0)
    client.ask("da", 0, 0)
    assert client.ask("get_robot_conf").values == (100, 200, 900, 450)


def test_a_prediction_equals_the_readings_at_that_pose(emulator: Emulator, client: WireClient) -> None:
    client.ask("add_obstacle", 4, *BOX)
    before = client.ask("gs").slots
    predicted = client.ask("predict_sensors", 200, 300, 900, 3150)
    assert predicted.kind == "prediction"
    # A prediction changes no sensor of the robot itself.
    assert client.ask("gs").slots == before
    client.ask("place_robot", 200, 300, 900, 3150)
    # Rate 1: a whole ring is fired within the step.
    client.ask("conf_sn", 1, *range(16))
    emulator.simulation.step(1.0)
    slots = client.ask("gs").slots
    assert predicted.values[17:33] == tuple(slots[k] for k in range(17, 33))
    assert predicted.values[34:38] == tuple(slots[k] for k in range(34, 38))


@pytest.mark.parametrize("change", ["none", "pose", "obstacle", "other robot", "model"])
def test_a_prepared_prediction_equals_one_at_once(emulator: Emulator, change: str) -> None:
    simulation = emulator.simulation
    for number, place in ((2, (60.0, 60.0)), (3, (85.0, 10.0))):
        simulation.add_robot(number, StartPose(*place), N200)
    client, context = meet(emulator)[0], ConnectionContext(robot_id=1)
    call = Call("predict_sensors", (200, 600, 900, 3150))
    # 1. Some of it, or all.
    for _ in range(30):
        if emulator.prepare_reply(context, call):
            break
    prepared = context.prediction
    assert prepared is not None
    # 2. What it depends on.
    match change:
        case "pose":
            call = Call("predict_sensors", (200, 610, 900, 3150))
        case "obstacle":
            client.ask("add_obstacle", 4, *(number + 300 for number in BOX))
        case "other robot":
            simulation.place(2, 60.0, 50.0, 0.0, 0.0)
        case "model":
            context.robot_id = 3
    # 3. The reply is that of a connection that prepared nothing.
    steps = emulator.preparations[call.name](emulator, context, call.args)
    assert (context.prediction is prepared) == (change == "none")
    assert (next(steps, "all done") == "all done") == (change == "none")
    reply = emulator.answer(call, context)
    assert reply == emulator.answer(call, ConnectionContext(robot_id=context.robot_id))
    assert context.prediction is None


def test_a_prepared_prediction_reads_no_sensor_again(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> None:
    emulator.simulation.add_robot(2, StartPose(60.0, 60.0), N200)
    context, call = ConnectionContext(robot_id=2), Call("predict_sensors", (200, 600, 900, 3150))
    context.wire_state.laser_mode = 51
    expected = emulator.answer(call, replace(context))
    while not emulator.prepare_reply(context, call):
        pass
    for name in ("sonar.SonarNoise.measured_ranges", "sensors.InfraredRing._ranges", "robot.SimulatedRobot.__init__"):
        monkeypatch.setattr(f"nserver_emu.simulation.{name}", None)
    assert isinstance(expected, Reply)
    assert expected.laser
    assert emulator.answer(call, context) == expected


def test_motion_check_returns_position_and_normal(client: WireClient) -> None:
    client.ask("add_obstacle", 4, *BOX)
    # Thousandths of a tenth of an inch: a line of 100 in. The reply has thousandths of an inch and millionths of a
    # radian.
    thousandths = (0, 0, 0, 1_000_000, 0)
    assert client.ask("motion_check", *thousandths).values == (1, 40_000, 0, round(math.pi * 1e6))
    # 39.9 in: just before the box.
    assert client.ask("motion_check", 0, 0, 0, 399_000, 0).values == (0, 0, 0, 0)
    quarter = round(math.pi / 2 * 1000)
    arc = (1, 300_000, 0, 0, quarter, 300_000, 0, 0)
    assert client.ask("motion_check", *arc).values == (0, 0, 0, 0)
    hit = client.ask("motion_check", 1, 300_000, 0, 0, quarter, 300_000, 200_000, 0)
    assert hit.values[0] == 1
    # A negative radius is refused.
    assert client.ask("motion_check", 1, 0, 0, 0, quarter, -10_000, 0, 0).values == (2,)
