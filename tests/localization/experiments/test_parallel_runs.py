"""Parallel runs: the same numbers for any number of processes."""

from __future__ import annotations

import pytest

from localization.experiments import execution
from localization.experiments.execution import drive, drive_batch, split_seeds
from localization.experiments.figure_trial import FIGURES


@pytest.mark.parametrize(
    ("count", "jobs", "sizes"),
    [
        (1, 1, [1]),
        (1, 8, [1]),
        (10, 3, [10]),
        (30, 4, [10, 10, 10]),
        (100, 2, [50, 50]),
        (1000, 2, [125] * 8),
        (1001, 3, [125] * 8 + [1]),
    ],
)
def test_the_parts_are_all_the_seeds_in_order(count: int, jobs: int, sizes: list[int]) -> None:
    parts = split_seeds(range(count), jobs)
    assert [seed for part in parts for seed in part] == list(range(count))
    assert [len(part) for part in parts] == sizes


@pytest.mark.long
def test_the_numbers_do_not_depend_on_the_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "_MIN_BATCH", 1)
    figure = FIGURES["5.6"]
    reports: list[int] = []
    # Three seeds in this process, and in two others.
    alone, shared = drive_batch(figure, range(3)), drive(figure, range(3), jobs=2, report=reports.append)
    assert alone.results == shared.results
    assert [track.seed for track in shared.tracks] == [0, 1, 2]
    for mine, theirs in zip(alone.tracks, shared.tracks, strict=True):
        assert (mine.truth == theirs.truth).all()
        assert (mine.cov == theirs.cov).all()
    # The last progress report counts all steps.
    assert reports[-1] == sum(result.steps for result in alone.results)


@pytest.mark.long
def test_one_job_runs_in_process_and_reports_every_step() -> None:
    reports: list[int] = []
    outcome = drive(FIGURES["5.6"], range(2), jobs=1, report=reports.append)
    assert reports == sorted(reports)
    assert len(reports) == max(result.steps for result in outcome.results)
    assert reports[-1] == sum(result.steps for result in outcome.results)
