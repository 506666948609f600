"""The benchmark runs, compares like with like, and prints what it says. Its times are not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "ekf.py"


def run(*arguments: str) -> str:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_json_holds_each_ratio_beside_its_yardstick() -> None:
    result = json.loads(run("--json", "--rounds", "2", "--seeds", "2"))
    assert result["given_h_ratio"] == result["filterpy_us"] / result["given_h_us"]
    assert result["batch_ratio"] == result["batch_steps_per_s"] / result["single_steps_per_s"]
    assert result["ratio_target"] == 5.0
    assert result["batch_seeds"] == 2


def test_help_answers() -> None:
    assert "--seeds" in run("--help")
