"""The robot of the hardware tests: that of `--robot ADDRESS`, or simulated ones on pseudo-terminals."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hardware.envelope import HOME_IN, SPEED_IN_S, Bench, Walk, limited
from tests.programs.forked import Forked

EMULATED = ("n150", "n200", "scout")
FASTER = 2
"""Simulated seconds per real second."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Use the given robot, or one simulated robot of each model."""
    if "bench" in metafunc.fixturenames:
        named = metafunc.config.getoption("--robot")
        metafunc.parametrize("bench", [named] if named else EMULATED, indirect=True, scope="session")


@pytest.fixture(scope="session")
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """Return the given robot, or run a simulated one for the session."""
    if request.param not in EMULATED:
        yield Bench(limited(request.param))
        return
    link: Path = tmp_path_factory.mktemp("line") / request.param
    # In the middle of the room, with noise: as near to a real robot as a simulation can be.
    words = ["--noisy", "--seed", "1", "--robot", request.param, "--start", "45,45", "--speed", str(FASTER),
             "--port", "0", "--serial-link", str(link)]  # fmt: skip
    with Forked("nserver", *words) as daemon:
        # The second line is printed when the pseudo-terminal is there.
        lines = [daemon.stdout.readline() for _ in range(2)]
        assert lines[1] == f"listening serial {link}\n"
        try:
            yield Bench(limited(f"serial://{link}?model={request.param}"), FASTER)
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


@pytest.fixture
def walk(bench: Bench) -> Iterator[Walk]:
    """Return the robot at rest. After the test, stop it and check that it is near its start pose."""
    robot = bench.connect()
    try:
        state = robot.stop()
        # A pressed bumper would stop each test at its first motion.
        assert not state.touching, f"bumpers {state.bumpers} are pressed; move the robot to a free place"
        robot.set_speeds(translation_in_s=SPEED_IN_S)
        walk = Walk(robot, robot.refresh().pose)
    except BaseException:
        robot.disconnect()
        raise
    yield walk
    with walk.robot as robot:
        robot.stop()
        assert walk.distance_in(walk.until_still()) < HOME_IN
