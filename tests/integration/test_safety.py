"""What docs/safety.md promises and no other room shows: an emulated robot comes to rest, or does not set out.

On a pseudo-terminal the eye is a second connection, over TCP; its questions feed no motion that another drives. Where a
cable is held open, the end of a program is no news to the robot, as on a real one.
In this process the robot has its own line as well (`line=1`), in simulated time.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
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

WHOLE_S = 30.0
SILENCE = '[[rule]]\ndo = "silence"\nsilence_s = 1000.0\ndirection = "both"\nfirst = 1\nline = "serial"\n'
NOISE = '[[rule]]\ndo = "noise"\ncorrupt_percent = 100.0\ndirection = "both"\nline = "serial"\n'
LOST_ANSWER = '[[rule]]\ndo = "drop"\ncommand = "pr"\ndirection = "reply"\nfirst = 1\n'
DRIVES_AND_ASKS = """
import sys, time
from nclient import connect
robot = connect(sys.argv[1])
robot.drive(translation_in_s=0.5)
while True:
    print(robot.refresh().clock_s, flush=True)
    time.sleep(0.1)
"""
MODELS = ("n150", "n200", "scout")


def drives(robot: Robot, speed_in_s: float) -> None:
    if robot.model.name == "scout":
        robot.drive_wheels(right_in_s=speed_in_s, left_in_s=speed_in_s)
    else:
        robot.drive(translation_in_s=speed_in_s)


def goes_on(robot: Robot, steps: int = 1000) -> None:
    for _ in range(steps):
        robot.refresh()


@contextmanager
def robot_on_a_line(folder: Path, model: str = "n150") -> Iterator[tuple[str, Robot]]:
    """A daemon with a pseudo-terminal and a control socket: its line's address, and an eye."""
    words = ["--port", "0", "--robot", model, "--serial-link", str(folder / "line"), "--control", str(folder / "ctl")]
    with Forked("nserver", "thesis_room", *words) as daemon:
        try:
            places = dict(daemon.stdout.readline().split()[1:] for _ in range(3))
            with connect(f"nserver://{places['nserver']}/1?model={model}&tm_s=0") as eye:
                yield f"serial://{folder / 'line'}", eye
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short path: a Unix socket's has about a hundred bytes."""
    return tmp_path_factory.mktemp("s")


@contextmanager
def held_open(line: str) -> Iterator[None]:
    """Its pseudo-terminal does not hang up when a program goes, as no cable does."""
    cable = os.open(line.removeprefix("serial://"), os.O_RDWR | os.O_NOCTTY)
    try:
        yield
    finally:
        os.close(cable)


def until(true: Callable[[], bool]) -> None:
    end_s = time.monotonic() + WHOLE_S
    while not true():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def moves(eye: Robot) -> bool:
    """By the truth, over a tenth of a second of the robot's time."""
    before = eye.truth()
    until(lambda: eye.truth().time_s > before.time_s + 0.1)
    after = eye.truth()
    return (before.x_in, before.y_in, before.steering_deg) != (after.x_in, after.y_in, after.steering_deg)


class MishapError(Exception):
    """What a program raises."""


@pytest.mark.parametrize("error", [None, MishapError], ids=["it ends", "it raises"])
def test_a_program_that_is_over_has_stopped_its_robot(error: type[MishapError] | None, folder: Path) -> None:
    with robot_on_a_line(folder) as (line, eye), held_open(line):
        with contextlib.suppress(MishapError), connect(f"{line}?tm_s=0") as robot:
            robot.drive(translation_in_s=0.5)
            assert moves(eye)
            if error:
                raise error
        until(lambda: not moves(eye))


