"""Chi-square tests of a map, of whether its ranges and encoders contradict each other.

    r_i          residual of a range or of the odometry, in standard deviations
    h_i          leverage: the part of r_i's variance that the unknowns take up, J_i P J_i'
    sum r_i^2    chi-square distributed with sum (1 - h_i) degrees of freedom, if the model is right

The sum is tested for the whole drive, for each wall and point, and for each loop, the odometry from the last echo of a
feature to the first one after the robot comes back to it: a loop that is closed at the wrong place, or a wall that is
two, is a small part of a long drive.

Neighbouring echoes of a feature err alike, by rounding and by the wall's surface. With the correlation rho of
neighbours n squares vary as n (1 - rho^2) / (1 + rho^2) independent ones do. No correlation is accepted beyond that of
the errors that can repeat, as a wrong map's residuals are correlated as well.

References
----------
Baarda, A Testing Procedure for Use in Geodetic Networks (1968): redundancy numbers 1 - h, tests of parts. Bayley,
Hammersley, The Effective Number of Independent Observations in an Autocorrelated Time Series (1946).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from localization.filters.belief import POSE, Floats, chi_square_quantile
from localization.mapping.association import MapEstimate, segments_of
from localization.mapping.measurements import Indices
from localization.mapping.problem import COMMON_OFFSET, NO_FEATURE, Assignment, MapProblem, MapState

RISK: Final = 0.001
"""Probability with which a sound drive fails the test of the whole, or one of those of all parts."""
MIN_FREEDOM: Final = 1.0
"""Parts with fewer degrees of freedom are not tested: nothing checks them."""
MAX_CORRELATION: Final = 0.5
"""Rounding and surface are at most half of the variance of neighbouring echoes."""
LOOP_NODES: Final = 40
"""A feature that was not measured for 20 s was left: coming back closes a loop."""
STRETCH_NODES: Final = 40
"""Nodes of a stretch of which the explained ranges are counted: 20 s."""
MIN_EXPLAINED: Final = 0.7
"""Least fraction of the ranges that a map must explain."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a drive: its place (2,), sum of squared residuals, degrees of freedom, and the quantile of the sum.

    `kind` is "drive", "wall", "point" or "loop", which is at the place where the robot came back to a feature.
    """

    kind: str
    place: Floats
    total: float
    freedom: float
    limit: float

    @property
    def excess(self) -> float:
        """The sum over its quantile, above 1 for a contradiction."""
        return self.total / self.limit


def check_parts(estimate: MapEstimate) -> list[Part]:
    """Return the tests of a map: the whole drive first, then features and loops."""
    problem, state = estimate.problem, estimate.state
    linear = problem.linearize_echoes(state, estimate.assignment)
    # 1. Squares and redundancy of each range, and of each step of the odometry.
    ranges, steps = np.square(linear.residuals[:, 0]), np.square(problem.odometry(state)[0]).sum(axis=1)
    range_leverages, step_leverages = leverages(problem, state, estimate.assignment)
    free, free_steps = 1.0 - range_leverages, POSE - step_leverages
    # 2. Echoes of each feature, in time.
    feature = estimate.assignment.feature[linear.echoes]
    groups = [np.flatnonzero(feature == number) for number in range(state.features)]
    squares = max(float(ranges.sum()), 1e-9)
    products = sum(float((r[1:] * r[:-1]).sum()) for r in (linear.residuals[group, 0] for group in groups))
    rho = min(max(products / squares, 0.0), MAX_CORRELATION)
    effective = (1.0 - rho * rho) / (1.0 + rho * rho)
    # 3. The sums.
    walls, positions = len(state.walls), state.poses[:, :2]
    middles = segments_of(state.walls, estimate.extents).reshape(-1, 2, 2).mean(axis=1)
    parts = [
        ("wall" if number < walls else "point", place, float(ranges[group].sum()), float(free[group].sum()))
        for number, (group, place) in enumerate(zip(groups, np.concatenate((middles, state.points)), strict=True))
    ]
    parts += [
        ("loop", positions[end], float(steps[begin:end].sum()), float(free_steps[begin:end].sum()))
        for begin, end in _loops([linear.node[group] for group in groups])
    ]
    parts = [part for part in parts if part[-1] >= MIN_FREEDOM]
    whole = ("drive", positions[-1], float(ranges.sum() + steps.sum()), float(free.sum() + free_steps.sum()))
    return [
        Part(*part, chi_square_quantile(1.0 - risk, max(part[-1], MIN_FREEDOM) * effective) / effective)
        for part, risk in ((whole, RISK), *((part, RISK / len(parts)) for part in parts))
    ]


def is_consistent(estimate: MapEstimate) -> bool:
    """Return True if a map explains enough ranges, and these and the odometry do not contradict each other."""
    feature = estimate.assignment.feature[estimate.echoes()]
    if not len(feature) or float((feature != NO_FEATURE).mean()) < MIN_EXPLAINED:
        return False
    return all(part.excess <= 1.0 for part in check_parts(estimate))


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a drive: its middle (2,), the fraction of its ranges that the map explains, and their number."""

    place: Floats
    explained: float
    ranges: int

    @property
    def at_most(self) -> float:
        """Upper bound of the fraction, two standard deviations of a binomial distribution above it."""
        return self.explained + 2.0 * float(np.sqrt(self.explained * (1.0 - self.explained) / self.ranges))


