"""The surfaces of walls: where along a wall its level changes.

A surface stays at a level for some length and is then drawn anew (problem.py). Of all divisions of the cells of a wall
into stretches, each of one level b ~ N(0, std^2), the most probable one has the least sum of

    stretch    sum(w_c (z_c - b)^2) + b^2 / std^2, at its best b     w_c, z_c: information and median of a cell's echoes
               + ln(1 + std^2 sum(w_c))                              how much they narrow the level
    border     -2 ln(p) where the level changes, -2 ln(1 - p) where it stays

By dynamic programming: the best division of the first n cells is that of the first m, and one stretch more. The levels
start at those of the stretches, and are then unknowns of the map.

A slope of the whole wall and a step in it explain the echoes of a short one about as well. So the same sum rates the
directions of a wall: turned by an angle t about its middle, x along it, a cell says z_c cos(t) + x_c sin(t) instead.

References
----------
Jackson et al., An Algorithm for Optimal Partitioning of Data on an Interval (2005). MacKay, Information Theory,
Inference, and Learning Algorithms (2003), section 28.1: how much echoes narrow a level.
"""

from __future__ import annotations

from dataclasses import replace
from math import log
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats
from localization.mapping.problem import LEVEL_CELL_IN, NO_LEVEL, Assignment, Levels, MapProblem, MapState

SAME_COST: Final = 1e-9
"""Costs that differ by less are equal up to rounding."""


class Division(NamedTuple):
    """The most probable division of a wall.

    Attributes
    ----------
    begins
        (l,) True where a stretch begins, except the first one.
    levels
        (l,) level of each cell.
    cost
        Its sum, without what all divisions of the wall have in common.
    """

    begins: npt.NDArray[np.bool_]
    levels: Floats
    cost: float


def divided(
    problem: MapProblem, state: MapState, assignment: Assignment, had_level: npt.NDArray[np.bool_]
) -> Levels:
    """Return the levels of a state divided into the most probable stretches.

    Walls that are divided as before have the same levels, unless they have cells that had none (l,).
    """
    levels, reflection = state.levels, problem.reflection
    medians, information = _medians(problem, state, assignment), problem.level_information(levels, assignment)
    values, is_new = levels.value_in.copy(), levels.is_new.copy()
    changes = _change_probability(problem)
    for wall in np.unique(levels.wall).tolist():
        own = levels.of(wall)
        begins, found, _ = stretches(medians[own], information[own], reflection.surface_std_in, changes)
        if not np.array_equal(begins, levels.is_new[own]) or not had_level[own].all():
            values[own], is_new[own] = found, begins
    return replace(levels, value_in=values, is_new=is_new)


def costs_of_turns(
    problem: MapProblem, state: MapState, assignment: Assignment, wall: int, middle_in: float, turns_rad: Floats
) -> Floats:
    """Return the costs (t,) of the most probable stretches of a wall that is turned about a coordinate along it."""
    own = state.levels.of(wall)
    medians = _medians(problem, state, assignment)[own]
    information = problem.level_information(state.levels, assignment)[own]
    along_in = LEVEL_CELL_IN * (state.levels.cell[own] + 0.5) - middle_in
    std, changes = problem.reflection.surface_std_in, _change_probability(problem)
    return np.array([
        stretches(medians * np.cos(turn) + along_in * np.sin(turn), information, std, changes).cost
        for turn in turns_rad.tolist()
    ])  # fmt: skip


def _change_probability(problem: MapProblem) -> float:
    """Return the probability that a surface changes from one cell to the next."""
    return 1.0 - float(problem.reflection.correlation(np.array(LEVEL_CELL_IN)))


def _medians(problem: MapProblem, state: MapState, assignment: Assignment) -> Floats:
    """Return the median (l,) of the levels that the echoes of each cell say; 0 for cells without echoes."""
    levels, echoes = state.levels, np.flatnonzero(assignment.level != NO_LEVEL)
    sensors, prediction = problem.predict(state, assignment, echoes)
    level = assignment.level[echoes]
    # A wall that stands out by an inch more is an inch nearer, or farther off from behind.
    values = levels.value_in[level] + (sensors.range_in - prediction.range_in) / prediction.by_feature[:, 1]
    values = values[np.lexsort((values, level))]
    counts = np.bincount(level, minlength=len(levels))
    first, has_echoes = np.cumsum(counts) - counts, counts > 0
    medians = np.zeros(len(levels))
    low, high = first + (counts - 1) // 2, first + counts // 2
    medians[has_echoes] = 0.5 * (values[low[has_echoes]] + values[high[has_echoes]])
    return medians


def stretches(values: Floats, information: Floats, std: float, changes: float) -> Division:
    """Return the most probable division of the cells of a wall into stretches of one level.

    Parameters
    ----------
    values, information
        (l,) what the echoes of each cell say, and the inverse of its variance.
    std
        Prior standard deviation of levels.
    changes
        Probability of a change from one cell to the next.
    """
    count = len(values)
    sums = np.zeros((3, count + 1))
    np.cumsum((information, information * values, information * values**2), axis=1, out=sums[:, 1:])
    # 1. The cost of each stretch, to the cell before an end (rows) from a first one (columns). All divisions have
    # -2 (count - 1) ln(1 - p) in common, which is left out: so a change costs 2 ln((1 - p) / p).
    w, wz, wzz = sums[:, 1:, None] - sums[:, None, :-1]
    w = np.maximum(w, 0.0)
    costs = wzz - wz**2 / (w + std**-2) + np.log1p(w * std**2)
    costs[:, 1:] += 2.0 * log((1.0 - changes) / changes)
    # 2. The best division of the cells before each end, by the first cell of its last stretch.
    best, start = np.zeros(count + 1), np.zeros(count + 1, dtype=np.intp)
    for end in range(1, count + 1):
        cost = best[:end] + costs[end - 1, :end]
        # The first of equal ones: where in a gap without echoes a level changes makes no difference.
        start[end] = (cost < cost.min() + SAME_COST).argmax()
        best[end] = cost[start[end]]
    # 3. Its stretches, the last one first.
    begins, levels, end = np.zeros(count, dtype=np.bool_), np.zeros(count), count
    while end:
        first = int(start[end])
        w, wz, _ = sums[:, end] - sums[:, first]
        levels[first:end], begins[first], end = wz / (w + std**-2), first > 0, first
    return Division(begins, levels, float(best[count]))


def gate_variances(problem: MapProblem, levels: Levels, assignment: Assignment) -> Floats:
    """Return the variances (l,) of the levels by their own echoes, given those before, from which they may differ."""
    reflection = problem.reflection
    a = np.where(levels.is_first, 0.0, reflection.correlation(np.array(LEVEL_CELL_IN)))
    prior = 1.0 / (reflection.surface_std_in**2 * (1.0 - a * a))
    variances: Floats = 1.0 / (prior + problem.level_information(levels, assignment))
    return variances
