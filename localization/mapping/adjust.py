"""Adjust a map to lengths that were measured with a tape: least squares over its walls with their standard deviations.

    unknowns      the ends of the walls (n, 2); walls that meet share an end
    prior         of each wall: its position across its direction, and its direction (WallAccuracy)
                  of each end: along its walls, ALONG_STD_IN
    tape          distance of two ends, with its own standard deviation
    joints        an end on another wall stays on it

A wall without an accuracy, such as one drawn by hand, has UNKNOWN_ACCURACY. Walls are independent, as their standard
deviations in the file are.

References
----------
Mikhail and Ackermann, Observations and Least Squares (1976): conditions as observations of high weight.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import radians
from typing import Final

import numpy as np

from localization.filters.belief import Floats, chi_square_quantile
from nclient.errors import NomadError
from worlds.geometry import FloatArray, IndexArray, nearest_points
from worlds.world import Point, WallAccuracy, World, moved_surface

UNKNOWN_ACCURACY: Final = WallAccuracy(1.0, radians(2.0), 0.0)
"""Of a wall that was not measured: a drawing by eye."""
ALONG_STD_IN: Final = 3.0
"""Standard deviation of an end along its wall: where the wall ends was not measured as its position was."""
JOINT_STD_IN: Final = 1e-3
"""Standard deviation with which an end stays on another wall."""
TAPE_STD_IN: Final = 0.1
"""Default standard deviation of a tape's length: 1/8 in of reading and sagging."""
TOUCHING_IN: Final = 1e-3
"""Ends within this distance are one, and lie on a wall."""
NEAR_IN: Final = 6.0
"""A named point belongs to an end within this distance."""
MAX_WALLS: Final = 300
"""Larger maps are refused: the effort grows with the third power."""
MAX_ITERATIONS: Final = 30
CONVERGED_IN: Final = 1e-9
REJECT_PROBABILITY: Final = 1e-4
"""A length is refused that is less probable than this, given the map: probably another one was measured."""


class AdjustmentError(NomadError, ValueError):
    """A length that cannot be used."""


@dataclass(frozen=True, slots=True)
class TapeLength:
    """A measured distance of two ends of walls, inches; `ends_in` only need to be near them."""

    ends_in: tuple[Point, Point]
    length_in: float
    std_in: float = TAPE_STD_IN


@dataclass(frozen=True, slots=True)
class Adjustment:
    """A map after the adjustment.

    Attributes
    ----------
    world
        The map with moved walls and their new accuracies.
    moved_in
        Largest movement of an end.
    residuals_in
        Of each length: in the map afterwards minus measured.
    """

    world: World
    moved_in: float
    residuals_in: tuple[float, ...]


def adjust_walls(world: World, lengths: Iterable[TapeLength]) -> Adjustment:
    """Return a map whose inner walls fit measured lengths best.

    Raises
    ------
    AdjustmentError
        If there is no end near a named point, the map is too large, or a length contradicts the map.
    """
    tapes = list(lengths)
    walls = world.inner_walls
    if not 0 < len(walls) <= MAX_WALLS:
        raise AdjustmentError(f"expected a map of 1 to {MAX_WALLS} inner walls, found {len(walls)}")
    # 1. Ends that coincide are one unknown.
    x0, of_wall = _shared_ends(walls)
    accuracies = [world.accuracies.get(row, UNKNOWN_ACCURACY) for row in range(len(walls))]
    tape_ends = [tuple(_nearest_end(x0, point) for point in tape.ends_in) for tape in tapes]
    for tape, (first, second) in zip(tapes, tape_ends, strict=True):
        if first == second or not tape.length_in > 0.0 or not tape.std_in > 0.0:
            raise AdjustmentError("a length is between two different ends of walls, and above 0")
    # 2. The linear part: prior and joints, rows of H with standard deviation 1; both are 0 at x0.
    H = np.array([*_prior_rows(x0, of_wall, accuracies), *_joint_rows(x0, of_wall)])
    information = H.T @ H
    x, correction = x0.copy(), np.inf
    # 3. Gauss-Newton: the tapes are linearized at x.
    for _ in range(MAX_ITERATIONS):
        if correction < CONVERGED_IN:
            break
        A, residuals = _tape_rows(x, tapes, tape_ends)
        gradient = information @ (x - x0).ravel() + A.T @ residuals
        step = np.linalg.solve(information + A.T @ A, -gradient).reshape(x.shape)
        x, correction = x + step, float(np.abs(step).max())
    # 4. The test of the tapes against the map: the cost at the solution is chi-square with a degree for each tape.
    A, residuals = _tape_rows(x, tapes, tape_ends)
    offset = (x - x0).ravel()
    cost = float(offset @ information @ offset + residuals @ residuals)
    if tapes and cost > chi_square_quantile(1.0 - REJECT_PROBABILITY, len(tapes)):
        worst = int(np.abs(residuals).argmax())
        found_in = float(np.hypot(*(x0[tape_ends[worst][1]] - x0[tape_ends[worst][0]])))
        raise AdjustmentError(
            f"a length of {tapes[worst].length_in:g} in contradicts the map, which has {found_in:.2f} in there: "
            "measure again, or give it a larger standard deviation"
        )
    # 5. Walls and accuracies from the ends and their covariance.
    P = np.linalg.inv(information + A.T @ A)
    moved = x[of_wall].reshape(-1, 4)
    rows = list(_accuracy_rows(x0, of_wall))
    stds = [[float(np.sqrt(row @ P @ row)) for row in pair] for pair in rows]
    adjusted = {
        row: WallAccuracy(
            stds[row][0], stds[row][1], accuracy.measured_in, moved_surface(accuracy.surface, walls[row], moved[row])
        )
        for row, accuracy in sorted(world.accuracies.items())
    }
    return Adjustment(
        replace(world, inner_walls=moved, accuracies=adjusted), float(np.hypot(*(x - x0).T).max()),
        tuple(float(r) * tape.std_in for r, tape in zip(residuals, tapes, strict=True)),
    )  # fmt: skip


