"""`pytest --robot ADDRESS` runs only the hardware tests, on the robot at the address."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from nclient.url import split_address
from tests.hardware.envelope import LIMITS, limited
from tests.programs.forked import Forked

TESTS = Path(__file__).parents[1]


def pytest_on(address: str, wanted: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--robot", address, "-k", wanted, *words]
    places = [str(TESTS / name) for name in ("hardware", "programs")]
    return subprocess.run([*command, *places], capture_output=True, text=True, check=False, timeout=120)


def test_robot_option_selects_the_robot(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with Forked("nserver", "--port", "0", "--serial-link", str(link), "--robot", "scout") as daemon:
        try:
            assert [daemon.stdout.readline() for _ in range(2)][1].startswith("listening serial")
            done = pytest_on(f"serial://{link}?model=scout", "encoders or room or unavailable")
        finally:
            daemon.terminate()
    assert done.returncode == 0, done.stdout
    assert "2 passed" in done.stdout
    assert "skipped" not in done.stdout


def test_missing_robot_is_a_failure(tmp_path: Path) -> None:
    done = pytest_on(f"serial://{tmp_path}/none", "encoders")
    assert done.returncode == 1
    assert "there is no port" in done.stdout


def test_two_processes_do_not_share_a_robot() -> None:
    done = pytest_on("serial:///dev/none", "encoders", "-n", "2")
    assert done.returncode == pytest.ExitCode.USAGE_ERROR
    assert "omit -n" in done.stderr


def test_limits_override_the_address() -> None:
    given = "serial:///dev/ttyUSB0?model=scout&max_speed_in_s=50&feed=0&tm_s=60"
    limits = {name: str(value) for name, value in LIMITS.items()}
    assert split_address(limited(given)).options == {"model": "scout"} | limits
    assert split_address(limited("robotd://nomad")).options == limits
    assert (LIMITS["max_speed_in_s"], LIMITS["bumper_stop"]) == (5, 1)
