"""Observability of a map: the posterior Cramer-Rao bound of localization over free space.

    J     Fisher information about (x, y, heading) of one cycle of all sixteen sonars, averaged over HEADINGS
          directions of the ring
    P'    = ((F P F' + Q)^-1 + J)^-1, CYCLES times from START_STD
    F     Jacobian of the motion: over one cycle a heading error becomes a lateral position error
    Q     odometry noise of that motion at `speed_in_s`

The bound applies to a robot that drives straight for a minute and a half while its surroundings remain as seen from
the given position: no unbiased filter can be more accurate, in whichever of DIRECTIONS it drives, and a good one comes
close. Driving adds information about the heading, which ranges alone measure poorly. Directions that the ring does
not observe, such as along a corridor, become more uncertain with the distance.

Rays count if they meet a wall steeply enough and within range, cones with the probability of each echo.

References
----------
Tichavsky, Muravchik, Nehorai: Posterior Cramer-Rao bounds for discrete-time nonlinear filtering (1998).
"""

from __future__ import annotations

from collections.abc import Iterator
from math import tau
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.base import LocalizationConfig
from localization.filters.belief import HEADING, Floats
from localization.filters.odometry import OdometryNoise, process_covariance, step_jacobians
from localization.filters.range_table import around_block
from localization.filters.sonar_cone import ConeSonar, Reflectors, expected_echoes, reflectors
from localization.filters.sonar_ray import RaySonar, SonarRing, WallMap, ranges_from, wall_map
from localization.filters.update import Refusal
from worlds.rings import SonarMount
from worlds.robots import SONARS

HEADINGS: Final = 4
"""Directions of the ring within its symmetry of 22.5 degrees."""
DIRECTIONS: Final = 8
CYCLES: Final = 100
BLOCK_IN: Final = 48.0
"""Positions in one square of this side see about the same."""
CYCLE_S: Final = 0.96
"""All sixteen sonars measure once in a cycle."""
START_STD: Final = (24.0, 24.0, 0.5)
"""Initial standard deviations: in, in, rad."""
_HEADING_STD_RAD: Final = 0.01


class Observability(NamedTuple):
    """The bound at n positions.

    Attributes
    ----------
    positions : (n, 2) array
        Inches.
    cov : (n, 3, 3) array
        Bound for the driving direction with the best position.
    heading_rad : (n,) array
        Smallest standard deviation of the heading over all driving directions.
    """

    positions: Floats
    cov: Floats
    heading_rad: Floats

    @property
    def worst_in(self) -> Floats:
        """Standard deviations (n,) of the position along its worst direction, inches."""
        return _worst_in(self.cov)


def compute_observability(config: LocalizationConfig, positions: Floats, speed_in_s: float = 5.0) -> Observability:
    """Return the bound at positions (n, 2) in inches, for a robot that drives at `speed_in_s`."""
    information = np.empty((len(positions), 3, 3))
    around = reflectors(wall_map(config.walls).segments)
    for block in _blocks(positions):
        information[block] = _cycle_information(config, around, positions[block]) / HEADINGS
    directions = np.arange(DIRECTIONS) * (tau / DIRECTIONS)
    covs = np.stack(
        [_bound_after_cycles(config.odometry, information, speed_in_s * CYCLE_S, direction) for direction in directions]
    )
    best = np.argmin(_worst_in(covs), axis=0)
    heading: Floats = np.sqrt(covs[..., HEADING, HEADING].min(axis=0))
    return Observability(positions, covs[best, np.arange(len(positions))], heading)


def _bound_after_cycles(
    odometry: OdometryNoise, information: Floats, distance_in: float, direction_rad: float
) -> Floats:
    """Return P (n, 3, 3) after CYCLES of `distance_in` in a direction, each with `information` J (n, 3, 3)."""
    step = np.array([distance_in, 0.0])
    F, G = step_jacobians(np.array([0.0, 0.0, direction_rad]), step)
    one = _cycle(F, process_covariance(G, step, odometry), information)
    # 1. All cycles as one map, by repeated squaring: CYCLES as a binary number, its highest digit first.
    cycles = one
    for digit in f"{CYCLES:b}"[1:]:
        cycles = _after(cycles, cycles)
        if digit == "1":
            cycles = _after(cycles, one)
    # 2. The covariance that it makes of the first one.
    P = np.diag(np.square(START_STD))
    A, C, H = cycles
    last: Floats = A @ P @ np.linalg.inv(np.eye(3) + C @ P) @ A.swapaxes(-1, -2) + H
    return 0.5 * (last + last.swapaxes(-1, -2))


