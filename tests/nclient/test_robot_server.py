"""The verbs of the server: world, drawings, other robots, simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from nclient.errors import RobotRefused, WireError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import SCOUT, serial_wire_state
from nclient.robot import Arc, Robot
from nclient.state import Pose, Truth
from tests.nclient.scripted_server import ScriptedServer, error, robot_on, simple

POSE = Pose(10, 20, math.pi / 2, -math.pi)
SQUARE_IN = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]
SQUARE = (3, 0, 0, 100, 0, 100, 100)
SQUARE_M = [(x * 0.0254, y * 0.0254) for x, y in SQUARE_IN]

SENT: list[tuple[Callable[[Robot], object], str, tuple[Any, ...]]] = [
    (lambda r: r.place(POSE), "place_robot", (100, 200, 900, -1800)),
    (lambda r: r.add_obstacle(corners_in=SQUARE_IN), "add_obstacle", SQUARE),
    (lambda r: r.add_obstacle(corners_m=SQUARE_M), "add_obstacle", SQUARE),
    (lambda r: r.delete_obstacle(corners_in=SQUARE_IN), "delete_obstacle", SQUARE),
    (lambda r: r.clear_world(), "new_world", ()),
    (lambda r: r.draw_robot(POSE, 3), "draw_robot", (100, 200, 900, -1800, 3)),
    (lambda r: r.draw_line(points_in=[(0, 0), (1, 2)]), "draw_line", (0, 0, 10, 20, 1)),
    (lambda r: r.draw_arc(box_in=(0, 0, 10, 5), mode=2), "draw_arc", (0, 0, 100, 50, 0, 3600, 2)),
    (lambda r: r.draw_arc(box_m=(0, 0, 0.254, 0.127), angles_rad=(0, math.pi)), "draw_arc",
     (0, 0, 100, 50, 0, 1800, 1)),
    (lambda r: r.redraw_all(), "refresh_all", ()),
    (lambda r: r.redraw_all_traces(), "refresh_all_traces", ()),
    (lambda r: r.redraw_actual_trace(), "refresh_actual_trace", ()),
    (lambda r: r.redraw_encoder_trace(), "refresh_encoder_trace", ()),
    (lambda r: r.redraw_all_sensors(), "refresh_all_sensors", ()),
    (lambda r: r.redraw_bumper_sensor(), "refresh_bumper_sensor", ()),
    (lambda r: r.redraw_infrared_sensor(), "refresh_infrared_sensor", ()),
    (lambda r: r.redraw_sonar_sensor(), "refresh_sonar_sensor", ()),
    (lambda r: r.redraw_laser_sensor(), "refresh_laser_sensor", ()),
    (lambda r: r.redraw_client_graphics(), "refresh_client_graphics", ()),
    (lambda r: r.use_real_robot(), "real_robot", ()),
    (lambda r: r.use_simulated_robot(), "simulated_robot", ()),
    (lambda r: r.quit_server(), "quit_server", ()),
]  # fmt: skip


@pytest.mark.parametrize(("verb", "name", "args"), SENT)
def test_methods_send_their_commands(verb: Callable[[Robot], object], name: str, args: tuple[Any, ...]) -> None:
    server = ScriptedServer()
    assert verb(robot_on(server)) is None
    assert server.names() == [name]
    assert server.last().args == args


@pytest.mark.parametrize("verb", ["add_obstacle", "delete_obstacle", "move_obstacle", "draw_line", "draw_arc"])
def test_lengths_need_a_unit(verb: str) -> None:
    with pytest.raises(TypeError, match="one of them"):
        getattr(robot_on(ScriptedServer()), verb)()


def test_a_moved_obstacle_returns_its_corners() -> None:
    server = ScriptedServer({"move_obstacle": simple(3, 10, -20, 110, -20, 110, 80)})
    robot = robot_on(server)
    # Tenths of an inch: (10, -20) is the shifted corner (1, -2).
    assert robot.move_obstacle(corners_in=SQUARE_IN, shift_in=(1, -2)) == ((1, -2), (11, -2), (11, 8))
    assert server.last() == Call("move_obstacle", (*SQUARE, 10, -20))
    robot.move_obstacle(corners_m=SQUARE_M, shift_m=(0.0254, -0.0508))
    assert server.last() == Call("move_obstacle", (*SQUARE, 10, -20))


def test_read_robots_returns_poses() -> None:
    server = ScriptedServer({"get_rpx": simple(2, 10, 20, 900, -30, 40, 1800)})
    places = [list(place) for place in robot_on(server).read_robots()]
    assert places == [pytest.approx([1, 2, math.pi / 2]), pytest.approx([-3, 4, math.pi])]


def test_a_short_list_of_robots_is_a_wire_error() -> None:
    with pytest.raises(WireError, match=r"2 robots .* 3 numbers"):
        robot_on(ScriptedServer({"get_rpx": simple(2, 10, 20, 900)})).read_robots()


def test_a_clicked_pose() -> None:
    answer = Reply("configuration", values=(-10, 20, 1800, 900))
    assert robot_on(ScriptedServer({"get_robot_conf": answer})).ask_pose() == Pose(-1, 2, math.pi, math.pi / 2)


def test_a_prediction_does_not_change_the_state() -> None:
    values = tuple(range(44))
    server = ScriptedServer({"predict_sensors": Reply("prediction", values=values, laser=(1, 5, 6))})
    robot = robot_on(server)
    before = robot.state
    predicted = robot.predict_sensors(POSE)
    assert server.last() == Call("predict_sensors", (100, 200, 900, -1800))
    assert predicted == (values[1:17], values[17:33], (1, 5, 6))
    assert robot.state == before
    server.answers["predict_sensors"] = Reply("prediction", values=values)
    assert robot.predict_sensors(POSE).laser == (0,)


def test_check_motion_of_lines() -> None:
    # Hundredths of a tenth of an inch, that is 1/1000 in, and millionths of a radian.
    server = ScriptedServer({"motion_check": simple(1, 12345, -6789, 1570796)})
    robot = robot_on(server)
    hit = robot.check_motion(line_in=[(0, 0), (1, 0.5)])
    assert server.last() == Call("motion_check", (0, 0, 0, 10000, 5000))
    assert hit == (12.345, -6.789, 1.570796)
    server.answers["motion_check"] = simple(0, 1, 2, 3)
    assert robot.check_motion(line_m=[(0, 0), (0.0254, 0.0127)]) is None
    assert server.last() == Call("motion_check", (0, 0, 0, 10000, 5000))


def test_check_motion_of_arcs() -> None:
    server = ScriptedServer({"motion_check": simple(0, 0, 0, 0)})
    robot_on(server).check_motion(arc=Arc(1, 2, 1.5707963, -3.1415926, 5, 0.1, 0.2))
    kind, *numbers = server.last().args
    assert kind == 1
    # Thousandths of a tenth of an inch, and thousandths of a radian.
    assert numbers == pytest.approx([10000, 20000, 1570.796, -3141.592, 50000, 1000, 2000])


def test_connect_robot_switches_to_another_robot() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    server.slots = {17: 3}
    assert robot.connect_robot(2).sonars_in[0] == 3
    assert robot.create_robot(3).sonars_in[0] == 3
    assert [(call.name, *call.args[:1]) for call in server.calls[2:]] == [
        ("connect_robot", 2), ("gs",), ("create_robot", 3), ("gs",)
    ]  # fmt: skip
    robot.disconnect()
    # The robot that was created last is the one that is disconnected.
    assert server.last().args[0] == 3


def test_connect_robot_refuses_unknown_numbers() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    server.answers["connect_robot"] = simple(0)
    with pytest.raises(RobotRefused, match="number 9"):
        robot.connect_robot(9)
    assert not robot.closed


def test_truth_of_a_simulation() -> None:
    # 1, simulated ms, x and y in 1/1000 in, heading and turret in 1/1000 degree, seed, robot number.
    values = (1, 2100, 24370, -263, 90_000, 180_000, 7, 1)
    robot = robot_on(ScriptedServer({"sim_truth": Reply("truth", values=values)}))
    truth = robot.truth()
    assert truth == Truth(24.37, -0.263, math.pi / 2, math.pi, time_s=2.1, seed=7, robot_id=1)
    assert truth.x_m == pytest.approx(0.618998)
    assert robot.is_simulated()


@pytest.mark.parametrize("code", [1, 4])
def test_a_real_robot_has_no_truth(code: int) -> None:
    robot = robot_on(ScriptedServer({"sim_truth": error(code)}))
    with pytest.raises(RobotRefused):
        robot.truth()
    assert not robot.is_simulated()


@pytest.mark.parametrize(
    ("verb", "value", "sent"),
    [
        ("pause", 0, (1, 0)),
        ("resume", 9, (2, 0)),
        ("speed", 2.5, (3, 25)),
        ("speed", 0, (3, 0)),
        ("step", 0.25, (4, 250)),
    ],
)
def test_simulated_time_is_controlled(verb: Any, value: float, sent: tuple[int, int]) -> None:
    server = ScriptedServer({"sim_control": Reply("control", values=(1, 1500, 25, 1))})
    assert robot_on(server).control_time(verb, value) == (1.5, 2.5, True)
    assert server.last() == Call("sim_control", sent)


def test_simulated_time_beyond_25_days_is_not_negative() -> None:
    # Signed 32 bits of ms end after 24.9 days: the word is read as unsigned.
    server = ScriptedServer({"sim_control": Reply("control", values=(1, -1000, 10, 0))})
    assert robot_on(server).control_time("pause").time_s == pytest.approx((2**32 - 1000) / 1000)



def test_unknown_time_verbs_are_rejected() -> None:
    with pytest.raises(ValueError, match=r"pause, resume, .*'stop'"):
        robot_on(ScriptedServer()).control_time("stop")  # type: ignore[arg-type]


class Mute:
    """A backend that greets with nothing, as a robot's own line may."""

    wire_state, greeting, port, closed, link = serial_wire_state(SCOUT), None, 1, False, None

    def execute(self, call: Call) -> Reply:
        raise RobotRefused(call.name, None)

    def close(self) -> None:
        raise AssertionError


def test_a_robot_without_any_reply() -> None:
    robot = Robot(Mute())
    assert robot.state.raw == (0,) * 45
    with pytest.raises(RobotRefused, match="NAK"):
        robot.refresh()
    assert robot.state.error == 0


def test_the_model_is_the_backends() -> None:
    assert robot_on(ScriptedServer(model=SCOUT)).model is SCOUT
