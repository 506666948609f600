"""The seeds of a figure shared out among processes.

Rules: knows processes and nothing of filters; a part of the work is a pure function of figure and seeds (`drive_part`),
so that any number of processes, here or elsewhere, gives the same numbers. Workers are spawned, not forked: a
fork would copy a process that has threads (the progress bar's).
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from typing import TYPE_CHECKING, ClassVar, Final

from localization.experiments.crew import on_cluster
from localization.experiments.fingerprint import fingerprint
from localization.experiments.progress import Tally
from localization.experiments.results import Outcome, joined, outcome_of
from localization.experiments.settings import Figure, course_of
from localization.experiments.trial import run

if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized

_LARGEST_PART: Final = 125
"""Seeds at once: larger batches save nothing and keep some 0.5 MB a seed."""

_CLUSTER_PART: Final = 25
"""Seeds at once on a cluster: some seconds of work, so that none waits long for the slowest."""

_LOOK_EVERY_S: Final = 0.2


class _Odometer:
    """The steps this worker process shares with its parent; set when the worker starts."""

    steps: ClassVar[Synchronized[int] | None] = None


def parts_of(seeds: Sequence[int], jobs: int) -> list[Sequence[int]]:
    """The seeds cut into runs of equal length: one for each job, or more where that is beyond the largest part."""
    size = max(1, min(_LARGEST_PART, math.ceil(len(seeds) / jobs)))
    return [seeds[first : first + size] for first in range(0, len(seeds), size)]


def drive_part(figure: Figure, seeds: Sequence[int], tick: Tally = lambda _: None) -> Outcome:
    """Drive a figure once with each seed and keep what the summary and the pictures need; `tick` per step."""
    return outcome_of(run(course_of(figure), seeds, tick), figure.filtered)


def drive(figure: Figure, seeds: Sequence[int], jobs: int, report: Tally = lambda _: None) -> Outcome:
    """Drive a figure with all seeds, `jobs` processes at a time; one job stays in this process."""
    parts = parts_of(seeds, jobs)
    if len(parts) == 1 or jobs == 1:
        tick = _counting(report)
        return joined([drive_part(figure, part, tick) for part in parts])
    context = multiprocessing.get_context("spawn")
    odometer = context.Value("q", 0)
    with ProcessPoolExecutor(min(jobs, len(parts)), context, _adopt, (odometer,)) as workers:
        futures = [workers.submit(_drive_part_counting, figure, part) for part in parts]
        waiting = set(futures)
        while waiting:
            waiting = wait(waiting, timeout=_LOOK_EVERY_S).not_done
            report(odometer.value)
        return joined([future.result() for future in futures])


def drive_on_cluster(
    figure: Figure, seeds: Sequence[int], address: str, report: Tally = lambda _: None
) -> Outcome:
    """Drive a figure with all seeds on a Dask cluster, in parts of equal length."""
    items = [(figure, seeds[first : first + _CLUSTER_PART]) for first in range(0, len(seeds), _CLUSTER_PART)]
    parts = []
    tick = _counting(report)
    for part in on_cluster(_drive_item, items, address, fingerprint):
        parts.append(part)
        tick(sum(result.steps for result in part.results))
    return joined(sorted(parts, key=lambda part: part.results[0].seed))


def _drive_item(item: tuple[Figure, Sequence[int]]) -> Outcome:
    return drive_part(*item)


def _counting(report: Tally) -> Tally:
    """A tick that adds up and reports the sum."""
    done = 0

    def tick(steps: int) -> None:
        nonlocal done
        done += steps
        report(done)

    return tick


def _adopt(odometer: Synchronized[int]) -> None:
    _Odometer.steps = odometer


def _drive_part_counting(figure: Figure, seeds: Sequence[int]) -> Outcome:
    """In a worker: as `drive_part`, telling the parent about the steps."""
    return drive_part(figure, seeds, _tell_parent)


def _tell_parent(steps: int) -> None:
    if _Odometer.steps is not None:
        with _Odometer.steps.get_lock():
            _Odometer.steps.value += steps
