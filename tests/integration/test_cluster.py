"""Experiments on a Dask cluster of two worker processes give bit-identical results."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from localization.experiments import __main__ as experiments
from localization.experiments import live_trial
from localization.experiments.execution import ClusterError, code_hash, drive_batch, drive_on_cluster, on_cluster
from localization.experiments.figure_trial import FIGURES
from localization.experiments.live import trial_cache
from localization.experiments.live_trial import TrialJob, trials


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        yield cluster.scheduler_address


def test_live_trials_are_identical(address: str, tmp_path: Path) -> None:
    arguments = ["--scenario", "exact", "measured", "--figures", "5.4", "--methods", "ekf", "mcl", "--seeds", "1"]
    whole = ["live", *arguments, "--periods", "12", "--no-pictures", "--out", str(tmp_path), "--cluster", address]
    assert experiments.main(whole) == 0
    store = trial_cache(tmp_path / "trials", code_hash())
    for trial in trials(["exact", "measured"], ["5.4"], ["ekf", "mcl"], 1, 12):
        there = store.get(trial)
        assert there is not None
        assert live_trial.run(TrialJob(trial)).result.same_numbers(there)


def test_figures_are_identical(address: str) -> None:
    reports: list[int] = []
    there = drive_on_cluster(FIGURES["5.6"], range(30), address, reports.append)
    here = drive_batch(FIGURES["5.6"], range(30))
    assert there.results == here.results
    assert all((mine.cov == theirs.cov).all() for mine, theirs in zip(here.tracks, there.tracks, strict=True))
    assert reports[-1] == sum(result.steps for result in here.results)


def test_command_drives_squares(address: str, tmp_path: Path) -> None:
    arguments = ["5.6", "--seeds", "2", "--no-pictures", "--json", "--out", str(tmp_path)]
    numbers = []
    for who in (["--cluster", address], ["--jobs", "1"]):
        assert experiments.main([*arguments, *who]) == 0
        numbers.append((tmp_path / "figure_5.6.json").read_bytes())
    assert numbers[0] == numbers[1]


def test_workers_with_other_code_are_rejected(address: str) -> None:
    with pytest.raises(ClusterError, match="tcp://"):
        list(on_cluster(math.factorial, [3], address, os.getpid))
    assert list(on_cluster(math.factorial, [3], address, code_hash)) == [6]
