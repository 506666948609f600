"""Where localization is weak: the posterior Cramer-Rao bound over the free space of a map.

    J     the Fisher information about (x, y, heading) of one round of all sixteen sonars from there, the mean over
          HEADINGS directions of the ring within its symmetry of 22.5 degrees
    P'    = ((F P F' + Q)^-1 + J)^-1     ROUNDS times from START_STD (Tichavsky, Muravchik, Nehorai 1998)
    F     the motion's derivative: on the way of a round an error of the heading becomes one of the place, aside
    Q     what the odometry loses on that way at `speed_in_s`

The bound is of a robot that drives straight on for a minute and a half, through a room that looks all the way as it
does from there: no filter without bias can know its place or its heading better, whichever of WAYS directions it
drives, and a good one comes near. Driving tells the heading, which ranges alone tell badly. What the ring cannot see,
such as the way along a corridor, grows with the way.

Rules: pure. Rays count where they meet a wall steeply enough and within range; cones by the chance of each echo.
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
WAYS: Final = 8
ROUNDS: Final = 100
ROUND_S: Final = 0.96
START_STD: Final = (24.0, 24.0, 0.5)
_HEADING_STD_RAD: Final = 0.01


class Observability(NamedTuple):
    """Of n places (n, 2) in inches: the bound `cov` (n, 3, 3) on the way on which the place is known best, and standard
    deviations `heading_rad` (n,) on that on which the heading is."""

    places: Floats
    cov: Floats
    heading_rad: Floats

    @property
    def worst_in(self) -> Floats:
        """Standard deviations (n,) of the position along its worst direction, inches."""
        return _worst_in(self.cov)


def compute_observability(known: LocalizationConfig, places: Floats, speed_in_s: float = 5.0) -> Observability:
    """The bound at places (n, 2), inches."""
    information = np.mean([_of_round(known, places, turned) for turned in _turns()], axis=0)
    ways = np.arange(WAYS) * (tau / WAYS)
    covs = np.stack([_driven(known.odometry, information, speed_in_s * ROUND_S, way_rad) for way_rad in ways])
    best = np.argmin(_worst_in(covs), axis=0)
    heading: Floats = np.sqrt(covs[..., HEADING, HEADING].min(axis=0))
    return Observability(places, covs[best, np.arange(len(places))], heading)


def _driven(odometry: OdometryNoise, information: Floats, way_in: float, way_rad: float) -> Floats:
    """P (n, 3, 3) after ROUNDS of `way_in` in a direction, each of which tells `information` (n, 3, 3)."""
    step = np.array([way_in, 0.0])
    F, G = step_jacobians(np.array([0.0, 0.0, way_rad]), step)
    lost = process_covariance(G, step, odometry)
    cov: Floats = np.tile(np.diag(np.square(START_STD)), (len(information), 1, 1))
    for _ in range(ROUNDS):
        known: Floats = np.asarray(np.linalg.inv(F @ cov @ F.T + lost), dtype=np.float64) + information
        cov = np.asarray(np.linalg.inv(known), dtype=np.float64)
        cov = 0.5 * (cov + cov.swapaxes(-1, -2))
    return cov


def _worst_in(covs: Floats) -> Floats:
    """Standard deviations (...) of the position along its worst direction, of covariances (..., 3, 3)."""
    worst: Floats = np.sqrt(np.linalg.eigvalsh(covs[..., :HEADING, :HEADING])[..., -1])
    return worst


def _turns() -> Floats:
    turns: Floats = np.arange(HEADINGS, dtype=np.float64) * (tau / SONARS / HEADINGS)
    return turns


def _of_round(known: LocalizationConfig, places: Floats, heading_rad: float) -> Floats:
    """J (n, 3, 3) of sixteen readings at these places and this heading."""
    poses = np.concatenate((places, np.full((len(places), 1), heading_rad)), axis=1)
    if isinstance(known.sonar, ConeSonar):
        return _of_cones(poses, known.body, known.sonar, reflectors(wall_map(known.walls).segments))
    return _of_rays(poses, known.body, known.sonar, wall_map(known.walls))


def _of_rays(poses: Floats, body: SonarRing, sonar: RaySonar, walls: WallMap) -> Floats:
    angles_rad = np.asarray(body.sonar_angles_rad, dtype=np.float64)
    beams = ranges_from(poses, angles_rad, body, walls)
    used = (beams.refusal == Refusal.NONE) & (beams.range_in > sonar.lowest_in) & (beams.range_in < sonar.highest_in)
    weight = np.where(used, 1.0 / sonar.variance(beams.range_in), 0.0)
    return _added(np.where(used[..., None], np.stack(beams.H, axis=-1), 0.0), weight)


def _of_cones(poses: Floats, body: SonarRing, model: ConeSonar, around: Reflectors) -> Floats:
    total = np.zeros((len(poses), 3, 3))
    spread: npt.NDArray[np.float64] = np.full(len(poses), _HEADING_STD_RAD)
    for angle in body.sonar_angles_rad:
        mount = SonarMount(angle, body.sonar_ring_radius_in)
        echoes = expected_echoes(poses, spread, mount, around, model)
        is_range = (echoes.ranges_in > model.lowest_in) & (echoes.ranges_in < model.highest_in)
        probability = (1.0 - model.outlier_probability) * np.where(is_range, echoes.probability, 0.0)
        total += _added(echoes.H, probability / model.variance(echoes.ranges_in))
    return total


def _added(slope: Floats, weight: Floats) -> Floats:
    """The sum over k of w h' h, (n, 3, 3), of slopes (n, k, 3) and weights (n, k)."""
    total: Floats = (slope * weight[..., None]).swapaxes(-1, -2) @ slope
    return total
