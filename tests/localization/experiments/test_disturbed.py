"""The command `disturbed`: its disturbances, sums and output."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from localization.experiments import disturbed
from localization.experiments.__main__ import main
from localization.experiments.disturbed import ROWS, Case, Disturbance, Tally, filter_map, run, summarize
from worlds.io import load_world

WALLS = np.asarray(load_world(disturbed.WORLD).walls)
TALLY = Tally(10, 0, 1.0, 0.9, 30.0, 8, 1, 9, 8, 16.0, 0.5, 2.0)


def test_maps_of_the_filter() -> None:
    np.testing.assert_array_equal(filter_map(WALLS, Disturbance()), WALLS)
    ends = filter_map(WALLS, Disturbance(map_scale=1.02)).reshape(-1, 2)
    np.testing.assert_allclose(np.ptp(ends, axis=0), 1.02 * np.ptp(WALLS.reshape(-1, 2), axis=0))
    moved = filter_map(WALLS, Disturbance(wall_off_in=3.0)) - WALLS
    np.testing.assert_allclose(moved[disturbed.WALL], [3.0, 0.0, 3.0, 0.0])
    assert np.count_nonzero(moved) == 2
    missing = filter_map(WALLS, Disturbance(wall_off_in=math.nan))
    np.testing.assert_array_equal(missing, np.delete(WALLS, disturbed.WALL, axis=0))
    np.testing.assert_allclose(WALLS[disturbed.WALL], [60.0, 102.17, 60.0, 75.0])


def test_numbers_of_a_row_are_those_of_all_its_runs() -> None:
    row = summarize("person", "noisy", "ekf", [TALLY, TALLY])
    assert row["rmse_in"] == pytest.approx(math.sqrt(0.1))
    assert (row["ok"], row["ok_wrong"], row["ok_if_right"]) == (0.8, 0.1, pytest.approx(8 / 9))
    assert (row["nees"], row["nees_ok"], row["jitter"], row["lost"]) == (3.0, 2.0, 0.5, 0.0)


def test_rows_are_printed_and_cached(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    made: list[Case] = []

    def fake(case: Case) -> tuple[Case, Tally]:
        made.append(case)
        return case, TALLY

    monkeypatch.setattr(disturbed, "run", fake)
    asked = [
        "disturbed",
        "--seeds",
        "2",
        "--rows",
        "person",
        "--setups",
        "noisy",
        "--jobs",
        "1",
        "--out",
        str(tmp_path),
    ]
    assert main(asked) == 0
    assert "NEES if OK" in capsys.readouterr().out
    assert main([*asked, "--json"]) == 0
    assert [(case.row, case.seed) for case in made] == [("person", 0), ("person", 1)]
    assert json.loads(capsys.readouterr().out)[0]["disturbance"] == "person"


def test_seeds_begin_at_the_first_one(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    made: list[int] = []

    def fake(case: Case) -> tuple[Case, Tally]:
        made.append(case.seed)
        return case, TALLY

    monkeypatch.setattr(disturbed, "run", fake)
    options = ["--first", "100", "--seeds", "2", "--rows", "person", "undisturbed", "--setups", "noisy"]
    assert main(["disturbed", *options, "--jobs", "1", "--out", str(tmp_path)]) == 0
    # Seed by seed: the rows of a seed share a drive.
    assert made == [100, 100, 101, 101]


def test_rows_with_the_same_wheels_share_a_drive(monkeypatch: pytest.MonkeyPatch) -> None:
    short = {row: replace(ROWS[row], seconds=0.5) for row in ("undisturbed", "person", "carpet 8 %")}
    monkeypatch.setattr(disturbed, "ROWS", short)
    disturbed.record_drive.cache_clear()
    for row in short:
        run(Case(row, "noisy", "ekf", 0))
    # A carpet needs a drive of its own.
    assert (disturbed.record_drive.cache_info().misses, disturbed.record_drive.cache_info().hits) == (2, 1)


@pytest.mark.long
@pytest.mark.parametrize("row", ["person", "slips of 3 in", "clock 100 ms", "pressed: post"])
def test_a_short_run(row: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disturbed, "ROWS", {row: replace(ROWS[row], seconds=15.0)})
    _, tally = run(Case(row, "noisy", "ekf", 0))
    assert tally.count == 150
    assert tally.lost == 0
    assert tally.square_in2 / tally.count < 4.0
