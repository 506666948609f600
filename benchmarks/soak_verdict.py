"""The quantities of an endurance run and their limits.

Samples are taken when no client is connected, so that everything left belongs to the daemon. Memory is compared from
the end of the first hour (of the first half of runs below two hours), in which caches and tracks fill.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

MAX_MEMORY_GROWTH: Final = 0.05
WARM_UP_S: Final = 3600.0
STEPS_PER_SECOND: Final = 10
"""At --speed max a step is a tenth of a second."""
POOL: Final = min(32, (os.cpu_count() or 1) + 4)
"""Maximum size of asyncio's thread pool for files."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The daemon at one moment, with no client connected.

    simulated_s, steps      its clock and number of steps (/metrics)
    rss_kib, descriptors, threads      from the system (/proc)
    tasks, answers, shapes, obstacles  from the daemon (/metrics)
    real_s                  since the start of the run
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
    """A measured value with its limit."""

    what: str
    value: float
    bound: str
    passed: bool


def verdict(samples: Sequence[Sample], hours: float) -> list[Finding]:
    """Check the samples, the first of which is taken before any client connects. Needs two."""
    first, last = samples[0], samples[-1]
    warm_s = min(WARM_UP_S, 1800.0 * hours)
    warm = next(sample for sample in samples if sample.simulated_s >= warm_s)
    later = samples[samples.index(warm):]  # fmt: skip
    growth = max(sample.rss_kib for sample in later) / warm.rss_kib - 1.0
    drift_s = max(abs(sample.simulated_s - sample.steps / STEPS_PER_SECOND) for sample in samples)
    return [
        Finding("simulated hours", last.simulated_s / 3600, f"at least {hours:g}", last.simulated_s >= 3600 * hours),
        Finding("memory, maximum after the first hour relative to then, %", 100 * growth,
                f"at most {100 * MAX_MEMORY_GROWTH:g}", growth <= MAX_MEMORY_GROWTH),
        Finding("clock less steps, s", drift_s, "0", drift_s == 0.0),
        _check_leftover("tasks", [sample.tasks for sample in samples]),
        _check_leftover("descriptors", [sample.descriptors for sample in samples]),
        Finding("threads at the end", last.threads, f"at most {first.threads} + {POOL} of asyncio's pool",
                last.threads <= first.threads + POOL),
    ]  # fmt: skip


def _check_leftover(what: str, counts: Sequence[int]) -> Finding:
    """Check that every count is at most that before the first client."""
    maximum = max(counts) - counts[0]
    return Finding(f"{what} left over, maximum of {len(counts)} counts", maximum, "0", maximum <= 0)


def check_activity(sessions: Mapping[str, int], struck: int, kinds: Sequence[str]) -> list[Finding]:
    """Check that every kind of client connected and that faults were injected."""
    minimum = min(sessions.get(kind, 0) for kind in kinds)
    return [
        Finding("sessions", sum(sessions.values()), "at least 1 of each kind", minimum >= 1),
        Finding("faults", struck, "at least 1", struck >= 1),
    ]


def check_exit(exit_code: int, count_errors: int) -> list[Finding]:
    """Check for a clean exit without internal errors in the log."""
    return [
        Finding("exit code", exit_code, "0", exit_code == 0),
        Finding("internal errors, logged", count_errors, "0", count_errors == 0),
    ]
