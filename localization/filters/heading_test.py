"""Test whether recent readings of cones agree that the robot has another heading, and which.

A wall returns an echo from wherever in the cone the foot of the perpendicular lies. Its range hardly depends on the
heading, so in a turn on the spot the error of the heading grows with the noise of the wheels. Beyond half a cone,
readings are of other reflectors than those that are expected at the mean: they are outliers there, and correct nothing.
But the heading decides which reflectors are detected:

    E(d) = max over m of sum over k >= m of ln( p(z_k | d) / p(z_k | 0) )  -  d^2 / (2 P_hh)

    p(z | d)    density of a reading if the heading is off by d: the state is then x + K d, with K = P_h / P_hh and
                covariance P - K P_hh K^T, P_h the column of the heading, but for the width of a step of d
    m           the most likely instant from which the heading is off: a CUSUM over the last readings
    P_hh        variance of the heading: the second term is its prior

Something that the map does not have agrees with no heading, and what else was measured contradicts it.

Among walls with surfaces a reading is compared with the learned level of the spot that it comes from, and with any
level (`SurfaceModel.densities`). Their cones are so wide that a wrong heading shows only when the robot drives:
readings at its sides are then of other walls than expected. What it is worth is in docs/methods.md.

References
----------
Basseville, Nikiforov, Detection of Abrupt Changes (1993), sections 2.4 and 7.2: the generalized likelihood ratio.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import ceil, hypot, pi, sqrt
from typing import Final, NamedTuple

import numpy as np

from localization.filters.base import EncoderRow, NewEcho
from localization.filters.belief import HEADING, POSE, Floats, normal_density, unit_vector, wrap_angle
from localization.filters.odometry import pose_at
from localization.filters.sonar_cone import ConeModel, arm_of, expected_echoes
from localization.filters.surface import SurfaceModel
from localization.filters.update import SAME_POSE_IN, SAME_POSE_RAD, expected_reading, kalman_gain
from worlds.rings import SonarMount

READINGS: Final = 24
"""Readings that are compared: a round of the ring and a half."""
MIN_READINGS: Final = 8
"""From one comparison to the next there are so many new readings: half a round."""
MIN_OUTLIERS: Final = 0.3
"""Recent fraction of outliers from which headings are compared among planes: three times that of a Polaroid ring."""
STEP_RAD: Final = 0.05
"""Headings are compared in steps of a ninth of a cone of 26 degrees, and the cones blurred by as much."""
MAX_SIGMAS: Final = 5.0
"""They are at most so many standard deviations off."""


Encoders = tuple[float, float, float, float]
"""x, y, heading and turret by the encoders."""


class FiredAt(NamedTuple):
    """A range, the sonar that measured it, and where the encoders were."""

    encoders: Encoders
    sonar: int
    reading_in: float


class HeadingTest:
    """The test on the last readings of a filter.

    Parameters
    ----------
    model
        The measurement model.
    surfaces
        The same with the surfaces of walls, where they have some.
    """

    def __init__(self, model: ConeModel, surfaces: SurfaceModel | None = None) -> None:
        self._model, self._surfaces = model, surfaces
        self._rings: deque[tuple[Sequence[EncoderRow], Sequence[NewEcho]]] = deque(maxlen=READINGS)
        self._wait = 0

    def add(self, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho]) -> None:
        """Take note of echoes, and of the polled encoders from the last before the first of them."""
        self._rings.append((poses, echoes))
        self._wait -= len(echoes)

    def correction(self, x: Sequence[float] | Floats, P: Sequence[Sequence[float]] | Floats) -> tuple[float, float]:
        """Return how far the heading is off, radians, and the evidence of that in nats: (0, 0) without any.

        It is the mean of all headings, weighed by exp(E). Without MIN_READINGS new readings there is no evidence.
        """
        if self._wait > 0:
            return 0.0, 0.0
        readings = self._recent()
        if len(readings) < MIN_READINGS:
            return 0.0, 0.0
        poses, echoes = self._rings[-1]
        encoders = pose_at(poses, echoes[-1][0])
        self._wait = MIN_READINGS
        variance = P[HEADING][HEADING]
        steps = ceil(min(MAX_SIGMAS * sqrt(variance), pi) / STEP_RAD)
        turns = np.arange(-steps, steps + 1, dtype=np.float64) * STEP_RAD
        # 1. Log likelihood ratio of each reading to that at the mean, (k, d).
        logs = np.log(likelihoods(np.array(x), np.array(P), turns, encoders, readings, self._model, self._surfaces))
        ratios = logs - logs[:, steps, None]
        # 2. E(d): the sum since the most likely instant, and the prior.
        evidence = np.maximum(ratios[::-1].cumsum(axis=0).max(axis=0), 0.0) - 0.5 * turns**2 / variance
        weights = np.exp(evidence - evidence.max())
        return float(weights @ turns / weights.sum()), float(evidence.max())

    def reset(self) -> None:
        """Begin anew, after a correction."""
        self._rings.clear()
        self._wait = 0

    def _recent(self) -> list[FiredAt]:
        """Return the last READINGS ranges, in order of time.

        With surfaces, of several ranges from one place along one axis only the last is used: a robot whose base turns
        below its turret measures a thing that is not on the map again and again, each time at the same place.
        """
        noise = self._model.noise
        readings: list[FiredAt] = []
        for poses, echoes in reversed(self._rings):
            for instant_s, sonar, reading_in in reversed(echoes):
                if noise.lowest_in < reading_in < noise.highest_in:
                    reading = FiredAt(pose_at(poses, instant_s), int(sonar), reading_in)
                    if self._surfaces is None or not any(self._repeats(reading, later) for later in readings):
                        readings.append(reading)
            if len(readings) >= READINGS:
                break
        return readings[READINGS - 1 :: -1]

    def _repeats(self, one: FiredAt, other: FiredAt) -> bool:
        """Return True for readings from one place along one axis, by the encoders, whichever the sonars.

        `update.count_along_axis` compares only readings that the filter has used, of one sonar.
        """
        (x, y, _, turret), (other_x, other_y, _, other_turret) = one.encoders, other.encoders
        turned_rad = turret + self._model.mounts[one.sonar][0] - other_turret - self._model.mounts[other.sonar][0]
        is_here = hypot(x - other_x, y - other_y) <= SAME_POSE_IN
        return is_here and bool(abs(wrap_angle(turned_rad)) <= SAME_POSE_RAD)


def likelihoods(x: Floats, P: Floats, turns: Floats, encoders: Encoders, readings: Sequence[FiredAt],
                model: ConeModel, surfaces: SurfaceModel | None = None) -> Floats:
    """Return the density (k, d) per inch of each of k readings, if the heading is off by each of `turns` (d,).

    It is that of `update.association_probabilities`, in arrays.

    Parameters
    ----------
    x, P
        The belief (n,) and (n, n).
    encoders
        Where the encoders are, at the belief.
    surfaces
        The model of the walls' surfaces, where they have some.
    """
    # 1. x + K d and P - K P_hh K^T, the heading uncertain by a step.
    variance = P[HEADING, HEADING]
    cell = min(STEP_RAD**2, variance)
    K = P[:, HEADING] / variance
    states = x + turns[:, None] * K
    P = P - (variance - cell) * np.outer(K, K)
    # 2. The poses (k, d, 3) at which the sonars fired, by the encoders, with the directions of their axes.
    poses = np.stack([_axis_at(states, encoders, reading, model) for reading in readings])
    ring_in, left_in = np.array([model.mounts[reading.sonar][1:] for reading in readings]).T[:, :, None, None]
    # 3. The reflectors that are detected from there, the reading expected of each, and its variance.
    noise = model.noise
    travel_in = np.abs(poses[..., :2] - x[:2]).max() + ring_in.max() + np.abs(left_in).max()
    around = model.around.within(x[0], x[1], noise.highest_in + 2.0 * travel_in)
    echoes = expected_echoes(poses, np.array(sqrt(cell)), SonarMount(0.0, ring_in, left_in), around, noise)
    probability = np.where(echoes.ranges_in < noise.highest_in, echoes.probability, 0.0)
    which = np.asarray(probability.any(axis=(0, 1)), dtype=np.bool_)
    ranges, probability = echoes.ranges_in[..., which], probability[..., which]
    columns, H = [part[:, None] for part in states.T], list(np.moveaxis(echoes.H[..., which, :], -1, 0))
    expected, H = expected_reading(columns, ranges, H, model.range_parameters)
    _, S = kalman_gain(P.tolist(), H, noise.variance(ranges))
    # 4. Each reflector by its probability, or an outlier.
    innovation = np.array([reading.reading_in for reading in readings])[:, None, None] - expected
    if surfaces is None:
        density = normal_density(innovation, S)
    else:
        axis_x, axis_y = np.cos(poses[..., HEADING]), np.sin(poses[..., HEADING])
        arm_x, arm_y = arm_of(SonarMount(0.0, ring_in[..., 0], left_in[..., 0]), axis_x, axis_y)
        walls, vertices = np.split(which, [len(around.walls)])
        seen = around.some(walls, vertices)
        density = surfaces.densities(innovation, S, seen, poses[..., 0] + arm_x, poses[..., 1] + arm_y)
    inlier = 1.0 - noise.outlier_probability
    outlier = noise.outlier_density * (1.0 - inlier * probability.sum(axis=-1))
    return np.asarray(inlier * (probability * density).sum(axis=-1) + outlier, dtype=np.float64)


def _axis_at(states: Floats, encoders: Encoders, then: FiredAt, model: ConeModel) -> Floats:
    """Return the poses (d, 3) at an earlier reading, their headings those of the axis of its sonar.

    The step back, of the encoders, is turned with the heading of each state (d, n).
    """
    x, y, heading, _ = encoders
    to_x, to_y, _, turret = then.encoders
    c, s = unit_vector(heading)
    ahead, left = c * (to_x - x) + s * (to_y - y), c * (to_y - y) - s * (to_x - x)
    poses = states[:, :POSE].copy()
    cos_now, sin_now = np.cos(states[:, HEADING]), np.sin(states[:, HEADING])
    poses[:, 0] += ahead * cos_now - left * sin_now
    poses[:, 1] += ahead * sin_now + left * cos_now
    poses[:, HEADING] += turret - heading + model.mounts[then.sonar][0]
    return poses
