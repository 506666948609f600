"""The benchmark runs, its variants compute the same, and it prints its results. Times are not checked."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import ekf

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "ekf.py"


def run(*arguments: str) -> str:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_json_has_numbers_and_bounds() -> None:
    result = json.loads(run("--json", "--rounds", "2", "--seeds", "2", "--jobs", "1"))
    assert result["filterpy_ratio"] == result["filterpy_us"] / result["given_h_us"]
    assert result["stonesoup_ratio"] == result["stonesoup_us"] / result["given_h_us"]
    assert result["batch_ratio"] == result["batch_steps_per_s"] / result["single_steps_per_s"]
    assert (result["bounds"]["filterpy_ratio"], result["bounds"]["full_us"]) == (5.0, 150.0)
    assert set(result["bounds"]) <= set(result)
    assert (result["batch_seeds"], result["particles"]) == (2, 1000)


def test_table_marks_missed_targets_and_missing_numba() -> None:
    numbers: dict[str, float] = dict.fromkeys(ekf.Result.__annotations__, 10.0)
    result = ekf.Result(**{**numbers, "compiled_us": None, "compiled_p99_us": None, "full_us": 151.0})
    lines = ekf.table(result).splitlines()
    assert "asked: at most 150, MISSED" in lines[0]
    assert lines[1].endswith("asked: at most 1000")
    assert "no numba" in lines[2]
    assert [line.split("asked: ")[1] for line in lines if " / ours" in line] == ["at least 5", "at least 20, MISSED"]


def test_help_answers() -> None:
    assert "--seeds" in run("--help")