def test_a_program_that_is_killed_leaves_its_robot_at_rest_though_the_cable_is_whole(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, eye), held_open(line):
        command = [sys.executable, "-c", DRIVES_AND_ASKS, f"{line}?tm_s=2"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            program.stdout.readline()
            assert moves(eye)
            program.kill()
        until(lambda: not moves(eye))


def test_a_gateway_that_is_killed_leaves_its_robot_at_rest_though_the_cable_is_whole(folder: Path) -> None:
    with (
        robot_on_a_line(folder) as (line, eye),
        held_open(line),
        Forked("nserver", "--port", "0", "--real", f"{line}?model=n150") as gateway,
    ):
        place = gateway.stdout.readline().split()[-1]
        with contextlib.suppress(ConnectionLost), connect(f"nserver://{place}/1") as driver:
            driver.drive(translation_in_s=0.5)
            assert moves(eye)
            gateway.kill()
        until(lambda: not moves(eye))


def test_a_laptop_that_sleeps_leaves_a_robot_at_rest_that_stays_there_when_it_wakes(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, eye):
        command = [sys.executable, "-c", DRIVES_AND_ASKS, f"{line}?tm_s=2&timeout_s=5"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            try:
                assert program.stdout is not None
                program.stdout.readline()
                assert moves(eye)
                program.send_signal(signal.SIGSTOP)
                until(lambda: not moves(eye))
                woken_s = eye.truth().time_s
                program.send_signal(signal.SIGCONT)
                while float(program.stdout.readline()) < woken_s + 0.5:
                    pass  # the program asks on, and is answered
                assert not moves(eye)
            finally:
                program.kill()


@pytest.mark.parametrize("plan", [SILENCE, NOISE], ids=["nothing arrives", "nothing arrives whole"])
def test_a_line_that_carries_nothing_stops_the_robot_and_the_program_is_told(plan: str, folder: Path) -> None:
    (folder / "plan.toml").write_text(plan)
    with (
        robot_on_a_line(folder) as (line, eye),
        connect(f"{line}?tm_s=2&timeout_s=0.2&retries=0&reconnect=0") as robot,
    ):
        robot.drive(translation_in_s=0.5)
        assert moves(eye)
        assert cli.main(["ctl", "--control", str(folder / "ctl"), "faults", "set", str(folder / "plan.toml")]) == 0
        with pytest.raises((ReplyTimeout, ConnectionLost)):
            robot.refresh()
        until(lambda: not moves(eye))
        truth = eye.truth()
        assert 0 < truth.x_in < 10
        assert (truth.y_in, truth.steering_deg) == (0, 0)
        assert cli.main(["ctl", "--control", str(folder / "ctl"), "faults", "clear"]) == 0


def test_a_robot_switched_off_and_on_is_told_its_time_out_again_and_no_motion(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, eye):
        robot = connect(f"{line}?tm_s=2&feed=0&reconnect=0.2")
        robot.drive(translation_in_s=0.5)
        assert moves(eye)
    with robot_on_a_line(folder) as (_, eye), robot:
        until(lambda: comes_back(robot))
        assert not moves(eye)
        robot.drive(translation_in_s=0.5)
        assert moves(eye)
        until(lambda: not moves(eye))


def comes_back(robot: Robot) -> bool:
    with contextlib.suppress(ConnectionLost, ReplyTimeout):
        robot.refresh()
        return True
    return False


def test_a_motion_whose_answer_is_lost_is_done_once(folder: Path) -> None:
    (folder / "plan.toml").write_text(LOST_ANSWER)
    with (
        robot_on_a_line(folder) as (line, eye),
        connect(f"{line}?retries=2&timeout_s=0.3&faults={folder / 'plan.toml'}") as robot,
    ):
        with pytest.raises(ReplyTimeout):
            robot.move(translation_in=2)
        assert robot.wait_until_still(20).x_in == pytest.approx(2)
        assert eye.truth().x_in == pytest.approx(2)


def test_a_second_program_on_the_cable_is_refused_and_the_first_has_its_robot(folder: Path) -> None:
    with robot_on_a_line(folder) as (line, eye), connect(line) as robot:
        robot.drive(translation_in_s=0.5)
        with pytest.raises(ConnectionLost, match="is in use by"):
            connect(line)
        assert moves(eye)
        robot.stop()
        until(lambda: not moves(eye))


@pytest.mark.parametrize("real", MODELS)
def test_nomad_stop_stops_a_robot_of_another_model_than_the_address_says(
    real: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot_on_a_line(folder, real) as (line, eye):
        for said in MODELS:
            if said != real:
                drives(eye, 0.5)
                assert moves(eye)
                nomad.main(["stop", f"{line}?model={said}", "--patience", "1"])
                assert not moves(eye), capsys.readouterr().out


@pytest.mark.parametrize("real", MODELS)
def test_a_robot_of_another_model_than_the_address_says_does_not_move(real: str, folder: Path) -> None:
    with robot_on_a_line(folder, real) as (line, eye):
        for said in MODELS:
            if said != real:
                with pytest.raises(NomadError, match="model="):
                    connect(f"{line}?model={said}&timeout_s=0.3")
        assert not moves(eye)
        truth = eye.truth()
        assert (truth.x_in, truth.y_in, truth.steering_deg) == (0, 0, 0)


@pytest.mark.parametrize("model", MODELS)
def test_a_wall_stops_a_robot_that_may_then_leave_it(model: str) -> None:
    with connect(f"sim:thesis_room?line=1&bumper_stop=1&robot={model}&step_s=0.1") as robot:
        drives(robot, 10)
        with pytest.raises(BumperHit, match="the robot was told to stop"):
            goes_on(robot)
        stopped = robot.truth()
        assert not robot.refresh().moving
        drives(robot, -10)
        goes_on(robot, steps=10)
        left = robot.truth()
        assert abs(left.x_in - stopped.x_in) + abs(left.y_in - stopped.y_in) > 3


def stick(monkeypatch: pytest.MonkeyPatch, bumper: int) -> None:
    """From now on this bumper of the robots in this process is pressed, whatever touches them."""
    pressed = vars(SimulatedRobot)["bumpers"].fget
    monkeypatch.setattr(SimulatedRobot, "bumpers", property(lambda robot: pressed(robot) | 1 << bumper))


@pytest.mark.parametrize("model", MODELS)
def test_a_bumper_that_sticks_stops_the_robot_once_and_another_stops_it_still(
    model: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with connect(f"sim:thesis_room?line=1&bumper_stop=1&robot={model}&step_s=0.1") as robot:
        drives(robot, 10)
        goes_on(robot, steps=10)
        stick(monkeypatch, 3)
        with pytest.raises(BumperHit, match="bumper 3 touches; the robot was told to stop"):
            goes_on(robot)
        assert not robot.wait_until_still(5).moving
        stopped = robot.truth()
        assert stopped.x_in < 40, "far from any wall"
        goes_on(robot, steps=10)
        assert robot.truth().x_in == stopped.x_in
        drives(robot, -10)
        goes_on(robot, steps=5)
        assert robot.truth().x_in < stopped.x_in - 2
        drives(robot, 10)
        with pytest.raises(BumperHit) as hit:
            goes_on(robot)
        assert 3 not in hit.value.bumpers
        assert not robot.refresh().moving


def test_nomad_doctor_names_a_bumper_that_sticks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["doctor", "sim:thesis_room?line=1", "--exchanges", "5"]
    assert nomad.main(command) == 0
    assert "none pressed" in capsys.readouterr().out
    stick(monkeypatch, 3)
    assert nomad.main(command) == 1
    assert "pressed all the time: 3" in capsys.readouterr().out


@pytest.mark.parametrize("model", MODELS)
def test_a_robot_goes_and_turns_no_faster_than_its_address_lets_it(model: str) -> None:
    def turns(robot: Robot) -> None:
        if model == "scout":
            robot.drive_wheels(right_in_s=10, left_in_s=-10)
        else:
            robot.drive(steering_deg_s=40)

    asked: tuple[Callable[[Robot], object], ...] = (
        lambda robot: drives(robot, 10), lambda robot: robot.move(translation_in=40), turns,
    )  # fmt: skip
    address = f"sim:thesis_room?line=1&robot={model}&step_s=0.1"
    with connect(address) as free, connect(f"{address}&max_speed_in_s=2&max_turn_deg_s=10") as capped:
        (driven_in_s, _), (moved_in_s, _), (_, turned_deg_s) = (fastest(free, ask) for ask in asked)
        assert min(driven_in_s, moved_in_s) > 5
        assert turned_deg_s > 20
        (driven_in_s, _), (moved_in_s, _), (_, turned_deg_s) = (fastest(capped, ask) for ask in asked)
        assert 1 < min(driven_in_s, moved_in_s) <= max(driven_in_s, moved_in_s) < 2.01
        assert 3 < turned_deg_s < 10.1


def fastest(robot: Robot, ask: Callable[[Robot], object]) -> tuple[float, float]:
    """In inches and degrees a second, by the truth, in the two seconds after it was asked for something."""
    ask(robot)
    ways_in_s, turns_deg_s = [], []
    for _ in range(20):
        before = robot.truth()
        robot.refresh()
        after = robot.truth()
        took_s = after.time_s - before.time_s
        ways_in_s.append(hypot(after.x_in - before.x_in, after.y_in - before.y_in) / took_s)
        turns_deg_s.append(abs((after.steering_deg - before.steering_deg + 180) % 360 - 180) / took_s)
    robot.stop()
    robot.wait_until_still(10)
    return max(ways_in_s), max(turns_deg_s)
