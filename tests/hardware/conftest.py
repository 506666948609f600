"""Who the hardware tests are run on: the robot of `--robot ADDRESS`, or emulated ones on pseudo-terminals."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hardware.envelope import HOME_IN, SPEED_IN_S, Bench, Walk, limited
from tests.programs.forked import Forked

EMULATED = ("n150", "n200", "scout")
FASTER = 2
"""How many times faster than a real robot's the emulated ones' time runs."""


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One robot where one is named, else an emulated one of each model."""
    if "bench" in metafunc.fixturenames:
        named = metafunc.config.getoption("--robot")
        metafunc.parametrize("bench", [named] if named else EMULATED, indirect=True, scope="session")


@pytest.fixture(scope="session")
def bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """The robot that is named, or an emulated one that lives as long as the tests."""
    if request.param not in EMULATED:
        yield Bench(limited(request.param))
        return
    link: Path = tmp_path_factory.mktemp("line") / request.param
    words = ["--noisy", "--seed", "1", "--robot", request.param, "--start", "45,45", "--speed", str(FASTER),
             "--port", "0", "--serial-link", str(link)]  # fmt: skip
    with Forked("nserver", *words) as daemon:
        lines = [daemon.stdout.readline() for _ in range(2)]
        assert lines[1] == f"listening serial {link}\n"
        try:
            yield Bench(limited(f"serial://{link}?model={request.param}"), FASTER)
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


@pytest.fixture
def walk(bench: Bench) -> Iterator[Walk]:
    """The robot, at rest. After the test it is stopped, and must be about where it was."""
    robot = bench.connect()
    try:
        state = robot.stop()
        assert not state.touching, f"something touches bumpers {state.bumpers}; put the robot where it stands free"
        robot.set_speeds(translation_in_s=SPEED_IN_S)
        walk = Walk(robot, robot.refresh().pose)
    except BaseException:
        robot.disconnect()
        raise
    yield walk
    with walk.robot as robot:
        robot.stop()
        assert walk.distance_in(walk.until_still()) < HOME_IN
