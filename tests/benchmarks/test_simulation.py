"""The benchmark runs, its variants compute the same, and it prints its results. Times are not checked."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "simulation.py"


def run(*arguments: str) -> str:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_json_has_figures_references_and_targets() -> None:
    found = json.loads(run("--json", "--rounds", "1", "--robots", "4", "50"))
    one, unread = found["one"], found["one, sonars never read"]
    assert (one["setup"], one["walls"], one["target_steps_per_s"]) == ("ideal", 50, 10_000)
    assert one["ratio"] == pytest.approx(one["yardstick_us"] / one["step_us"], rel=0.02)
    # Printed values are rounded: 2 percent.
    assert one["steps_per_s"] == pytest.approx(1e6 / one["step_us"], rel=0.02)
    assert unread["walls"] == 50
    assert found["50 robots"]["target_times_real_time"] == 10.0
    few = found["4 robots"]
    assert "target_times_real_time" not in few
    assert few["times_real_time"] == pytest.approx(1e6 / (4 * few["us_a_robot_and_second"]), rel=0.02)
    late = found["4 robots, seconds 15 to 20"]
    assert late["times_real_time"] == pytest.approx(1e6 / (4 * late["us_a_robot_and_second"]), rel=0.02)
    assert late["slowest"] <= late["times_real_time"]
    assert found["50 robots, seconds 15 to 20"]["target_times_real_time"] == 10.0
    against = found["against ir-sim"]
    assert "pip install" in against if isinstance(against, str) else against["ratio"] > 0


def test_commands_and_help_reply() -> None:
    words = run("--rounds", "1", "--robots", "4", "--setup", "noisy")
    assert "4 robots, sonars never read: robots 4, setup noisy" in words
    assert "--growth" in run("--help")
