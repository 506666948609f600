"""The benchmark of the localizer runs and reports ratios of its own figures; its times are not checked here."""

from __future__ import annotations

import contextlib
import io
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import ekf
import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "ekf.py"


def run(*arguments: str) -> str:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    """Return the numbers of one short run in this process, with the shortest figure; compiling would take a minute."""
    words = ["ekf.py", "--json", "--plain", "--rounds", "2", "--seeds", "2", "--jobs", "1"]
    out = io.StringIO()
    with pytest.MonkeyPatch.context() as patched, contextlib.redirect_stdout(out):
        patched.setattr(ekf, "FIGURE", "5.6")
        patched.setattr(sys, "argv", words)
        ekf.main()
    found: dict[str, Any] = json.loads(out.getvalue())
    return found


def test_json_holds_each_number_beside_its_bound(result: dict[str, Any]) -> None:
    # Ratios are computed from the printed times, so that the reader can check them.
    assert result["filterpy_ratio"] == result["filterpy_us"] / result["rays_16_us"]
    assert result["stonesoup_ratio"] == result["stonesoup_us"] / result["rays_16_us"]
    assert result["batch_ratio"] == result["batch_steps_per_s"] / result["single_steps_per_s"]
    assert result["bounds"]["filterpy_ratio"] == 1.0
    assert set(result["bounds"]) <= set(result)
    assert (result["batch_seeds"], result["particles"]) == (2, 1000)


def test_the_live_filter_uses_its_echoes(result: dict[str, Any]) -> None:
    assert result["used_rays"] > 0.9
    assert result["used_cones"] > 0.2
    assert result["rays_16_us"] > result["rays_1_us"] > 0.0


def test_the_table_marks_missed_bounds() -> None:
    numbers: dict[str, float] = dict.fromkeys(ekf.Result.__annotations__, 10.0)
    # One value below its minimum and one above its maximum.
    result = ekf.Result(**{**numbers, "filterpy_ratio": 0.5, "figure_s": 61.0})
    lines = [line.split("required: ")[1] for line in ekf.table(result).splitlines() if "required" in line]
    live = ["at least 1, MISSED", "at least 10", "at least 0.67", "at least 4"]
    assert lines == [*live, "at most 50", "at most 50", "at most 60, MISSED", "at most 60"]


def test_help_answers() -> None:
    assert "--seeds" in run("--help")
