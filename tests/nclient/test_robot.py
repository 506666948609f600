"""Robot: every command has its verb, every verb sends its words, and leaving a robot stops it."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from typing import Any

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import DEFAULT_SONAR_ORDER, NO_STAMP, SCOUT
from nclient.robot import Robot
from nclient.state import AxisCommand, RobotState
from tests.nclient.scripted_server import ScriptedServer, error, robot_on, simple

OWN_NAMES = {"sim_truth", "sim_control", "held_by"}
ORDER = (1, 2, 3, *[255] * 13)


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.name)
def test_every_command_has_its_method(row: Command) -> None:
    method = getattr(Robot, row.method, None)
    assert method is not None, f"no Robot.{row.method} for {row.name}"
    word = "Wire name: " if row.name in OWN_NAMES else "C: "
    assert f"{word}{row.name}" in (method.__doc__ or ""), f"{row.method} does not name {row.name}"


Verb = Callable[[Robot], object]

SENT: list[tuple[Verb, str, tuple[Any, ...]]] = [
    (lambda r: r.drive(translation_in_s=10, steering_deg_s=-5), "vm", (100, -50, 0)),
    # 0.254 m/s are 10 in/s; pi / 4 are 45 degrees.
    (lambda r: r.drive(translation_m_s=0.254, turret_rad_s=math.pi / 4), "vm", (100, 0, 450)),
    (lambda r: r.drive(), "vm", (0, 0, 0)),
    (lambda r: r.move(translation_in=100, steering_rad=-math.pi / 2, turret_deg=360), "pr", (1000, -900, 3600)),
    (lambda r: r.move(translation_m=0.0254, steering_deg=1, turret_rad=math.pi), "pr", (10, 10, 1800)),
    (lambda r: r.move_to(translation_in=1, steering_deg=2, turret_deg=3), "pa", (10, 20, 30)),
    (lambda r: r.drive_axes(), "mv", (0, 0, 0, 0, 0, 0)),
    (lambda r: r.drive_axes(AxisCommand.velocity(in_s=10), turret=AxisCommand.limp()), "mv", (1, 100, 0, 0, 3, 0)),
    (lambda r: r.stop(), "st", ()),
    (lambda r: r.release(), "lp", ()),
    (lambda r: r.zero(), "zr", ()),
    (lambda r: r.wait_until_still(), "ws", (1, 1, 1, 20)),
    # ws takes whole seconds: 2.1 is rounded up.
    (lambda r: r.wait_until_still(2.1, steering=False), "ws", (1, 0, 1, 3)),
    (lambda r: r.set_speeds(translation_in_s=20, steering_deg_s=45, turret_deg_s=45), "sp", (200, 450, 450)),
    (lambda r: r.set_accelerations(translation_m_s2=0.762, steering_deg_s2=50), "ac", (300, 500, 0)),
    # 1 m = 39.37 in = 393.7 tenths.
    (lambda r: r.set_position(x_in=-123.4, y_m=1), "dp", (-1234, 394)),
    (lambda r: r.set_angles(steering_deg=90, turret_rad=-math.pi), "da", (900, -1800)),
    (lambda r: r.set_timeout(5), "conf_tm", (5,)),
    # conf_tm 0 would turn the timeout off, so that 0.2 s is rounded up to 1 s.
    (lambda r: r.set_timeout(0.2), "conf_tm", (1,)),
    (lambda r: r.configure_sonars(), "conf_sn", (15, *DEFAULT_SONAR_ORDER)),
    (lambda r: r.configure_sonars(rate=0, order=[1, 2, 3]), "conf_sn", (0, *ORDER)),
    # 60 ms = 15 x 4 ms.
    (lambda r: r.configure_sonars(interval_s=0.06, order=()), "conf_sn", (15, *[255] * 16)),
    (lambda r: r.configure_infrareds(history=5, order=[1, 2, 3]), "conf_ir", (5, *ORDER)),
    (lambda r: r.configure_compass(2), "conf_cp", (2,)),
    (lambda r: r.configure_laser(51, threshold=1, width=2, num_data=3, processing=4), "conf_ls", (51, 1, 2, 3, 4)),
    (lambda r: r.configure_segments(50, 4, 30), "conf_sg", (50, 4, 30)),
    (lambda r: r.refresh(), "gs", ()),
    (lambda r: r.read_infrareds(), "get_ir", ()),
    (lambda r: r.read_sonars(), "get_sn", ()),
    (lambda r: r.read_pose(), "get_rc", ()),
    (lambda r: r.read_velocities(), "get_rv", ()),
    (lambda r: r.read_compass(), "get_cp", ()),
    (lambda r: r.read_laser(), "get_ls", ()),
    (lambda r: r.read_bumpers(), "get_bp", ()),
    (lambda r: r.read_segments(), "get_sg", ()),
]


@pytest.mark.parametrize(("verb", "name", "args"), SENT)
def test_methods_send_commands_and_return_the_state(verb: Verb, name: str, args: tuple[Any, ...]) -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    server.slots = {0: 10, 17: 42, 34: 5, 38: 7}
    state = verb(robot)
    assert server.last() == Call(name, args)
    assert isinstance(state, RobotState)
    assert state == robot.state


def test_queries_update_their_part_of_the_state() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    server.slots = {1: 3, 17: 4, 33: 1, 34: 50, 38: 60, 43: 70}
    server.clock = 1500
    assert robot.read_infrareds().infrareds[0] == 3
    # Only the slots of the reply change: the sonars are still those of the connection.
    assert robot.state.sonars_in[0] == 0
    assert robot.read_sonars().sonars_in[0] == 4
    assert robot.read_bumpers().bumpers == (0,)
    assert robot.read_pose().x_in == 5
    assert robot.read_velocities().translation_in_s == 6
    assert robot.read_compass().compass_deg == 7
    assert robot.state.clock_s == 1.5


def test_accelerations_do_not_change_the_state() -> None:
    server = ScriptedServer()
    server.slots = {0: 10, 38: 60}
    robot = robot_on(server)
    server.slots = {38: 300, 39: 500, 40: -500}
    # get_rv and get_ra share the slots 38 to 40: an acceleration must not be read as a velocity.
    assert robot.read_accelerations() == (30, 50, -50)
    assert robot.state.translation_in_s == 6


def test_selecting_sensors_preserves_position_data() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    robot.position_data(sonars=True, compass=True)
    everything = server.last().args
    assert everything[0] == 2 + 16
    assert set(everything[1:]) == {1}
    robot.select_sensors(infrareds=(), sonars=iter([0, 15]), bumpers=False, motion=True, compass=False, laser=False)
    smask = server.last().args
    # Position data (0), sonars 0 and 15, motion (34 to 40), and Smask[41], which no option concerns.
    assert [slot for slot in range(44) if smask[slot]] == [0, 17, 32, 34, 35, 36, 37, 38, 39, 40, 41]
    assert smask[0] == 18
    robot.select_sensors(motion=False)
    assert [slot for slot in range(1, 44) if not server.last().args[slot]] == [34, 35, 36, 37, 38, 39, 40]
    robot.position_data(infrareds=True, bumpers=True, laser=True)
    assert server.last().args[0] == 1 + 4 + 8


def test_position_data_are_stamps() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    keys = [f"sonar_{number}" for number in range(16)]
    stamps = {key: NO_STAMP._replace(x=10 * number) for number, key in enumerate(keys)}
    server.answers["ct"] = Reply("state", {}, stamps=stamps, clock=1, volts=(0, 0))
    state = robot.position_data(sonars=True)
    assert [state.stamps[key].pose.x_in for key in keys] == list(range(16))


def test_speech_and_packets() -> None:
    # A header of 4 bytes is removed; a word has its byte in the low 8 bits.
    answer = (7, 0, 0, 9, 1, 2, 256 + 3)
    server = ScriptedServer({"special_request": Reply("special", values=answer)})
    robot = robot_on(server)
    robot.say("hello")
    assert server.last() == Call("tk", ("hello",))
    assert robot.send_packet(200, b"\1\2") == b"\1\2\3"
    assert server.last() == Call("special_request", (200, 1, 2))


def test_the_arm() -> None:
    result = (-5).to_bytes(4, "little", signed=True)
    # 0x3e8 = 1000, low byte first.
    answer = Reply("special", values=(12, 0, 0, 40, *result, 0xE8, 3, 0, 0))
    server = ScriptedServer(dict.fromkeys(("arm_zr", "arm_ws", "arm_mv"), answer))
    robot = robot_on(server)
    assert robot.arm_zero(override=True) == -5
    assert server.last() == Call("arm_zr", (1,))
    assert robot.arm_wait(grip=False, timeout=500) == (-5, 1000)
    assert server.last() == Call("arm_ws", (1, 0, 500))
    assert robot.arm_move(lift_mode=1, lift_value=2000, grip_mode=2, grip_value=-300) == -5
    assert server.last() == Call("arm_mv", (1, 2000, 2, -300))


def test_a_short_reply_is_a_wire_error() -> None:
    robot = robot_on(ScriptedServer({"arm_zr": Reply("special", values=(4, 0, 0, 40))}))
    with pytest.raises(WireError, match=r"arm_zr: .* 4 .*expected 8"):
        robot.arm_zero()


@pytest.mark.parametrize(
    ("verb", "wrong"),
    [
        (lambda r: r.drive(translation_in_s=1, translation_m_s=1), TypeError),
        (lambda r: r.move(steering_deg=1, steering_rad=1), TypeError),
        (lambda r: r.drive(turret_deg_s=math.nan), ValueError),
        (lambda r: r.configure_sonars(rate=1, interval_s=1), TypeError),
        (lambda r: r.configure_sonars(order=[16]), ValueError),
        (lambda r: r.set_timeout(-1), ValueError),
        (lambda r: r.set_timeout(math.inf), ValueError),
        (lambda r: r.wait_until_still(math.nan), ValueError),
        (lambda r: r.configure_serial_port(1, 9600), RobotRefused),
    ],
)
def test_invalid_arguments_are_rejected_and_not_sent(verb: Verb, wrong: type[Exception]) -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    with pytest.raises(wrong):
        verb(robot)
    assert server.names() == []
    assert not robot.closed


# a Scout has wheels


SCOUT_SENT: list[tuple[Verb, str, tuple[int, ...]]] = [
    (lambda r: r.drive(translation_in_s=10), "vm", (100, 100, 0)),
    # 45 deg/s x 0.118597 in/deg = 5.3 in/s for each wheel, in opposite directions.
    (lambda r: r.drive(translation_in_s=10, steering_deg_s=45), "vm", (153, 47, 0)),
    (lambda r: r.move(steering_deg=-90), "pr", (-106, 106, 0)),
    (lambda r: r.set_speeds(translation_in_s=20), "sp", (200, 200, 0)),
    (lambda r: r.set_accelerations(translation_in_s2=30), "ac", (300, 300, 0)),
    (lambda r: r.drive_wheels(right_in_s=10, left_m_s=-0.254), "vm", (100, -100, 0)),
    (lambda r: r.move_wheels(right_m=0.254, left_in=2), "pr", (100, 20, 0)),
]


@pytest.mark.parametrize(("verb", "name", "args"), SCOUT_SENT)
def test_motions_of_a_scout_become_wheel_speeds(verb: Verb, name: str, args: tuple[int, ...]) -> None:
    server = ScriptedServer(model=SCOUT)
    verb(robot_on(server))
    assert server.last() == Call(name, args)


@pytest.mark.parametrize(
    "verb",
    [
        lambda r: r.drive(turret_deg_s=1),
        lambda r: r.move(turret_deg=1),
        lambda r: r.set_speeds(translation_in_s=20, steering_deg_s=45),
        lambda r: r.set_accelerations(turret_deg_s2=45),
    ],
)
def test_a_scout_has_no_turret(verb: Verb) -> None:
    server = ScriptedServer(model=SCOUT)
    with pytest.raises(RobotRefused, match=r"scout .*such axis"):
        verb(robot_on(server))
    assert server.names() == []


@pytest.mark.parametrize("verb", [lambda r: r.drive_wheels(right_in_s=1), lambda r: r.move_wheels(left_in=1)])
def test_only_a_scout_has_wheel_commands(verb: Verb) -> None:
    with pytest.raises(RobotRefused, match=r"n150 .*not drive"):
        verb(robot_on(ScriptedServer()))


# errors, and leaving


def test_a_refusal_is_in_the_state_until_the_next_one() -> None:
    server = ScriptedServer({"zr": error(4)})
    robot = robot_on(server)
    with pytest.raises(RobotRefused) as refusal:
        robot.zero()
    assert refusal.value.command == "zr"
    assert robot.state.error == 4
    assert robot.refresh().error == 0


def test_a_lost_connection_closes_the_robot() -> None:
    robot = robot_on(ScriptedServer({"gs": None}))
    with pytest.raises(ReplyTimeout):
        robot.refresh()
    assert robot.closed
    with pytest.raises(ConnectionLost):
        robot.stop()


def test_leaving_the_block_stops_and_disconnects() -> None:
    server = ScriptedServer()
    with robot_on(server) as robot:
        robot.drive(translation_in_s=1)
    assert server.names() == ["vm", "st", "disconnect_robot"]
    assert robot.closed


def test_leaving_by_an_error_stops_the_robot() -> None:
    server = ScriptedServer()
    with pytest.raises(ZeroDivisionError), robot_on(server):
        raise ZeroDivisionError
    assert server.names() == ["st", "disconnect_robot"]


def test_leaving_a_lost_robot_raises_nothing() -> None:
    server = ScriptedServer({"gs": None})
    with robot_on(server) as robot, pytest.raises(ReplyTimeout):
        # st is not sent on a closed connection.
        robot.refresh()
    assert server.names() == ["gs"]


def test_a_refused_stop_is_raised_after_disconnecting() -> None:
    server = ScriptedServer({"st": error(6)})
    with pytest.raises(RobotRefused, match="st was refused"), robot_on(server):
        pass
    # The refusal is raised after the connection was closed in an orderly manner.
    assert server.names() == ["st", "disconnect_robot"]


def test_disconnect_can_be_repeated_and_stops_nothing() -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    robot.disconnect()
    robot.disconnect()
    assert server.names() == ["disconnect_robot"]


def test_execute_takes_wire_units() -> None:
    server = ScriptedServer({"get_rpx": simple(0)})
    robot = robot_on(server)
    assert robot.execute(Call("get_rpx")).values == (0,)


def test_exchanges_of_threads_do_not_overlap(monkeypatch: pytest.MonkeyPatch) -> None:
    server = ScriptedServer()
    robot = robot_on(server)
    overlapped, second_goes = threading.Event(), threading.Event()
    answer = server.send

    # The second thread gets here only if it does not wait for the reply of the first.
    def send(data: bytes) -> None:
        if second_goes.is_set():
            overlapped.set()
        second_goes.set()
        at_once.append(overlapped.wait(0.05))
        second_goes.clear()
        answer(data)

    at_once: list[bool] = []
    monkeypatch.setattr(server, "send", send)
    first = threading.Thread(target=robot.refresh)
    first.start()
    assert second_goes.wait(5)
    robot.stop()
    first.join()
    assert at_once == [False, False]
    assert server.names() == ["gs", "st"]
