"""Measurements of an endurance run and their bounds.

A sample is taken without connections, so that all resources belong to the daemon. Memory counts after the first hour,
in which caches and tracks fill (after half of a run that is shorter than two hours).
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

MAX_MEMORY_GROWTH: Final = 0.05
FIRST_S: Final = 3600.0
STEPS_PER_SECOND: Final = 10
"""At --speed max a step is a tenth of a second."""
POOL: Final = min(32, (os.cpu_count() or 1) + 4)
"""Threads in asyncio's pool, once it has used them."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Resources of the daemon without connections.

    simulated_s, steps      its clock, and its number of steps (/metrics)
    rss_kib, descriptors, threads      as the system counts them (/proc)
    tasks, answers, shapes, obstacles  by its own count (/metrics)
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
    """A number and its bound."""

    what: str
    value: float
    bound: str
    is_met: bool


def check_samples(samples: Sequence[Sample], hours: float) -> list[Finding]:
    """Return the findings of at least two samples, the first taken before the first client."""
    first, last = samples[0], samples[-1]
    # An hour, or half of a run that is shorter than two hours.
    warm_s = min(FIRST_S, 1800.0 * hours)
    warm = next(sample for sample in samples if sample.simulated_s >= warm_s)
    later = samples[samples.index(warm):]  # fmt: skip
    growth = max(sample.rss_kib for sample in later) / warm.rss_kib - 1.0
    # Steps of 0.1 s: clock and count must agree exactly, not only nearly.
    drift_s = max(abs(sample.simulated_s - sample.steps / STEPS_PER_SECOND) for sample in samples)
    return [
        Finding("simulated hours", last.simulated_s / 3600, f"at least {hours:g}", last.simulated_s >= 3600 * hours),
        Finding("memory, largest after the first hour relative to then, %", 100 * growth,
                f"at most {100 * MAX_MEMORY_GROWTH:g}", growth <= MAX_MEMORY_GROWTH),
        Finding("clock less steps, s", drift_s, "0", drift_s == 0.0),
        check_leftovers("tasks", [sample.tasks for sample in samples]),
        check_leftovers("descriptors", [sample.descriptors for sample in samples]),
        Finding("threads at the end", last.threads, f"at most {first.threads} + {POOL} of asyncio's pool",
                last.threads <= first.threads + POOL),
    ]  # fmt: skip


def check_leftovers(what: str, counts: Sequence[int]) -> Finding:
    """Check that a count without connections never exceeds the first one."""
    # Relative to the sample before the first client.
    largest = max(counts) - counts[0]
    return Finding(f"{what} left over, largest of {len(counts)} times", largest, "0", largest <= 0)


def check_activity(sessions: Mapping[str, int], struck: int, kinds: Sequence[str]) -> list[Finding]:
    """Check that clients of every kind connected and that faults were injected."""
    fewest = min(sessions.get(kind, 0) for kind in kinds)
    return [
        Finding("sessions", sum(sessions.values()), "at least 1 of each kind", fewest >= 1),
        Finding("injected faults", struck, "at least 1", struck >= 1),
    ]


def check_end(exit_code: int, complaints: int) -> list[Finding]:
    """Check that the daemon ended cleanly; `complaints` is the number of internal errors that it logged."""
    return [
        Finding("exit code", exit_code, "0", exit_code == 0),
        Finding("internal errors, logged", complaints, "0", complaints == 0),
    ]
