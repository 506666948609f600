"""What an endurance run measures, and what must hold: values and their bounds. No process, no socket.

Rules: a sample is taken when nobody is connected, so what is there then belongs to the daemon. Memory counts from the
first hour on, in which caches and tracks fill (half of a run that is shorter than two hours).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

MEMORY_SHARE: Final = 0.05
FIRST_S: Final = 3600.0
STEPS_A_SECOND: Final = 10
"""At --speed max a step is a tenth of a second."""
POOL: Final = min(32, (os.cpu_count() or 1) + 4)
"""Threads that asyncio keeps for files, once it has used them."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The daemon at one moment, nobody connected.

    simulated_s, steps      its clock, and how often that was moved (/metrics)
    rss_kib, descriptors, threads      as the system counts them (/proc)
    tasks, answers, shapes, obstacles  as it counts them itself (/metrics)
    real_s                  since the run began
    """

    real_s: float
    simulated_s: float
    steps: int
    rss_kib: int
    descriptors: int
    threads: int
    tasks: int
    answers: int
    shapes: int
    obstacles: int


@dataclass(frozen=True, slots=True)
class Finding:
    """One number beside its bound."""

    what: str
    value: float
    bound: str
    kept: bool


def verdict(samples: Sequence[Sample], hours: float) -> list[Finding]:
    """What the samples say, the first of them taken before anybody came. Needs two."""
    first, last = samples[0], samples[-1]
    warm_s = min(FIRST_S, 1800.0 * hours)
    warm = next(sample for sample in samples if sample.simulated_s >= warm_s)
    later = samples[samples.index(warm):]  # fmt: skip
    growth = max(sample.rss_kib for sample in later) / warm.rss_kib - 1.0
    drift_s = max(abs(sample.simulated_s - sample.steps / STEPS_A_SECOND) for sample in samples)
    return [
        Finding("simulated hours", last.simulated_s / 3600, f"at least {hours:g}", last.simulated_s >= 3600 * hours),
        Finding("memory, most after the first hour against then, %", 100 * growth, f"at most {100 * MEMORY_SHARE:g}",
                growth <= MEMORY_SHARE),
        Finding("clock less steps, s", drift_s, "0", drift_s == 0.0),
        _left("tasks", [sample.tasks for sample in samples]),
        _left("descriptors", [sample.descriptors for sample in samples]),
        Finding("threads at the end", last.threads, f"at most {first.threads} + {POOL} of asyncio's pool",
                last.threads <= first.threads + POOL),
    ]  # fmt: skip


def _left(what: str, counts: Sequence[int]) -> Finding:
    """No more than before anybody came, each time that nobody was there."""
    most = max(counts) - counts[0]
    return Finding(f"{what} left over, most of {len(counts)} times", most, "0", most <= 0)


def visited(visits: Mapping[str, int], struck: int, kinds: Sequence[str]) -> list[Finding]:
    """Whether there was life: every kind of visitor came, and faults struck."""
    fewest = min(visits.get(kind, 0) for kind in kinds)
    return [
        Finding("visits", sum(visits.values()), "at least 1 of each kind", fewest >= 1),
        Finding("faults that struck", struck, "at least 1", struck >= 1),
    ]


def ended(exit_code: int, complaints: int) -> list[Finding]:
    """Whether it ended cleanly. `complaints`: faults of its own that it logged."""
    return [
        Finding("exit code", exit_code, "0", exit_code == 0),
        Finding("faults of its own, logged", complaints, "0", complaints == 0),
    ]
