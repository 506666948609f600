"""Cached trials: exact round trip, and no results of other trials."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from localization.experiments.live import trial_cache
from localization.experiments.live_trial import SCENARIOS, Trial, TrialResult
from localization.filters.sonar_cone import ConeSonar

TRIAL = Trial(SCENARIOS["measured"], "5.4", 7)
RESULT = TrialResult(7, True, 10, 0.1 + 0.2, 1e-17, 2.0 / 3.0, 9, 1.0, 2.0, 3.0, 4.5)


def test_cached_result_round_trips_exactly(tmp_path: Path) -> None:
    store = trial_cache(tmp_path / "new", "code")
    assert store.get(TRIAL) is None
    store.put(TRIAL, RESULT)
    assert store.get(TRIAL) == RESULT
    assert [path.suffix for path in (tmp_path / "new").iterdir()] == [".json"]
    assert store.path(TRIAL).name.startswith("measured_5.4_ekf_0007_")


def test_all_that_decides_a_result_is_in_its_name(tmp_path: Path) -> None:
    scenario = TRIAL.scenario
    others = [
        replace(TRIAL, seed=8),
        replace(TRIAL, figure="5.8"),
        replace(TRIAL, periods=10),
        replace(TRIAL, scenario=replace(scenario, method="ukf")),
        replace(TRIAL, scenario=replace(scenario, outlier_fraction=0.21)),
        replace(TRIAL, scenario=replace(scenario, sonar=ConeSonar(margin_db=31.0))),
        replace(TRIAL, scenario=replace(scenario, odometry=replace(scenario.odometry, drift_std=0.003))),
    ]
    store = trial_cache(tmp_path, "code")
    names = {store.path(trial) for trial in (TRIAL, *others)} | {trial_cache(tmp_path, "other code").path(TRIAL)}
    assert len(names) == len(others) + 2


def test_a_file_cut_short_is_no_result(tmp_path: Path) -> None:
    store = trial_cache(tmp_path, "code")
    store.path(TRIAL).with_suffix(".part").write_text('{"seed": 7', encoding="utf-8")
    assert store.get(TRIAL) is None
    store.put(TRIAL, RESULT)
    assert store.get(TRIAL) == RESULT
