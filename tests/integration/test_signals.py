"""SIGTERM and SIGHUP end a command that drives a robot, as Ctrl-C does: the robot stops, results are written."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from tests.programs.forked import Forked

TIMEOUT_S = 60.0
MISSION = "map = 'thesis_room'\n[[step]]\ndo = 'go_to'\nto_in = [80, 80]\n"


@pytest.fixture
def address() -> Iterator[str]:
    """Run a server and yield the address of its robot."""
    with Forked("nserver", "thesis_room", "--port", "0", "--noisy", "--seed", "2") as process:
        try:
            yield f"nserver://{process.stdout.readline().split()[2]}/1"
        finally:
            process.terminate()
            process.wait(TIMEOUT_S)


def arguments_of(command: str, address: str, folder: Path) -> list[str]:
    mission, written = folder / "far.toml", str(folder / "written")
    mission.write_text(MISSION)
    return {
        "go": ["go", address, "--map", "thesis_room", "--to", "80,80"],
        "mission": ["mission", str(mission), address, "--report", written],
        "localize": ["localize", address, "--map", "thesis_room", "--waypoints", "80,80", "--save", written],
        "calibrate": ["calibrate", address, "--world", "thesis_room", "--out", written],
    }[command]


@pytest.mark.parametrize(("command", "number", "code"), [
    ("go", signal.SIGTERM, 143), ("go", signal.SIGHUP, 129), ("mission", signal.SIGTERM, 143),
    ("mission", signal.SIGHUP, 129), ("localize", signal.SIGTERM, 143), ("localize", signal.SIGINT, 130),
    ("calibrate", signal.SIGTERM, 143), ("calibrate", signal.SIGHUP, 129),
])  # fmt: skip
def test_signal_stops_robot_and_writes_results(
    command: str, number: signal.Signals, code: int, address: str, tmp_path: Path
) -> None:
    with connect(address) as watching:
        with Forked("nomad", *arguments_of(command, address, tmp_path), stderr=True) as process:
            until_s = time.monotonic() + TIMEOUT_S
            while abs(watching.refresh().translation_in_s) + abs(watching.state.steering_rad_s) < 0.2:
                assert time.monotonic() < until_s
                time.sleep(0.02)
            process.send_signal(number)
            output, errors = process.communicate(timeout=TIMEOUT_S)
        assert (process.returncode, errors) == (code, "")
        until_s = time.monotonic() + TIMEOUT_S
        while watching.refresh().moving:
            assert time.monotonic() < until_s
            time.sleep(0.05)
    written = tmp_path / "written"
    if command == "go":
        assert "interrupted at (" in output
    elif command == "mission":
        assert json.loads(written.read_text())["ending"] == "interrupted"
    elif command == "localize":
        assert "0 of 1 waypoints reached" in output
        assert written.read_text()
    else:
        assert not written.exists(), "an incomplete square gives no calibration"
