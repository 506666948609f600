"""Chi-square tests of a map, of whether its ranges and encoders contradict each other.

    r_i          residual of a range or of the odometry, in standard deviations
    h_i          leverage: the part of r_i's variance that the unknowns take up, J_i P J_i'
    sum r_i^2    chi-square distributed with sum (1 - h_i) degrees of freedom, if the model is right

The sum is tested for the whole drive, for each wall and point, and for each loop, the odometry from the last echo of a
feature to the first one after the robot comes back to it: a loop that is closed at the wrong place, or a wall that is
two, is a small part of a long drive.

A feature that was measured early, and again after the robot had left it, is solved as two, of which the late one lies d
beside the early one. Without a step of the others, d = E^-1 e with the covariance E^-1, and

    e' E^-1 e    is chi-square distributed with 2 degrees of freedom for each feature, if both are one

for each feature alone, and for all of them together: a bent path moves many by a little (score test). E and e are those
of the unknowns d after all others are eliminated from the normal equations. Ranges that are measured
from one place also have errors in common, however many they are: edges are round, and walls rough. Displacements that
look like such errors have the covariance D, d then has E^-1 + D, and the score is

    e' (E + E D E)^-1 e    D = LATE_STD_IN^2 (sum w) (J' W J)^-1    J derivatives of the late ranges, W their weights w

What a map should explain are the ranges that repeat: those that agree with the one before or after of the same sonar,
as any smooth surface does. Random readings do not, and are left out.

Neighbouring echoes of a feature err alike, by rounding and by the wall's surface. With the correlation rho of
neighbours n squares vary as n (1 - rho^2) / (1 + rho^2) independent ones do. No correlation is accepted beyond that of
the errors that can repeat, as a wrong map's residuals are correlated as well. Where walls have levels a corner is
where those of both meet, and moves with the feet of the walls: the squares of points count for POINT_WEIGHT.

References
----------
Rao, Large Sample Tests of Statistical Hypotheses Concerning Several Parameters (1948): the score test. Baarda, A
Testing Procedure for Use in Geodetic Networks (1968): redundancy numbers 1 - h, tests of parts. Bayley, Hammersley, The
Effective Number of Independent Observations in an Autocorrelated Time Series (1946).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from localization.filters.belief import HEADING, POSE, Floats, chi_square_quantile, rotate, wrap_angle
from localization.mapping.association import MapEstimate
from localization.mapping.measurements import Indices, Trajectory
from localization.mapping.problem import COMMON_OFFSET, NO_FEATURE, WALL, Assignment, MapProblem, MapState
from localization.mapping.reflectors import Mask, segments_of
from localization.mapping.solver import NormalEquations
from localization.mapping.weights import POINT_WEIGHT

RISK: Final = 0.001
"""Probability with which a sound drive fails the test of the whole, or one of those of all parts."""
RETURN_RISK: Final = 0.01
"""The same of late against early, alone and together: of a wrong map often a single feature shows it, by little."""
TINY: Final = 1e-9
"""Information added, so that what nothing measures leaves no matrix singular."""
MIN_FREEDOM: Final = 1.0
"""Parts with fewer degrees of freedom are not tested: nothing checks them."""
MAX_CORRELATION: Final = 0.5
"""Rounding and surface are at most half of the variance of neighbouring echoes."""
LOOP_NODES: Final = 40
"""A feature that was not measured for 20 s was left: coming back closes a loop."""
STRETCH_NODES: Final = 40
"""Nodes of a stretch of which the explained ranges are counted: 20 s."""
MIN_EXPLAINED: Final = 0.7
"""Least fraction of the ranges that repeat which a map must explain."""
MIN_EXPLAINED_OF_ALL: Final = 0.5
"""The same of all ranges: of a map that most ranges contradict nothing is known."""
REPEAT_NODES, REPEAT_SIGMAS = 4, 3.0
"""A sonar measures twice in four nodes at least; readings of a surface differ by less, and by the robot's motion."""
REPEAT_TANGENT: Final = 1.7
"""Of 60 degrees: the steepest incidence of a ray at which its range should repeat while the robot turns."""
LATE, LATE_MAP = "late ", "late map"
"""Kinds of the parts that compare what was measured late with what was measured early."""
LATE_STD_IN: Final = 0.15
"""Deviation of a constant error, and of one that grows along the feature, which its late ranges have in common."""
MIN_RETURN_ECHOES: Final = 4
"""Echoes before and after the robot had left a feature, that tell where each of both is."""


