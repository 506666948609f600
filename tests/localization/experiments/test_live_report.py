"""The report of the matrix: the same numbers in text, CSV, JSON and a picture."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from localization.experiments.live import COLUMNS, rows, table, write
from localization.experiments.live_trial import Cell, LiveSummary

GOOD = LiveSummary(
    seeds=4, reached=4, lost=0, rmse_position_in=0.125, rmse_heading_deg=0.4, nees_mean=3.1, coverage95=0.953,
    jitter=1.2, worst_in=0.5, step_us=812.0,
)
NOTHING = LiveSummary(
    seeds=4, reached=1, lost=3, rmse_position_in=None, rmse_heading_deg=None, nees_mean=None, coverage95=None,
    jitter=None, worst_in=None, step_us=10.0,
)
MATRIX = {Cell("exact", "5.4", "ekf"): GOOD, Cell("measured", "5.9", "ukf"): NOTHING}


def test_a_row_has_names_world_numbers_and_shares() -> None:
    good, nothing = rows(MATRIX)
    assert good["world"] == "thesis_room"
    assert (good["share_lost"], good["share_reached"]) == (0.0, 1.0)
    assert (nothing["share_lost"], nothing["share_reached"]) == (0.75, 0.25)
    assert all(column.key in good for column in COLUMNS)
    assert {key: good[key] for key in GOOD} == GOOD


def test_people_read_a_line_a_cell() -> None:
    heads, good, nothing = table(MATRIX).splitlines()
    assert "position RMSE (in)" in heads
    assert good.split() == ["exact", "5.4", "ekf", "4", "0.125", "0.40", "3.10", "95.3%", "1.20", "812", "0%", "100%"]
    assert nothing.split() == ["measured", "5.9", "ukf", "4", *["-"] * 5, "10", "75%", "25%"]
    assert len(heads) == len(good) == len(nothing)


@pytest.mark.long
def test_files_hold_the_same_rows(tmp_path: Path) -> None:
    written = write(MATRIX, tmp_path / "new", picture=True)
    assert [path.name for path in written] == ["live.csv", "live.json", "live.png"]
    assert json.loads(written[1].read_text(encoding="utf-8")) == rows(MATRIX)
    with written[0].open(encoding="utf-8", newline="") as file:
        sheet = list(csv.DictReader(file))
    assert [row["method"] for row in sheet] == ["ekf", "ukf"]
    # Numbers as text, and empty cells where a method has none.
    assert float(sheet[0]["nees_mean"]) == 3.1
    assert sheet[1]["nees_mean"] == ""
    assert written[2].read_bytes().startswith(b"\x89PNG")


def test_picture_false_writes_no_picture(tmp_path: Path) -> None:
    assert [path.suffix for path in write(MATRIX, tmp_path, picture=False)] == [".csv", ".json"]


@pytest.mark.parametrize(("key", "best", "worse"), [("nees_mean", 3.0, 1.0), ("coverage95", 0.95, 1.0),
                                                    ("share_reached", 1.0, 0.9), ("jitter", 0.0, 1.0)])
def test_badness_is_zero_at_the_best_value(key: str, best: float, worse: float) -> None:
    (column,) = (column for column in COLUMNS if column.key == key)
    assert column.badness(best) == pytest.approx(0.0) != pytest.approx(column.badness(worse))
    assert column.badness(worse) > column.badness(best)
