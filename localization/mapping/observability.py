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

from math import tau
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.base import LocalizationConfig
from localization.filters.belief import HEADING, Floats
from localization.filters.odometry import OdometryNoise, process_covariance, step_jacobians
from localization.filters.reflectors import Reflectors, reflectors
from localization.filters.sonar_cone import ConeSonar, SonarMount, expected_echoes
from localization.filters.sonar_ray import RaySonar, SonarRing, WallMap, ranges_from, wall_map
from localization.filters.update import Refusal
from worlds.robots import SONARS

HEADINGS: Final = 4
"""Directions of the ring within its symmetry of 22.5 degrees."""
DIRECTIONS: Final = 8
CYCLES: Final = 100
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
    information = np.mean([_cycle_information(config, positions, heading) for heading in _headings()], axis=0)
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
    Q = process_covariance(G, step, odometry)
    P: Floats = np.tile(np.diag(np.square(START_STD)), (len(information), 1, 1))
    for _ in range(CYCLES):
        # Predict, add the information of one cycle, and keep the matrix symmetric.
        total: Floats = np.asarray(np.linalg.inv(F @ P @ F.T + Q), dtype=np.float64) + information
        P = np.asarray(np.linalg.inv(total), dtype=np.float64)
        P = 0.5 * (P + P.swapaxes(-1, -2))
    return P


def _worst_in(covs: Floats) -> Floats:
    """Return standard deviations (...) of the position along its worst direction, of covariances (..., 3, 3)."""
    worst: Floats = np.sqrt(np.linalg.eigvalsh(covs[..., :HEADING, :HEADING])[..., -1])
    return worst


def _headings() -> Floats:
    headings: Floats = np.arange(HEADINGS, dtype=np.float64) * (tau / SONARS / HEADINGS)
    return headings


def _cycle_information(config: LocalizationConfig, positions: Floats, heading_rad: float) -> Floats:
    """Return J (n, 3, 3) of sixteen readings at positions (n, 2) and one heading."""
    poses = np.concatenate((positions, np.full((len(positions), 1), heading_rad)), axis=1)
    if isinstance(config.sonar, ConeSonar):
        return _cone_information(poses, config.body, config.sonar, reflectors(wall_map(config.walls).segments))
    return _ray_information(poses, config.body, config.sonar, wall_map(config.walls))


def _ray_information(poses: Floats, body: SonarRing, sonar: RaySonar, walls: WallMap) -> Floats:
    # Readings of valid beams, weighted by their inverse variance.
    angles_rad = np.asarray(body.sonar_angles_rad, dtype=np.float64)
    beams = ranges_from(poses, angles_rad, body, walls)
    used = (beams.refusal == Refusal.NONE) & (beams.range_in > sonar.lowest_in) & (beams.range_in < sonar.highest_in)
    weight = np.where(used, 1.0 / sonar.variance(beams.range_in), 0.0)
    return _sum_information(np.where(used[..., None], np.stack(beams.H, axis=-1), 0.0), weight)


def _cone_information(poses: Floats, body: SonarRing, model: ConeSonar, around: Reflectors) -> Floats:
    total = np.zeros((len(poses), 3, 3))
    spread: npt.NDArray[np.float64] = np.full(len(poses), _HEADING_STD_RAD)
    for angle in body.sonar_angles_rad:
        mount = SonarMount(angle, body.sonar_ring_radius_in)
        echoes = expected_echoes(poses, spread, mount, around, model)
        is_range = (echoes.ranges_in > model.lowest_in) & (echoes.ranges_in < model.highest_in)
        # Each echo counts with its probability.
        probability = (1.0 - model.outlier_probability) * np.where(is_range, echoes.probability, 0.0)
        total += _sum_information(echoes.H, probability / model.variance(echoes.ranges_in))
    return total


def _sum_information(jacobian: Floats, weight: Floats) -> Floats:
    """Return the sum over k of w h' h, (n, 3, 3), of Jacobians h (n, k, 3) and weights w (n, k)."""
    total: Floats = (jacobian * weight[..., None]).swapaxes(-1, -2) @ jacobian
    return total