class _Riccati(NamedTuple):
    """The map P -> A P (I + C P)^-1 A' + H of covariances, all (n, 3, 3)."""

    A: Floats
    C: Floats
    H: Floats


def _cycle(F: Floats, Q: Floats, J: Floats) -> _Riccati:
    """Return the map of one cycle, ((F P F' + Q)^-1 + J)^-1; Q need not be invertible."""
    W = np.linalg.inv(np.eye(3) + Q @ J)
    return _Riccati(W @ F, F.T @ J @ W @ F, W @ Q)


def _after(first: _Riccati, second: _Riccati) -> _Riccati:
    """Return the map of two maps, one after the other.

    References
    ----------
    Chu, Fan, Lin, Wang: Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations (2004).
    """
    T = np.linalg.inv(np.eye(3) + first.H @ second.C)
    A = second.A @ T
    return _Riccati(
        A @ first.A,
        first.C + first.A.swapaxes(-1, -2) @ second.C @ T @ first.A,
        second.H + A @ first.H @ second.A.swapaxes(-1, -2),
    )


def _worst_in(covs: Floats) -> Floats:
    """Return standard deviations (...) of the position along its worst direction, of covariances (..., 3, 3)."""
    worst: Floats = np.sqrt(np.linalg.eigvalsh(covs[..., :HEADING, :HEADING])[..., -1])
    return worst


def _blocks(positions: Floats) -> Iterator[npt.NDArray[np.intp]]:
    """Yield the rows of positions that are neighbours: those in one square of BLOCK_IN."""
    _, squares = np.unique(np.floor(positions / BLOCK_IN).astype(np.intp), axis=0, return_inverse=True)
    order = np.argsort(squares.ravel(), kind="stable")
    yield from np.split(order, np.flatnonzero(np.diff(squares.ravel()[order])) + 1)


def _cycle_information(config: LocalizationConfig, around: Reflectors, positions: Floats) -> Floats:
    """Return the sum of J (n, 3, 3) over all headings of the ring at neighbouring positions (n, 2)."""
    # A sonar at an angle from the heading sees the same as one straight ahead of a robot turned by that angle.
    headings = np.arange(HEADINGS) * (tau / SONARS / HEADINGS)
    beams = (headings[:, None] + np.asarray(config.body.sonar_angles_rad, dtype=np.float64)).ravel()
    poses = np.empty((len(positions), len(beams), 3))
    poses[..., :2], poses[..., HEADING] = positions[:, None], beams
    if isinstance(config.sonar, ConeSonar):
        return _cone_information(poses, config.body, config.sonar, around)
    return _ray_information(poses, config.body, config.sonar, wall_map(config.walls))


def _ray_information(poses: Floats, body: SonarRing, sonar: RaySonar, walls: WallMap) -> Floats:
    # Readings of valid beams, weighted by their inverse variance.
    beams = ranges_from(poses, np.zeros(1), body, walls)
    used = (beams.refusal == Refusal.NONE) & (beams.range_in > sonar.lowest_in) & (beams.range_in < sonar.highest_in)
    weight = np.where(used, 1.0 / sonar.variance(beams.range_in), 0.0)
    H = np.where(used[..., None], np.stack(beams.H, axis=-1), 0.0)
    return _sum_information(H.reshape(len(poses), -1, 3), weight.reshape(len(poses), -1))


def _cone_information(poses: Floats, body: SonarRing, model: ConeSonar, around: Reflectors) -> Floats:
    # 1. Reflectors near and in sight, and what may block the view of them.
    seen, blocking = around_block(poses[:, 0, :2], around, body.sonar_ring_radius_in)
    # 2. Each echo counts with its probability.
    spread: npt.NDArray[np.float64] = np.full(poses.shape[:-1], _HEADING_STD_RAD)
    echoes = expected_echoes(poses, spread, SonarMount(0.0, body.sonar_ring_radius_in), seen, model, blocking)
    is_range = (echoes.ranges_in > model.lowest_in) & (echoes.ranges_in < model.highest_in)
    probability = (1.0 - model.outlier_probability) * np.where(is_range, echoes.probability, 0.0)
    weight = probability / model.variance(echoes.ranges_in)
    return _sum_information(echoes.H.reshape(len(poses), -1, 3), weight.reshape(len(poses), -1))


def _sum_information(jacobian: Floats, weight: Floats) -> Floats:
    """Return the sum over k of w h' h, (n, 3, 3), of Jacobians h (n, k, 3) and weights w (n, k)."""
    total: Floats = (jacobian * weight[..., None]).swapaxes(-1, -2) @ jacobian
    return total
