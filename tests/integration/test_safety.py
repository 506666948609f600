"""The guarantees of docs/safety.md that no other test shows: a simulated robot stops, or does not start.

The observer is a second connection over TCP to the same robot; its requests do not reset the time-out of a motion that
another client commands. Where the test keeps a line open, the robot does not notice the end of a program, as on a real
cable. Tests in this process use the robot's own line as well (`line=1`), in simulated time.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import hypot
from pathlib import Path

import pytest

from nclient import BumperHit, ConnectionLost, NomadError, connect
from nclient.cli import main as nomad
from nclient.errors import ReplyTimeout
from nclient.robot import Robot
from nserver_emu import cli
from nserver_emu.simulation.robot import SimulatedRobot
from tests.programs.forked import Forked
from tests.waiting import wait_until

TIMEOUT_S = 30.0
# From the first frame on nothing passes in either direction: a line that is cut.
SILENCE = '[[rule]]\ndo = "silence"\nsilence_s = 1000.0\ndirection = "both"\nfirst = 1\nline = "serial"\n'
# Every byte is corrupted: a line whose checksums never match.
NOISE = '[[rule]]\ndo = "noise"\ncorrupt_percent = 100.0\ndirection = "both"\nline = "serial"\n'
# The reply to the first pr is lost; the robot has executed the request.
LOST_ANSWER = '[[rule]]\ndo = "drop"\ncommand = "pr"\ndirection = "reply"\nfirst = 1\n'
DRIVES_AND_ASKS = """
import sys, time
from nclient import connect
from tests.programs.ports import select_ports
select_ports()
robot = connect(sys.argv[1])
robot.drive(translation_in_s=0.5)
while True:
    print(robot.refresh().clock_s, flush=True)
    time.sleep(0.1)
"""
MODELS = ("n150", "n200", "scout")


def drive(robot: Robot, speed_in_s: float) -> None:
    if robot.model.name == "scout":
        robot.drive_wheels(right_in_s=speed_in_s, left_in_s=speed_in_s)
    else:
        robot.drive(translation_in_s=speed_in_s)


def refresh_many(robot: Robot, steps: int = 1000) -> None:
    for _ in range(steps):
        robot.refresh()


@contextmanager
def robot_on_a_line(folder: Path, model: str = "n150") -> Iterator[tuple[str, Robot]]:
    """Run a server with a serial line and a control socket; yield the address of the line and an observing client."""
    words = ["--port", "0", "--robot", model, "--serial-link", str(folder / "line"), "--control", str(folder / "ctl")]
    with Forked("nserver", "thesis_room", *words) as daemon:
        try:
            # Three lines: the ports of Nserver, of the serial line and of the control socket.
            places = dict(daemon.stdout.readline().split()[1:] for _ in range(3))
            # tm_s=0: the observer must not set the command timeout of the robot.
            with connect(f"nserver://{places['nserver']}/1?model={model}&tm_s=0") as observer:
                yield f"serial://{folder / 'line'}", observer
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a short path: that of a Unix socket is limited to about 100 bytes."""
    return tmp_path_factory.mktemp("s")


@contextmanager
def held_open(line: str) -> Iterator[None]:
    """Keep the pseudo-terminal open, so that it does not hang up when a program ends, as a cable."""
    cable = os.open(line.removeprefix("serial://"), os.O_RDWR | os.O_NOCTTY)
    try:
        yield
    finally:
        os.close(cable)


def is_moving(observer: Robot) -> bool:
    """Return True if the true pose changes within 0.1 s of simulated time."""
    before = observer.truth()
    # Time of the simulation, not of the test: it may be slow on a busy machine.
    wait_until(lambda: observer.truth().time_s > before.time_s + 0.1)
    after = observer.truth()
    return (before.x_in, before.y_in, before.steering_deg) != (after.x_in, after.y_in, after.steering_deg)


class ProgramError(Exception):
    """An exception of a program."""


@pytest.mark.usefixtures("serial_ports")
@pytest.mark.parametrize("error", [None, ProgramError], ids=["returns", "raises"])
def test_finished_program_stops_its_robot(error: type[ProgramError] | None, folder: Path) -> None:
    with robot_on_a_line(folder) as (line, observer), held_open(line):
        # tm_s=0 switches the timeout off, so that only the end of the program can stop the robot.
        with contextlib.suppress(ProgramError), connect(f"{line}?tm_s=0") as robot:
            robot.drive(translation_in_s=0.5)
            assert is_moving(observer)
            if error:
                raise error
        wait_until(lambda: not is_moving(observer))


