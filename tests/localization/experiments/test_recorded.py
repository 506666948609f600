"""Statistics of a ring of sonars without odometry, on made rows and on the real data where it is present."""

import json
from pathlib import Path

import numpy as np
import pytest

from localization.experiments import __main__ as experiments
from localization.experiments.ring import read_ring, runs_of, statistics_of
from localization.filters.belief import Floats
from nclient.errors import LogFileError

DATA = Path(__file__).parents[3].parent / "shared" / "data" / "scitos_ring24" / "scitos_ring24.csv"


def row_of(*walls: tuple[int, float], sonars: int = 24) -> Floats:
    """Return a row in which each wall (direction in steps, distance) is measured by three sonars, and nothing else."""
    row = np.full(sonars, np.inf)
    for direction, distance in walls:
        row[np.arange(direction - 1, direction + 2) % sonars] = distance
    return row


def test_a_run_has_the_direction_and_the_distance_of_its_wall() -> None:
    # The first wall lies across the first sonar.
    found = sorted(runs_of(row_of((0, 1.2), (8, 0.7))))
    assert [run[:2] for run in found] == [(0.0, 3), (8.0, 3)]
    assert [run.range_m for run in found] == pytest.approx([1.2, 0.7])
    assert runs_of(np.full(24, np.inf)) == []
    assert runs_of(np.arange(24.0)) == []


def test_widths_are_those_of_opposite_walls_alone() -> None:
    rows = np.array([row_of((2, 1.2), (14, 0.7)), row_of((2, 1.2), (9, 0.7)), row_of((5, 1.0)), row_of()])
    found = statistics_of(rows)
    assert found.opposite_m == pytest.approx((1.9,))
    # Opposite walls determine one direction; the second row has walls 105 degrees apart.
    assert found.rows_with_position == 0.25
    assert found.runs_per_row == 1.25
    assert found.in_runs == pytest.approx(15 / 96)
    assert found.no_echo == pytest.approx(81 / 96)


def test_widths_that_occur_often_are_grouped() -> None:
    rng = np.random.default_rng(1)
    widths = np.concatenate((rng.uniform(2.02, 2.18, 300), rng.uniform(3.01, 3.04, 100), rng.uniform(0.5, 4.5, 5)))
    found = statistics_of(np.full((2, 24), np.inf))._replace(opposite_m=tuple(widths.tolist())).widths
    assert [width.median_m for width in found] == pytest.approx([2.1, 3.025], abs=0.02)
    assert [width.std_m for width in found] == pytest.approx([0.16 / 12**0.5, 0.03 / 12**0.5], abs=0.005)
    assert statistics_of(np.full((2, 24), np.inf)).widths == []


def test_a_damaged_row_is_an_error(tmp_path: Path) -> None:
    for text in ("a,b,label\n1,2,x\n1,y,x\n", "a,b,label\n1,2,x\n1,x\n"):
        (tmp_path / "ring.csv").write_text(text)
        with pytest.raises(LogFileError, match="ring"):
            read_ring(tmp_path / "ring.csv")


@pytest.mark.skipif(not DATA.exists(), reason="needs the data of docs/real-data.md")
def test_the_ring_sees_walls_in_two_directions(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    picture = tmp_path / "ring.png"
    assert experiments.main(["ring", "--data", str(DATA), "--picture", str(picture), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["rows"] == 5456
    assert found["rows_with_position"] > 0.9
    assert 2.5 < found["runs_per_row"] < 3.2
    assert np.percentile(found["opposite_m"], (10, 90)) == pytest.approx((2.14, 3.72), abs=0.01)
    assert picture.stat().st_size > 1000
