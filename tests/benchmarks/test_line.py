"""The serial line benchmark runs, and its variants do the same. Times are not checked."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "line.py"


def run(*arguments: str) -> str:
    command = [sys.executable, str(SCRIPT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout


def test_json_has_ratios_and_references() -> None:
    result = json.loads(run("--json", "--rounds", "1", "--calls", "50"))
    assert (result["ratio_target"], result["share_target"]) == (0.5, 0.95)
    for host in ("nserver", "client"):
        assert result[f"{host}_ratio"] == result[f"{host}_per_second"] / result["echo_per_second"]
        # 38400 baud are 3840 bytes a second, of 10 bits each; an exchange has 6 + 48 bytes.
        allowed = 38400 / 10 / (6 + 48)
        assert result[f"{host}_paced_share"] == pytest.approx(result[f"{host}_paced_per_second"] / allowed)
        assert result[f"{host}_paced_share"] <= 1.01


def test_help_answers() -> None:
    assert "--calls" in run("--help")
