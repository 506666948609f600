"""One policy drives a robot of a simulation, of a server and on a serial line."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

from nclient import connect
from nclient.errors import ConnectionLost, StartError
from nclient.robot import Robot
from nserver_emu.gym import RobotEnv, run_episode
from nserver_emu.gym.robots import ConnectedRobot
from nserver_emu.gym.tasks import GoTo, Scene
from tests.programs.forked import Forked
from tests.waiting import wait_until

GOAL = (0.45, 0.0)


class Drive:
    """Turn to the goal and drive there: the same object for all robots."""

    def __call__(self, observation: Mapping[str, Any]) -> Any:
        # Slower near the goal, and turning in proportion to its bearing.
        distance, bearing = observation["goal"].tolist()
        return np.array([min(0.2, distance) * np.cos(bearing), 1.5 * bearing], dtype=np.float32)


POLICY = Drive()


def drive(address: str) -> None:
    env = gymnasium.make("Nomad/GoTo-v0", address=address, goal_m=GOAL)
    try:
        done = run_episode(env, POLICY)
    finally:
        env.close()
    assert done.is_success
    assert abs(done.poses_m[-1][0] - GOAL[0]) <= 0.15


@contextlib.contextmanager
def server(*words: str) -> Iterator[str]:
    """Run a server, and yield the last of its addresses."""
    with Forked("nserver", "thesis_room", "--port", "0", "--speed", "4", *words, stderr=True) as process:
        try:
            found = process.stdout.readline()
            yield (process.stdout.readline() if words else found).split()[2]
        finally:
            process.terminate()
            process.wait(20)


def test_policy_drives_a_robot_in_this_process() -> None:
    drive("sim:thesis_room?noisy=1&seed=2")


@pytest.mark.long
def test_policy_drives_a_robot_of_a_server_and_stops_it() -> None:
    with server() as port:
        drive(f"nserver://{port}/1")
        with connect(f"nserver://{port}/1") as robot:
            wait_until(lambda: not robot.refresh().moving)


@pytest.mark.long
@pytest.mark.usefixtures("serial_ports")
def test_policy_drives_a_robot_on_a_serial_line(tmp_path: Path) -> None:
    with server("--serial-link", str(tmp_path / "nomad")) as link:
        drive(f"serial://{link}?model=n150")


def test_turret_that_looks_elsewhere_is_refused() -> None:
    robots = ConnectedRobot("sim:thesis_room?start=20,20,0,90")
    with pytest.raises(StartError, match="turret"):
        robots.reset(np.ones(1, dtype=bool), np.zeros((1, 4)), None)
    robots.close()
    robots.close()


def test_robot_is_disconnected_if_its_task_cannot_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    class Impossible(GoTo):
        def prepare(self, scene: Scene, count: int) -> None:
            super().prepare(scene, count)
            raise ValueError("impossible")

    closed: list[ConnectedRobot] = []

    def close(robot: ConnectedRobot) -> None:
        closed.append(robot)

    monkeypatch.setattr(ConnectedRobot, "close", close)
    with pytest.raises(ValueError, match="impossible"):
        RobotEnv(Impossible(), address="sim:thesis_room")
    assert len(closed) == 1


def test_real_time_is_waited_for() -> None:
    waited: list[float] = []
    robots = ConnectedRobot("sim:thesis_room?step_s=0.05", wait=waited.append)
    robots.reset(np.ones(1, dtype=bool), np.zeros((1, 4)), None)
    robots.step(0.2)
    # Each request takes 0.05 s of simulated time.
    # Of 0.2 s the first request takes 0.05 s, so that 0.15 s are left, and so on.
    assert waited == pytest.approx([0.15, 0.1, 0.05])
    assert robots.sense().time_s[0] == pytest.approx(0.2)
    robots.close()


def test_clock_that_goes_back_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    robots = ConnectedRobot("sim:thesis_room?step_s=0.05")
    robots.step(1.0)
    refresh = Robot.refresh
    # The robot reports an earlier clock, as after a restart.
    monkeypatch.setattr(Robot, "refresh", lambda robot: replace(refresh(robot), clock_ms=10))
    with pytest.raises(ConnectionLost, match="clock"):
        robots.step(1.0)
    monkeypatch.undo()
    robots.close()
