"""The random stream of a seed: independent of other seeds and of the length of the run."""

from __future__ import annotations

from itertools import islice

import numpy as np

from localization.experiments.figure_trial import draw_start_errors, draw_step_errors
from localization.filters.belief import Floats


def first(seeds: list[int], count: int) -> tuple[Floats, Floats]:
    """Motion (count, seeds, 2) and sonar (count, seeds, 16) errors."""
    moves, sounds = zip(*islice(draw_step_errors(seeds, 16), count), strict=True)
    return np.stack(moves), np.stack(sounds)


def test_a_seed_meets_the_same_noise_in_any_company() -> None:
    moves, sounds = first([3, 7, 5], 300)
    alone_moves, alone_sounds = first([7], 150)
    assert moves[:150, 1].tolist() == alone_moves[:, 0].tolist()
    assert sounds[:150, 1].tolist() == alone_sounds[:, 0].tolist()
    assert draw_start_errors([3, 7])[1].tolist() == draw_start_errors([7])[0].tolist()


def test_seeds_and_purposes_share_nothing() -> None:
    moves, sounds = first(list(range(8)), 500)
    starts = draw_start_errors(range(8))
    numbers = np.concatenate([moves.ravel(), sounds.ravel(), starts.ravel()])
    assert len(np.unique(numbers)) == numbers.size


def test_the_numbers_are_standard_normal() -> None:
    moves, sounds = first(list(range(8)), 1000)
    for numbers in (moves, sounds):
        # Four standard deviations of a mean and of a variance of that many normal numbers.
        assert abs(numbers.mean()) < 4 / np.sqrt(numbers.size)
        assert abs(numbers.var() - 1) < 4 * np.sqrt(2 / numbers.size)
