"""Robots that a program drops without disconnecting, and connections that a forked child inherits."""

from __future__ import annotations

import gc
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from nclient import connect, connect_async
from nclient.robot import Robot
from tests.programs.forked import Forked
from tests.waiting import wait_until

TIMEOUT_S = 30.0
TM_S = 20
"""Motion timeout, longer than the tests take: it is not what stops the robot."""
FORKS = """
import os, sys
from nclient import connect
with connect(sys.argv[1]) as robot:
    robot.drive(translation_in_s=1)
    child = os.fork()
    if child == 0:
        robot.disconnect()
        sys.exit()
    assert os.waitpid(child, 0)[1] == 0
    assert robot.refresh().moving and not robot.closed
    print("moving", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def where() -> Iterator[str]:
    """Run a server and yield its host and port."""
    with Forked("nserver", "--port", "0") as process:
        try:
            yield process.stdout.readline().split()[2]
        finally:
            process.terminate()
            process.wait(TIMEOUT_S)


def is_moving(observer: Robot) -> bool:
    before = observer.truth()
    wait_until(lambda: observer.truth().time_s > before.time_s + 0.1)
    return observer.truth().x_in != before.x_in


@pytest.mark.parametrize("is_cycle", [False, True])
def test_a_dropped_robot_stops(where: str, is_cycle: bool) -> None:
    with connect(f"nserver://{where}/1?tm_s=0") as observer:
        robot = connect(f"nserver://{where}/1?tm_s={TM_S}")
        robot.drive(translation_in_s=1)
        assert is_moving(observer)
        if is_cycle:
            # A reference to itself: only the garbage collector can free it.
            vars(robot)["itself"] = robot
        del robot
        gc.collect()
        start_s = time.monotonic()
        wait_until(lambda: not is_moving(observer))
        # Long before the robot's own timeout.
        assert time.monotonic() - start_s < TM_S / 2


async def test_a_dropped_async_robot_stops(where: str) -> None:
    with connect(f"nserver://{where}/1?tm_s=0") as observer:
        robot = await connect_async(f"nserver://{where}/1?tm_s={TM_S}")
        await robot.drive(translation_in_s=1)
        assert is_moving(observer)
        del robot
        gc.collect()
        start_s = time.monotonic()
        wait_until(lambda: not is_moving(observer))
        assert time.monotonic() - start_s < TM_S / 2


def test_a_forked_child_leaves_the_connection_alone(where: str) -> None:
    command = [sys.executable, "-W", "ignore", "-c", FORKS, f"nserver://{where}/1"]
    with (
        connect(f"nserver://{where}/1?tm_s=0") as observer,
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as program,
    ):
        assert program.stdout is not None
        # The child has disconnected its copy; the parent's robot must still move.
        assert program.stdout.readline() == "moving\n"
        assert is_moving(observer)
        program.communicate(timeout=TIMEOUT_S)
        assert program.returncode == 0
        wait_until(lambda: not is_moving(observer))
