"""The chance of the experiments: for every seed its own streams, one a purpose.

Rules: a number depends on its seed, its purpose and its place in the stream and on nothing else; so neither the size of
a batch nor the number of processes changes a result, and two figures with the same seed meet the same noise
(common random numbers): step k of seed s strays by the same standard normals in both.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from localization.filters.belief import Floats

_START, _MOTION, _SONAR = range(3)

_BLOCK: Final = 128
"""Steps drawn at once: a call a step and seed would cost more than the filter."""


def start_errors(seeds: Sequence[int]) -> Floats:
    """Standard normals (seeds, 3) for the error of the first estimate."""
    return np.stack([_generator(seed, _START).standard_normal(3) for seed in seeds])


def step_errors(seeds: Sequence[int], beams: int) -> Iterator[tuple[Floats, Floats]]:
    """For each step, without end: standard normals (seeds, 2) for the motion and (seeds, beams) for the sonars."""
    motion = [_generator(seed, _MOTION) for seed in seeds]
    sonar = [_generator(seed, _SONAR) for seed in seeds]
    while True:
        moves = np.stack([rng.standard_normal((_BLOCK, 2)) for rng in motion], axis=1)
        sounds = np.stack([rng.standard_normal((_BLOCK, beams)) for rng in sonar], axis=1)
        yield from zip(moves, sounds, strict=True)


def _generator(seed: int, purpose: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(purpose,)))