def label_walls(world: World, labels: Iterable[tuple[Point, str]]) -> World:
    """Return a map in which the inner walls nearest to points have names; an empty name removes one.

    Raises
    ------
    AdjustmentError
        If no inner wall is near a point.
    """
    names = dict(world.wall_names)
    for (x, y), name in labels:
        _, distances = nearest_points(np.array([[x, y]]), world.inner_walls)
        if not distances.size or not distances.min() <= NEAR_IN:
            raise AdjustmentError(f"no inner wall is within {NEAR_IN:g} in of ({x:g}, {y:g}) in")
        names[int(distances.argmin())] = name
    return replace(world, wall_names={row: name for row, name in names.items() if name})


def _shared_ends(walls: FloatArray) -> tuple[Floats, IndexArray]:
    """Return the different ends (n, 2), and the numbers of the ends of each wall (m, 2)."""
    ends = walls.reshape(-1, 2)
    apart = np.hypot(*(ends[:, None, :] - ends).transpose(2, 0, 1))
    # Of ends that coincide the first one counts.
    first, numbers = np.unique((apart <= TOUCHING_IN).argmax(axis=1), return_inverse=True)
    return ends[first], numbers.reshape(-1, 2)


def _nearest_end(ends: Floats, point: Point) -> int:
    distances = np.hypot(*(ends - point).T)
    nearest = int(distances.argmin())
    if not distances[nearest] <= NEAR_IN:
        x, y = point
        raise AdjustmentError(f"no wall ends within {NEAR_IN:g} in of ({x:g}, {y:g}) in")
    return nearest


def _accuracy_rows(x0: Floats, of_wall: IndexArray) -> Iterator[tuple[Floats, Floats]]:
    """Yield the derivatives of a wall's position across its direction, at its middle, and of its direction.

    The accuracy of its position is that at the middle of what was measured, which need not be the same.
    """
    for first, second in of_wall:
        along = x0[second] - x0[first]
        length = float(np.hypot(*along))
        normal = np.array([-along[1], along[0]]) / length
        offset, angle = np.zeros_like(x0), np.zeros_like(x0)
        offset[first] = offset[second] = 0.5 * normal
        angle[first], angle[second] = -normal / length, normal / length
        yield offset.ravel(), angle.ravel()


def _prior_rows(x0: Floats, of_wall: IndexArray, accuracies: list[WallAccuracy]) -> Iterator[Floats]:
    """Yield the prior of all walls, rows of standard deviation 1."""
    tiny = np.finfo(float).tiny
    for (offset, angle), accuracy in zip(_accuracy_rows(x0, of_wall), accuracies, strict=True):
        yield offset / max(accuracy.offset_std_in, JOINT_STD_IN)
        # A wall whose direction has no accuracy in the file keeps it.
        yield angle / max(accuracy.angle_std_rad, JOINT_STD_IN * float(np.abs(angle).max()), tiny)
    for first, second in of_wall:
        along = x0[second] - x0[first]
        for end in (first, second):
            row = np.zeros_like(x0)
            row[end] = along / np.hypot(*along) / ALONG_STD_IN
            yield row.ravel()


def _joint_rows(x0: Floats, of_wall: IndexArray) -> Iterator[Floats]:
    """Yield the distances of ends to other walls on which they lie, rows of standard deviation 1."""
    nearest, distances = nearest_points(x0, x0[of_wall].reshape(-1, 4))
    for end, wall in np.argwhere(distances <= TOUCHING_IN):
        first, second = of_wall[wall]
        if end in (first, second):
            continue
        along = x0[second] - x0[first]
        length = float(np.hypot(*along))
        fraction = float((nearest[end, wall] - x0[first]) @ along) / length**2
        normal = np.array([-along[1], along[0]]) / length
        row = np.zeros_like(x0)
        row[end], row[first], row[second] = normal, -(1.0 - fraction) * normal, -fraction * normal
        yield row.ravel() / JOINT_STD_IN


def _tape_rows(x: Floats, tapes: list[TapeLength], ends: list[tuple[int, ...]]) -> tuple[Floats, Floats]:
    """Return derivatives and residuals of the tapes at x, divided by their standard deviations."""
    A, residuals = np.zeros((len(tapes), *x.shape)), np.zeros(len(tapes))
    for row, (tape, (first, second)) in enumerate(zip(tapes, ends, strict=True)):
        along = x[second] - x[first]
        distance = float(np.hypot(*along))
        A[row, first], A[row, second] = -along / distance / tape.std_in, along / distance / tape.std_in
        residuals[row] = (distance - tape.length_in) / tape.std_in
    return A.reshape(len(tapes), x.size), residuals