@dataclass(frozen=True, slots=True)
class Part:
    """A part of a drive: its place (2,), sum of squared residuals, degrees of freedom, and the quantile of the sum.

    `kind` is "drive", "wall", "point" or "loop", which is at the place where the robot came back to a feature; of
    `compare_returns` "late wall", "late point" or "late map".
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
    if estimate.surface_in:
        # What a point's ranges count for: where walls have levels its variance is as much greater.
        ranges[feature >= len(state.walls)] *= POINT_WEIGHT
    rho = _correlation(linear.residuals[:, 0], groups)
    effective = (1.0 - rho * rho) / (1.0 + rho * rho)
    # 3. The sums.
    walls, positions = len(state.walls), state.poses[:, :2]
    parts = [
        ("wall" if number < walls else "point", place, float(ranges[group].sum()), float(free[group].sum()))
        for number, (group, place) in enumerate(zip(groups, _places(estimate), strict=True))
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


def _correlation(residuals: Floats, groups: Sequence[Indices]) -> float:
    """Return the correlation of neighbouring residuals (e,) of each feature's echoes, from 0 to MAX_CORRELATION."""
    squares = max(float(np.square(residuals).sum()), 1e-9)
    products = sum(float((r[1:] * r[:-1]).sum()) for r in (residuals[group] for group in groups))
    return min(max(products / squares, 0.0), MAX_CORRELATION)


def _places(estimate: MapEstimate) -> Floats:
    """Return the middles of walls, and points (f, 2)."""
    middles = segments_of(estimate.state.walls, estimate.extents).reshape(-1, 2, 2).mean(axis=1)
    return np.concatenate((middles, estimate.state.points))


def compare_returns(estimate: MapEstimate) -> list[Part]:
    """Return the tests of features that were left and measured again: the late map first, then each feature.

    Sums of correlated residuals vary as (1 + rho) / (1 - rho) those of independent ones do. Where the ranges vary less
    than stated, late ones must agree with early ones as much better.
    """
    state = estimate.state
    linear = estimate.problem.linearize_echoes(state, estimate.assignment)
    groups = _groups(estimate, linear.echoes)
    late = _late_rows(groups, linear.node)
    if not late:
        return []
    E, e = late_information(estimate, list(late.values()))
    # The variance of sums of correlated residuals, and of ranges that are more accurate than stated.
    rho = _correlation(linear.residuals[:, 0], groups)
    free = 1.0 - leverages(estimate.problem, state, estimate.assignment)[0]
    variance = float(np.square(linear.residuals[:, 0]).sum() / max(float(free.sum()), MIN_FREEDOM))
    factor, places = min(variance, 1.0) * (1.0 + rho) / (1.0 - rho), _places(estimate)
    walls = len(state.walls)
    D = np.zeros_like(E)
    for row, rows in enumerate(late.values()):
        own = slice(WALL * row, WALL * (row + 1))
        D[own, own] = common_errors(linear.by_border[rows, 0, :WALL], linear.by_border[rows, 0, WALL])

    def part(kind: str, place: Floats, own: slice, risk: float) -> Part:
        freedom = float(len(e[own]))
        limit = chi_square_quantile(1.0 - risk, freedom) * factor
        return Part(kind, place, _score(E[own, own], e[own], D[own, own]), freedom, limit)

    parts = [part(LATE_MAP, state.poses[-1, :2], slice(None), RETURN_RISK)]
    for row, number in enumerate(late):
        kind = LATE + ("wall" if number < walls else "point")
        parts.append(part(kind, places[number], slice(WALL * row, WALL * (row + 1)), RETURN_RISK / len(late)))
    return parts