@pytest.mark.usefixtures("serial_ports")
def test_killed_program_stops_robot_on_open_line(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, observer), held_open(line):
        # tm_s=2: the robot stops 2 s after the last request of the killed program.
        command = [sys.executable, "-c", DRIVES_AND_ASKS, f"{line}?tm_s=2"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            program.stdout.readline()
            assert is_moving(observer)
            program.kill()
        wait_until(lambda: not is_moving(observer))


@pytest.mark.usefixtures("serial_ports")
def test_killed_gateway_stops_robot_on_open_line(folder: Path) -> None:
    with (
        robot_on_a_line(folder) as (line, observer),
        held_open(line),
        Forked("nserver", "--port", "0", "--real", f"{line}?model=n150") as gateway,
    ):
        place = gateway.stdout.readline().split()[-1]
        with contextlib.suppress(ConnectionLost), connect(f"nserver://{place}/1") as driver:
            driver.drive(translation_in_s=0.5)
            assert is_moving(observer)
            gateway.kill()
        wait_until(lambda: not is_moving(observer))


@pytest.mark.usefixtures("serial_ports")
def test_suspended_program_stops_robot_and_resuming_keeps_it(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, observer):
        command = [sys.executable, "-c", DRIVES_AND_ASKS, f"{line}?tm_s=2&timeout_s=5"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            try:
                assert program.stdout is not None
                program.stdout.readline()
                assert is_moving(observer)
                # SIGSTOP: the process exists and its connection stays open, but it sends nothing.
                program.send_signal(signal.SIGSTOP)
                wait_until(lambda: not is_moving(observer))
                woken_s = observer.truth().time_s
                program.send_signal(signal.SIGCONT)
                # The program goes on with requests, half a second longer than the pause; they must not restart the
                # motion.
                while float(program.stdout.readline()) < woken_s + 0.5:
                    pass  # the program sends requests and gets replies
                assert not is_moving(observer)
            finally:
                program.kill()


@pytest.mark.usefixtures("serial_ports")
@pytest.mark.parametrize("plan", [SILENCE, NOISE], ids=["silence", "noise"])
def test_silent_line_stops_robot_and_raises(plan: str, folder: Path) -> None:
    (folder / "plan.toml").write_text(plan)
    with (
        robot_on_a_line(folder) as (line, observer),
        # No retries and no reconnection: the first lost reply must be reported.
        connect(f"{line}?tm_s=2&timeout_s=0.2&retries=0&reconnect=0") as robot,
    ):
        robot.drive(translation_in_s=0.5)
        assert is_moving(observer)
        assert cli.main(["ctl", "--control", str(folder / "ctl"), "faults", "set", str(folder / "plan.toml")]) == 0
        with pytest.raises((ReplyTimeout, ConnectionLost)):
            robot.refresh()
        wait_until(lambda: not is_moving(observer))
        truth = observer.truth()
        # 0.5 in/s for 2 s of timeout, and what the test itself needs.
        assert 0 < truth.x_in < 10
        assert (truth.y_in, truth.steering_deg) == (0, 0)
        assert cli.main(["ctl", "--control", str(folder / "ctl"), "faults", "clear"]) == 0


@pytest.mark.usefixtures("serial_ports")
def test_restarted_robot_gets_conf_tm_but_no_motion(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, observer):
        # feed=0: no keep-alive thread, so the new robot's timeout is visible.
        robot = connect(f"{line}?tm_s=2&feed=0&reconnect=0.2")
        robot.drive(translation_in_s=0.5)
        assert is_moving(observer)
    with robot_on_a_line(folder) as (_, observer), robot:
        wait_until(lambda: comes_back(robot))
        assert not is_moving(observer)
        # conf_tm was sent again to the new robot: the motion ends by itself.
        robot.drive(translation_in_s=0.5)
        assert is_moving(observer)
        wait_until(lambda: not is_moving(observer))


def comes_back(robot: Robot) -> bool:
    with contextlib.suppress(ConnectionLost, ReplyTimeout):
        robot.refresh()
        return True
    return False


@pytest.mark.usefixtures("serial_ports")
def test_motion_with_lost_reply_is_not_repeated(folder: Path) -> None:
    (folder / "plan.toml").write_text(LOST_ANSWER)
    with (
        robot_on_a_line(folder) as (line, observer),
        connect(f"{line}?retries=2&timeout_s=0.3&faults={folder / 'plan.toml'}") as robot,
    ):
        with pytest.raises(ReplyTimeout):
            robot.move(translation_in=2)
        # 2 in, not 4: the motion was not sent a second time.
        assert robot.wait_until_still(20).x_in == pytest.approx(2)
        assert observer.truth().x_in == pytest.approx(2)


@pytest.mark.usefixtures("serial_ports")
def test_second_program_on_line_is_rejected(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, observer), connect(line) as robot:
        robot.drive(translation_in_s=0.5)
        with pytest.raises(ConnectionLost, match="in use"):
            connect(line)
        assert is_moving(observer)
        robot.stop()
        wait_until(lambda: not is_moving(observer))


@pytest.mark.parametrize("real", MODELS)
def test_nomad_stop_works_with_wrong_model(
    real: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_on_a_line(folder, real) as (line, observer):
        for model in MODELS:
            # With a wrong model the layout of replies differs, but st and its bytes are the same.
            if model != real:
                drive(observer, 0.5)
                assert is_moving(observer)
                nomad.main(["stop", f"{line}?model={model}", "--patience", "1"])
                assert not is_moving(observer), capsys.readouterr().out


@pytest.mark.parametrize("real", MODELS)
def test_wrong_model_in_address_prevents_motion(real: str, folder: Path) -> None:
    with robot_on_a_line(folder, real) as (line, observer):
        for model in MODELS:
            if model != real:
                with pytest.raises(NomadError, match="model="):
                    connect(f"{line}?model={model}&timeout_s=0.3")
        assert not is_moving(observer)
        truth = observer.truth()
        assert (truth.x_in, truth.y_in, truth.steering_deg) == (0, 0, 0)


@pytest.mark.parametrize("model", MODELS)
def test_robot_stops_at_wall_and_can_leave_it(model: str) -> None:
    with connect(f"sim:thesis_room?line=1&bumper_stop=1&robot={model}&step_s=0.1") as robot:
        drive(robot, 10)
        with pytest.raises(BumperHit, match="stop"):
            refresh_many(robot)
        stopped = robot.truth()
        assert not robot.refresh().moving
        drive(robot, -10)
        refresh_many(robot, steps=10)
        left = robot.truth()
        # Ten steps of 0.1 s at 10 in/s are more than 3 in.
        assert abs(left.x_in - stopped.x_in) + abs(left.y_in - stopped.y_in) > 3


def stick(monkeypatch: pytest.MonkeyPatch, bumper: int) -> None:
    """Press this bumper of all robots in this process permanently."""
    pressed = vars(SimulatedRobot)["bumpers"].fget
    monkeypatch.setattr(SimulatedRobot, "bumpers", property(lambda robot: pressed(robot) | 1 << bumper))


@pytest.mark.parametrize("model", MODELS)
def test_stuck_bumper_stops_once_and_others_still_stop(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with connect(f"sim:thesis_room?line=1&bumper_stop=1&robot={model}&step_s=0.1") as robot:
        drive(robot, 10)
        refresh_many(robot, steps=10)
        stick(monkeypatch, 3)
        # The bumper is pressed in the middle of the room: the first time it counts as a contact.
        with pytest.raises(BumperHit, match="bumper 3"):
            refresh_many(robot)
        assert not robot.wait_until_still(5).moving
        stopped = robot.truth()
        assert stopped.x_in < 40, "far from any wall"
        # It stays pressed, and the robot may drive: a stuck bumper must not make the robot useless.
        refresh_many(robot, steps=10)
        assert robot.truth().x_in == stopped.x_in
        drive(robot, -10)
        refresh_many(robot, steps=5)
        assert robot.truth().x_in < stopped.x_in - 2
        drive(robot, 10)
        with pytest.raises(BumperHit) as hit:
            refresh_many(robot)
        # At the wall other bumpers stop it, and the stuck one is not named.
        assert 3 not in hit.value.bumpers
        assert not robot.refresh().moving


def test_doctor_reports_stuck_bumper(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["doctor", "sim:thesis_room?line=1", "--exchanges", "5"]
    assert nomad.main(command) == 0
    assert "none pressed" in capsys.readouterr().out
    stick(monkeypatch, 3)
    assert nomad.main(command) == 1
    assert "pressed all the time: 3" in capsys.readouterr().out


@pytest.mark.parametrize("model", MODELS)
def test_speed_limits_of_address_apply(model: str) -> None:
    def turns(robot: Robot) -> None:
        if model == "scout":
            robot.drive_wheels(right_in_s=10, left_in_s=-10)
        else:
            robot.drive(steering_deg_s=40)

    asked: tuple[Callable[[Robot], object], ...] = (
        lambda robot: drive(robot, 10), lambda robot: robot.move(translation_in=40), turns,
    )  # fmt: skip
    address = f"sim:thesis_room?line=1&robot={model}&step_s=0.1"
    with connect(address) as free, connect(f"{address}&max_speed_in_s=2&max_turn_deg_s=10") as capped:
        # 1. Without limits each command is faster than the limits below.
        (driven_in_s, _), (moved_in_s, _), (_, turned_deg_s) = (fastest(free, ask) for ask in asked)
        assert min(driven_in_s, moved_in_s) > 5
        assert turned_deg_s > 20
        # 2. With them none is; the lower bounds show that it moves at all.
        (driven_in_s, _), (moved_in_s, _), (_, turned_deg_s) = (fastest(capped, ask) for ask in asked)
        assert 1 < min(driven_in_s, moved_in_s) <= max(driven_in_s, moved_in_s) < 2.01
        assert 3 < turned_deg_s < 10.1


def fastest(robot: Robot, ask: Callable[[Robot], object]) -> tuple[float, float]:
    """Return the true speeds in inches and degrees per second in the two seconds after a command."""
    ask(robot)
    speeds_in_s, turns_deg_s = [], []
    for _ in range(20):
        before = robot.truth()
        robot.refresh()
        after = robot.truth()
        # The true speed over one step, not the velocity that the robot reports.
        took_s = after.time_s - before.time_s
        speeds_in_s.append(hypot(after.x_in - before.x_in, after.y_in - before.y_in) / took_s)
        turns_deg_s.append(abs((after.steering_deg - before.steering_deg + 180) % 360 - 180) / took_s)
    robot.stop()
    robot.wait_until_still(10)
    return max(speeds_in_s), max(turns_deg_s)
