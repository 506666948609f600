"""The matrix of live trials: method by scenario by path, a trial a seed. Data, and what runs one of them.

Rules: a trial is a value that decides its numbers to the bit (the time it took apart), whoever runs it and wherever, so
that results can be kept by it. No process, no file.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from localization.experiments.live import trial
from localization.experiments.live.scenario import COURSES, SCENARIOS, Scenario
from localization.experiments.live.summary import LiveSummary, TrialResult, result_of, summarize
from localization.experiments.live.trial import MOST_PERIODS, Record

COMPARED: Final = ("ekf", "iekf", "ukf", "smoother", "mcl")
"""Methods that are told where they start."""


class Cell(NamedTuple):
    """A place in the matrix, by names."""

    scenario: str
    figure: str
    method: str

    @property
    def world(self) -> str:
        """The world the path of that figure lies in."""
        return COURSES[self.figure]


@dataclass(frozen=True, slots=True)
class Trial:
    """One live trial: its scenario with the method in it, path, seed, and how many periods it may last."""

    scenario: Scenario
    figure: str
    seed: int
    periods: int = MOST_PERIODS

    @property
    def cell(self) -> Cell:
        """Where in the matrix it belongs."""
        return Cell(self.scenario.name, self.figure, self.scenario.method)


class Done(NamedTuple):
    """A trial with what is kept of it, and all of it where that was asked for."""

    trial: Trial
    result: TrialResult
    record: Record | None


class Job(NamedTuple):
    """A trial to run, and whether its whole record is wanted."""

    trial: Trial
    whole: bool = False


def trials(
    scenarios: Iterable[str], figures: Sequence[str], methods: Sequence[str], seeds: int, periods: int = MOST_PERIODS
) -> list[Trial]:
    """All trials of a matrix, cell by cell."""
    return [
        Trial(replace(SCENARIOS[scenario], method=method), figure, seed, periods)
        for scenario in scenarios
        for figure in figures
        for method in methods
        for seed in range(seeds)
    ]


def run(job: Job) -> Done:
    """Run one trial here and now; the time it takes is the processor's, whatever else the machine does."""
    scenario, figure, seed, periods = job.trial.scenario, job.trial.figure, job.trial.seed, job.trial.periods
    record = trial.drive(scenario, figure, seed, periods, time.thread_time)
    return Done(job.trial, result_of(record, scenario.judged_after_in), record if job.whole else None)


def summaries(results: Mapping[Trial, TrialResult]) -> dict[Cell, LiveSummary]:
    """The numbers of each cell, in the order of its first trial; those of a cell in the order of their seeds."""
    cells: dict[Cell, list[TrialResult]] = {}
    for done, result in results.items():
        cells.setdefault(done.cell, []).append(result)
    return {cell: summarize(sorted(found, key=lambda result: result.seed)) for cell, found in cells.items()}
