"""Two maps of one drive: walls of the other one are tried in the cheaper one.

A drive of walls with levels is learned twice, in rounds of another size, and the cheaper map is taken (learn.py). It
may lack a wall that the other map has, or have it in a worse direction, since the early mistakes of the two differ.
Both maps are of the same echoes, so a wall of the other one is known by its echoes. Each of these walls is tried in
place of the features that explain most of their own echoes by the same ones, and is taken if the total cost falls by
MIN_DIFFERENCE. Genetic algorithms exchange parts between solutions in this manner.

References
----------
Mitchell, An Introduction to Genetic Algorithms (1996), section 1.6: crossover.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from localization.filters.belief import Floats, rotate, wrap_angle
from localization.mapping.association import MapEstimate
from localization.mapping.features import MIN_DIFFERENCE
from localization.mapping.measurements import Indices

SAME_FRACTION: Final = 0.5
"""A wall or point is replaced if more of its echoes are those of the other map's wall."""
EXCHANGE_STEPS: Final = 6
"""Steps of the optimizer before its echoes may leave the wall."""
MIN_ECHOES: Final = 10
"""Of a wall that is tried: one of fewer could hardly lower the cost by what a wall must save."""


def adopt_walls(estimate: MapEstimate, other: MapEstimate) -> int:
    """Take walls of another map of the same echoes where the cost falls by MIN_DIFFERENCE, and return their number."""
    adopted = 0
    for wall in range(len(other.state.walls)):
        echoes = other.echoes_of(wall)
        if len(echoes) < MIN_ECHOES:
            continue
        trial = _with_wall_of(estimate, other, wall, echoes)
        if trial.cost < estimate.cost - MIN_DIFFERENCE:
            estimate.replace_by(trial)
            adopted += 1
    return adopted


def _with_wall_of(estimate: MapEstimate, other: MapEstimate, wall: int, echoes: Indices) -> MapEstimate:
    """Return the map with a wall of another map and its echoes, in place of features that have most of theirs there."""
    trial = estimate.copy()
    # 1. What it replaces.
    for own in reversed(range(trial.state.features)):
        own_echoes = trial.echoes_of(own)
        if len(own_echoes) and np.isin(own_echoes, echoes).mean() > SAME_FRACTION:
            trial.remove(own)
    # 2. The wall where the robot measured it, by its poses in either map.
    line, extent = _moved(estimate, other, wall, echoes)
    number = len(trial.state.walls)
    trial.add_wall(line, extent, float(other.sides[wall]))
    feature = trial.assignment.feature.copy()
    feature[echoes] = number
    trial.assignment = replace(trial.assignment, feature=feature)
    # 3. Optimized with its echoes, then with those that each feature explains.
    for steps in (EXCHANGE_STEPS, 3, 3):
        trial.optimize(steps)
        trial.associate()
    return trial


def _moved(estimate: MapEstimate, other: MapEstimate, wall: int, echoes: Indices) -> tuple[Floats, Floats]:
    """Return the line (2,) and the extent (2,) of a wall of another map, moved as the poses of its echoes differ."""
    nodes = np.unique(other.problem.trajectory.node[echoes])
    before, after = other.state.poses[nodes], estimate.state.poses[nodes]
    turn = float(wrap_angle(after[:, 2] - before[:, 2]).mean())
    shift = after[:, :2].mean(axis=0) - rotate(before[:, :2].mean(axis=0), np.array(turn))
    angle, offset = other.state.walls[wall] + (turn, 0.0)
    line = np.array((angle, offset + shift @ (np.cos(angle), np.sin(angle))))
    return line, other.extents[wall] + shift @ (-np.sin(angle), np.cos(angle))