def common_errors(J: Floats, roots: Floats) -> Floats:
    """Return the covariance D (2, 2) of a feature's displacement that common errors of k ranges look like.

    Parameters
    ----------
    J
        (k, 2) derivatives of the ranges by the feature, times the roots of the weights.
    roots
        (k,) roots of the weights.
    """
    D: Floats = LATE_STD_IN**2 * (roots @ roots) * np.linalg.inv(J.T @ J + TINY * np.eye(WALL))
    return D


def _score(E: Floats, e: Floats, D: Floats) -> float:
    """Return e' (E + E D E)^-1 e."""
    return float(e @ np.linalg.solve(E + E @ D @ E + TINY * np.eye(len(E)), e))


def late_scores(estimate: MapEstimate) -> list[tuple[int, float, Indices]]:
    """Return number, score e' E^-1 e and late rows of the features that were left and measured again.

    The score is by how much the sum of squares falls if the late feature is another one. The rows are those of the
    explained echoes.
    """
    linear = estimate.problem.linearize_echoes(estimate.state, estimate.assignment)
    late = _late_rows(_groups(estimate, linear.echoes), linear.node)
    if not late:
        return []
    E, e = late_information(estimate, list(late.values()))
    blocks, no_errors = E.reshape(len(late), WALL, len(late), WALL), np.zeros((WALL, WALL))
    return [
        (number, _score(blocks[k, :, k], own, no_errors), rows)
        for k, ((number, rows), own) in enumerate(zip(late.items(), e.reshape(-1, WALL), strict=True))
    ]


def _groups(estimate: MapEstimate, echoes: Indices) -> list[Indices]:
    """Return the rows of each feature among explained echoes, of those that count: others cannot disagree."""
    counts = estimate.problem.trajectory.weight[echoes] > 0.0
    feature = np.where(counts, estimate.assignment.feature[echoes], NO_FEATURE)
    return [np.flatnonzero(feature == number) for number in range(estimate.state.features)]


def _late_rows(groups: list[Indices], nodes: Indices) -> dict[int, Indices]:
    """Return the rows since each feature that was left was measured again, by its number."""
    late = {number: _measured_again(group, nodes[group]) for number, group in enumerate(groups)}
    return {number: rows for number, rows in late.items() if len(rows)}


def _measured_again(group: Indices, nodes: Indices) -> Indices:
    """Return the rows of a feature's echoes since it was measured again, by all of them and their nodes.

    There are none if it was not. Of several returns, the one with most echoes on the side with fewer.
    """
    counts = np.flatnonzero(np.diff(nodes) > LOOP_NODES) + 1
    if not len(counts):
        return group[:0]
    count = int(counts[np.minimum(counts, len(group) - counts).argmax()])
    return group[count:] if min(count, len(group) - count) >= MIN_RETURN_ECHOES else group[:0]