def least_explained(estimate: MapEstimate) -> Stretch | None:
    """Return the stretch of which the map explains the least; None for a drive shorter than one.

    Where the path is bent or a wall is wrong, the echoes of a few metres fit nothing, which a long drive averages out.
    """
    node, positions = estimate.problem.trajectory.node, estimate.state.poses[:, :2]
    is_explained = estimate.assignment.feature != NO_FEATURE
    stretches = []
    for first in range(0, len(positions) - STRETCH_NODES + 1, STRETCH_NODES):
        echoes = (node >= first) & (node < first + STRETCH_NODES)
        if (count := int(echoes.sum())) >= STRETCH_NODES:
            place = positions[first : first + STRETCH_NODES].mean(axis=0)
            stretches.append(Stretch(place, float(is_explained[echoes].mean()), count))
    return min(stretches, key=lambda stretch: stretch.at_most, default=None)


def _loops(nodes_of_features: list[Indices]) -> list[tuple[int, int]]:
    """Return the first and last nodes (k, 2) between which some feature was not measured, by the nodes of each."""
    loops = set[tuple[int, int]]()
    for nodes in nodes_of_features:
        ends = np.flatnonzero(np.diff(nodes) > LOOP_NODES)
        loops |= {(int(nodes[end]), int(nodes[end + 1])) for end in ends}
    return sorted(loops)


def leverages(problem: MapProblem, state: MapState, assignment: Assignment) -> tuple[Floats, Floats]:
    """Return the leverages (e,) of the explained ranges, and the sums (n-1,) of those of each step of the odometry."""
    linear = problem.linearize_echoes(state, assignment)
    covariance = problem.normal_equations(state, assignment).covariance()
    # 1. A range depends on the pose of its node, and on four unknowns of the border.
    J_pose, J_border, at = linear.by_pose[:, 0], linear.by_border[:, 0], linear.at
    shared = covariance.coupling[linear.node[:, None], :, at]
    ranges = (
        np.einsum("ei,eij,ej->e", J_pose, covariance.poses[linear.node], J_pose)
        + 2.0 * np.einsum("ei,eki,ek->e", J_pose, shared, J_border)
        + np.einsum("ei,eij,ej->e", J_border, covariance.border[at[:, :, None], at[:, None, :]], J_border)
    )
    # 2. A step depends on two poses and on the parameters of the odometry.
    J = np.concatenate(problem.odometry(state)[1:], axis=-1)
    first = state.walls.size + state.points.size
    parameters = slice(first, first + COMMON_OFFSET)
    P = np.empty((len(J), J.shape[-1], J.shape[-1]))
    before, after, rest = slice(0, POSE), slice(POSE, 2 * POSE), slice(2 * POSE, None)
    P[:, before, before], P[:, after, after] = covariance.poses[:-1], covariance.poses[1:]
    P[:, before, after], P[:, after, before] = covariance.neighbours, covariance.neighbours.swapaxes(-1, -2)
    P[:, rest, rest] = covariance.border[parameters, parameters]
    coupling = covariance.coupling[..., parameters]
    for pose, shared in ((before, coupling[:-1]), (after, coupling[1:])):
        P[:, pose, rest], P[:, rest, pose] = shared, shared.swapaxes(-1, -2)
    return ranges, np.einsum("nij,njk,nik->n", J, P, J)
