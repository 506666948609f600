"""What docs/safety.md promises and no other room shows: an emulated robot on a pseudo-terminal comes to rest.

The eye is a second connection, over TCP; its questions feed no motion that another drives.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from forked import Forked

from nclient import BumperHit, ConnectionLost, NomadError, connect
from nclient.errors import ReplyTimeout
from nclient.robot import Robot
from nserver_emu import cli

WHOLE_S = 30.0
SILENCE = '[[rule]]\ndo = "silence"\nsilence_s = 1000.0\ndirection = "both"\nfirst = 1\nline = "serial"\n'
NOISE = '[[rule]]\ndo = "noise"\ncorrupt_percent = 100.0\ndirection = "both"\nline = "serial"\n'
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
