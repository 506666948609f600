"""The localizer of `nomad localize` on a robot's own line is as good as over TCP."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from line_localizer import END_IN, RMSE_IN, daemon, localized

from nclient import connect

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "line_localizer.py"
NOMAD = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())"]
SPEED = 2.0


@pytest.mark.parametrize("line", ["tcp", "serial"])
def test_estimate_stays_within_bounds(line: str) -> None:
    # The observer needs the truth only: its connection sets no motion timeout.
    with daemon(1, SPEED) as places, connect(places["tcp"] + "?tm_s=0") as observer:
        result = localized(places[line], observer).summary()
    assert result["reached"] == 2
    assert result["rmse_position_in"] < RMSE_IN
    assert result["end_error_in"] < END_IN < result["odometry_end_error_in"]
    assert result["echoes_used"] > 100


def test_documented_program_drives_robot_on_line() -> None:
    words = ["--map", "thesis_room", "--waypoints", "0,0", "60,40", "--json"]
    with daemon(2, SPEED) as places, connect(places["tcp"] + "?tm_s=0") as observer:
        command = [*NOMAD, "localize", places["serial"], *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
        truth = observer.truth()
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert (result["reached"], result["truth"]) == (2, None)
    assert result["estimate"][:2] == pytest.approx([truth.x_in, truth.y_in], abs=END_IN)


def test_results_of_each_line_in_a_table() -> None:
    command = [sys.executable, str(SCRIPT), "--seeds", "1", "--speed", "3"]
    table = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100).stdout.splitlines()
    assert [row.split(" | ")[:2] for row in table[2:]] == [["| tcp", "1 of 1"], ["| serial", "1 of 1"]]