def late_information(estimate: MapEstimate, late: Sequence[Indices]) -> tuple[Floats, Floats]:
    """Return E (2k, 2k) and e (2k,) of the displacements of k features since they were measured again.

    Parameters
    ----------
    estimate
        A map at its optimum.
    late
        For each of these features the rows of its late echoes among the explained ones.
    """
    problem, state = estimate.problem, estimate.state
    linear = problem.linearize_echoes(state, estimate.assignment)
    N = problem.normal_equations(state, estimate.assignment)
    first, size = len(N.border), len(N.border) + WALL * len(late)
    # 1. Two more unknowns for each: its late echoes depend on them as on the feature.
    C, D = np.zeros((*N.coupling.shape[:2], size)), np.zeros((size, size))
    C[..., :first], D[:first, :first] = N.coupling, N.border
    h = np.concatenate((N.border_gradient, np.zeros(size - first)))
    for row, rows in enumerate(late):
        own = slice(first + WALL * row, first + WALL * (row + 1))
        J = linear.by_border[rows][:, :, :WALL]
        np.add.at(C[..., own], linear.node[rows], linear.by_pose[rows].swapaxes(-1, -2) @ J)
        np.add.at(D[:, own], linear.at[rows], linear.by_border[rows].swapaxes(-1, -2) @ J)
        D[own, :first] = D[:first, own].T
        D[own, own] = (J.swapaxes(-1, -2) @ J).sum(axis=0)
        h[own] = -(J.swapaxes(-1, -2) @ linear.weighted[rows][..., None]).sum(axis=0)[:, 0]
    # 2. Everything else is eliminated.
    S, right = NormalEquations(N.diagonal, N.upper, C, D, N.pose_gradient, h).reduced()
    others = np.linalg.solve(S[:first, :first], np.concatenate((S[:first, first:], right[:first, None]), axis=1))
    B = S[:first, first:].T
    return S[first:, first:] - B @ others[:, :-1], right[first:] - B @ others[:, -1]


def repeated_ranges(trajectory: Trajectory, *, rays: bool) -> Mask:
    """Return True (e,) for ranges that agree with the one before or after of the same sonar."""
    # 1. Pairs of neighbours of each sonar, in time.
    order = np.argsort(trajectory.sonar, kind="stable")
    one, other = order[:-1], order[1:]
    node, sonar, readings = trajectory.node, trajectory.sonar, trajectory.readings_in
    agrees = (sonar[one] == sonar[other]) & (node[other] - node[one] <= REPEAT_NODES)
    # 2. No range to a surface changes by more than the sonar has moved, but that of a ray that turns.
    heading = trajectory.odometry[node, HEADING]
    face = trajectory.odometry[node, :2] + rotate(trajectory.mounts, heading)
    allowed = np.hypot(*(face[other] - face[one]).T)
    allowed += REPEAT_SIGMAS * np.hypot(trajectory.std_in[one], trajectory.std_in[other])
    if rays:
        turn = np.abs(wrap_angle(np.diff((heading + trajectory.axes_rad)[order])))
        allowed += REPEAT_TANGENT * turn * np.minimum(readings[one], readings[other])
    agrees &= np.abs(readings[other] - readings[one]) <= allowed
    repeats = np.zeros(len(node), dtype=np.bool_)
    repeats[one[agrees]] = repeats[other[agrees]] = True
    return repeats


def explained_fractions(estimate: MapEstimate) -> tuple[float, float]:
    """Return the fractions of all ranges, and of those that repeat, that a map explains."""
    trajectory, rays = estimate.problem.trajectory, estimate.problem.rays
    inside = trajectory.node < len(estimate.state.poses)
    is_explained = estimate.assignment.feature != NO_FEATURE
    repeats = inside & repeated_ranges(trajectory, rays=rays)
    of_all, of_repeated = (float(is_explained[some].mean()) if some.any() else 0.0 for some in (inside, repeats))
    return of_all, of_repeated


def explains_enough(of_all: float, of_repeated: float) -> bool:
    """Return True if a map explains enough of all ranges, and of those that repeat."""
    return of_all >= MIN_EXPLAINED_OF_ALL and of_repeated >= MIN_EXPLAINED


def is_consistent(estimate: MapEstimate) -> bool:
    """Return True if a map explains enough ranges, and these and the odometry do not contradict each other."""
    return explains_enough(*explained_fractions(estimate)) and all(part.excess <= 1.0 for part in check_parts(estimate))


@dataclass(frozen=True, slots=True)
class Stretch:
    """A stretch of a drive: its middle (2,), the explained fraction of the ranges that repeat, and their number."""

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
    trajectory, positions = estimate.problem.trajectory, estimate.state.poses[:, :2]
    repeats = repeated_ranges(trajectory, rays=estimate.problem.rays)
    node = trajectory.node[repeats]
    is_explained = estimate.assignment.feature[repeats] != NO_FEATURE
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
