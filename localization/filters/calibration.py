"""A filter that estimates the systematic errors of wheels and sonars while it localizes: one long state.

    0..5     pose, distance_scale, turn_scale, drift                 (odometry)
    6        range offset of all sonars: readings less ranges, inches
    7        ring turn: angle of the ring against the turret, radians
    8...     own offset of each sonar of the ring, inches

A range grows by the offsets one for one, and by the turn of the ring as by the heading: only the direction of the ring
changes, not that in which the robot then drives. So driving separates the ring's turn from the heading, turning the
ring one sonar's offset from another's, and walls on both sides the common offset from the position. Ranges of a real
ring hardly depend on the angle: which walls its sonars detect at all shows its turn (`ConeAim`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import exp, pi, radians, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters import update
from localization.filters.base import Filter, LocalizationConfig, measurement_model
from localization.filters.belief import (
    HEADING,
    POSE,
    Belief,
    Floats,
    add_outer,
    chi_square_quantile,
    pack,
    unpack,
    wrap_angle,
)
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import MAX_STATE, NO_LAG, Lag, predict_state, widen_by_lag
from localization.filters.sonar_cone import ConeModel, ConeSonar, EchoCandidate, first_echoes
from localization.filters.sonar_ray import range_variance
from localization.filters.update import Refusal, UpdateResult
from worlds.robots import SONARS, Body

OFFSET: Final = MAX_STATE
RING_TURN: Final = OFFSET + 1
OWN: Final = RING_TURN + 1
SIZE: Final = OWN + SONARS
"""Length of the state of a Nomad."""


def parameter_stds(sonars: int) -> tuple[float, ...]:
    """Return prior standard deviations for a ring: wheels 5 % off, 3 mrad an inch, sonars 2 in, the ring 5 degrees."""
    return (0.05, 0.05, 0.003, 2.0, radians(5.0), *(0.5,) * sonars)


PARAMETER_STDS: Final = parameter_stds(SONARS)
"""Those of a Nomad."""
GATE_PROBABILITY: Final = 0.999
_LOOSE_IN2: Final = 16.0
"""Added to the variance of rays for the model's own gate, which knows the pose only."""
_INSIDE_IN: Final = 1e-3
"""A corrected reading stays this much within the limits."""

# 1. The direction of a sonar, by what it detects at all.

EDGE_STD_RAD: Final = radians(0.5)
"""Blur of the edge of a cone."""
NODES: Final = np.arange(-3.0, 3.01, 0.5)
"""Offsets at which the posterior is evaluated, in standard deviations."""
_WEIGHTS: Final = np.exp(-0.5 * NODES * NODES) / np.exp(-0.5 * NODES * NODES).sum()
_VARIANCE: Final = float(_WEIGHTS @ (NODES * NODES))
_SPACING: Final = 0.5
_ENDS_FIRST: Final = [6, 0, 12, *(at for at in range(1, 12) if at != 6)]
"""Order of evaluation: the middle, both ends, the rest."""
NARROW_RAD: Final = radians(1.0)
"""With an axis known this well nothing lies between both ends only: a cone is wider."""
SIMILAR: Final = 0.01
"""Likelihoods that differ by this fraction of the largest say nothing."""


class AimReading(NamedTuple):
    """A reading, and the belief about the direction of its sonar.

    Attributes
    ----------
    pose, sonar, offset_rad
        Pose of the robot, number of the sonar, angle of the ring against the heading.
    std_rad
        Standard deviation of heading and ring together.
    reading_in
        Less the sonar's own offset; at or above the highest: nothing was detected.
    variance_in2
        Variance of the range by all but the noise of the reading.
    """

    pose: tuple[float, float, float]
    sonar: int
    offset_rad: float
    std_rad: float
    reading_in: float
    variance_in2: float


class ConeAim:
    """Estimate the direction of a cone's axis from which walls it detects.

    A smooth wall is detected over as many degrees as the cone is wide, about its normal, and the range hardly depends
    on the angle within them. For a normal prior N(0, s^2) of the axis the posterior

        posterior(offset) ~ N(offset; 0, s^2) p(reading | offset)

    is evaluated at NODES and replaced by its mean and variance (assumed density filtering).
    """

    def __init__(self, walls: npt.ArrayLike, body: Body, sonar: ConeSonar) -> None:
        self._model = ConeModel(walls, body, sonar)

    def posterior(self, reading: AimReading) -> tuple[float, float]:
        """Return the mean offset of the axis, radians, and its variance as a fraction of the prior one."""
        blur_rad = max(EDGE_STD_RAD, _SPACING * reading.std_rad)
        mount = update.mount_at(self._model.mounts, reading.sonar, reading.offset_rad)
        likelihood = np.empty(len(NODES))
        densities: dict[int, float] = {}
        for count, at in enumerate(_ENDS_FIRST):
            offset_rad = float(NODES[at]) * reading.std_rad
            aimed = mount._replace(direction_rad=mount.direction_rad + offset_rad)
            candidates = first_echoes(*reading.pose, blur_rad, aimed, self._model)
            likelihood[at] = _likelihood(candidates, densities, self._model.noise, reading)
            if count == 2 and reading.std_rad < NARROW_RAD and _is_flat(likelihood[_ENDS_FIRST[:3]]):
                return 0.0, 1.0
        posterior = _WEIGHTS * likelihood
        posterior /= posterior.sum()
        mean = float(posterior @ NODES)
        return mean * reading.std_rad, float(posterior @ np.square(NODES - mean)) / _VARIANCE


def _is_flat(likelihood: Floats) -> bool:
    """Return True if the likelihoods say nothing."""
    return float(likelihood.max() - likelihood.min()) <= SIMILAR * float(likelihood.max())


def _likelihood(candidates: list[EchoCandidate], densities: dict[int, float], sonar: ConeSonar,
                reading: AimReading) -> float:
    """Return p(reading | candidates). `densities` caches those by reflector, which hold for all offsets."""
    inlier = 1.0 - sonar.outlier_probability
    if reading.reading_in >= sonar.highest_in:
        return 1.0 - inlier * sum([candidate.probability for candidate in candidates])
    total, detected = 0.0, 0.0
    for candidate in candidates:
        density = densities.get(candidate.reflector)
        if density is None:
            S = reading.variance_in2 + range_variance(sonar, candidate.range_in)
            innovation = reading.reading_in - candidate.range_in
            densities[candidate.reflector] = density = exp(-0.5 * innovation * innovation / S) / sqrt(2.0 * pi * S)
        total += candidate.probability * density
        detected += candidate.probability
    return inlier * total + sonar.outlier_density * (1.0 - inlier * detected)


# 2. The filter.


class CalibratingFilter(Filter):
    """Extended Kalman filter over the long state; see the head of this file.

    Parameters
    ----------
    start
        Belief over states (n,), 3 <= n <= 6: the pose, and odometry parameters with standard deviations of their own.
    stds
        Prior standard deviations of all parameters. Default: `parameter_stds` of the ring.
    """

    def __init__(self, config: LocalizationConfig, start: Belief, stds: tuple[float, ...] = ()) -> None:
        size = len(start.mean)
        stds = stds or parameter_stds(config.body.ring.count)
        prior = Belief(np.zeros(POSE + len(stds)), np.diag(np.append(np.zeros(POSE), stds) ** 2))
        prior.mean[:size] = start.mean
        prior.cov[:size, :size] = start.cov
        self._x, self._P = unpack(prior)
        self._odometry, self._sonar = config.odometry, config.sonar
        sonar, self._aim = config.sonar, None
        if isinstance(sonar, ConeSonar):
            self._aim = ConeAim(config.walls, config.body, sonar)
        else:
            # The gate of the model leaves room for the offsets; the filter gates afterwards.
            sonar = replace(sonar, rounding_var_in2=sonar.rounding_var_in2 + _LOOSE_IN2)
        self._model = measurement_model(config.walls, config.body, sonar, config.gate)
        self._monitor = IntegrityMonitor()
        self._threshold = chi_square_quantile(GATE_PROBABILITY, 1)

    @property
    def belief(self) -> Belief:
        """Belief over the long state, as long as the ring requires."""
        return pack(self._x, self._P)

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate."""
        return self._monitor.health(self._P)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report."""
        predict_state(self._x, self._P, distance_in, turn_rad, self._odometry, SIZE - MAX_STATE)

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by a lag."""
        x, P = self._x.copy(), [row.copy() for row in self._P]
        predict_state(x, P, distance_in, turn_rad, self._odometry, SIZE - MAX_STATE)
        widen_by_lag(x, P, lag)
        return pack(x, P)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading."""
        result = self._update(sonar, turret_offset_rad, reading_in)
        if result.refusal in update.INFORMATIVE:
            self._monitor.add(result)
        return result

    def _update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        lowest_in, highest_in = self._sonar.lowest_in, self._sonar.highest_in
        # 1. The direction of the sonar, by what it detects.
        if reading_in > lowest_in:
            self._correct_aim(sonar, turret_offset_rad, reading_in)
        if not lowest_in < reading_in < highest_in:
            return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)
        # 2. The reading less the offsets, and its hypotheses from where the ring looks.
        x, P = self._x, self._P
        offset_in = x[OFFSET] + x[OWN + sonar]
        range_in = min(max(reading_in - offset_in, lowest_in + _INSIDE_IN), highest_in - _INSIDE_IN)
        found = self._model.associate(x[:POSE], self._pose_cov(), sonar, turret_offset_rad + x[RING_TURN], range_in)
        if found.refusal is not Refusal.NONE:
            return UpdateResult(found.refusal, 0.0, 0.0, 1.0)
        # 3. Their derivatives by the long state.
        association = found._replace(H=[_long_derivative(H, sonar, len(x)) for H in found.H],
                                     R=[range_variance(self._sonar, expected_in) for expected_in in found.ranges_in])
        # 4. The gate of rays, which have no outliers, and the update.
        if not association.outlier_probability:
            (first,) = update.linear(x, P, range_in, association, association.R)
            if first.nis > self._threshold:
                return UpdateResult(Refusal.GATE, first.innovation, first.nis, 1.0)
        return update.result_of(update.update_by_association(x, P, range_in, association, update.linear, 1))

    def _correct_aim(self, sonar: int, turret_offset_rad: float, reading_in: float) -> None:
        """Correct heading and ring turn together by what the sonar detects."""
        x, P = self._x, self._P
        # The direction is x[HEADING] + x[RING_TURN]: its covariance with the state, and its variance.
        PHt = [row[HEADING] + row[RING_TURN] for row in P]
        variance = PHt[HEADING] + PHt[RING_TURN]
        if self._aim is None or variance <= 0.0:
            return
        own = OWN + sonar
        is_limit = reading_in >= self._sonar.highest_in
        corrected_in = reading_in if is_limit else reading_in - x[OFFSET] - x[own]
        variance_in2 = P[0][0] + P[1][1] + P[OFFSET][OFFSET] + 2.0 * P[OFFSET][own] + P[own][own]
        ring_rad = turret_offset_rad + x[RING_TURN]
        reading = AimReading((x[0], x[1], x[HEADING]), sonar, ring_rad, sqrt(variance), corrected_in, variance_in2)
        offset_rad, fraction = self._aim.posterior(reading)
        K = [value / variance for value in PHt]
        for i, gain in enumerate(K):
            x[i] += gain * offset_rad
        x[HEADING] = wrap_angle(x[HEADING])
        add_outer(P, -variance * (1.0 - fraction), K)

    def _pose_cov(self) -> list[list[float]]:
        """Return the covariance of the pose with the direction of the ring in place of the heading."""
        P = self._P
        cov = [row[:POSE] for row in P[:POSE]]
        cov[HEADING][HEADING] += P[RING_TURN][RING_TURN] + 2.0 * P[HEADING][RING_TURN]
        for index in range(HEADING):
            cov[index][HEADING] += P[index][RING_TURN]
            cov[HEADING][index] += P[index][RING_TURN]
        return cov


def _long_derivative(H: Sequence[float], sonar: int, size: int) -> list[float]:
    """Return a derivative by the pose as one by the long state of this size."""
    by_x, by_y, by_heading = H
    derivative = [0.0] * size
    derivative[:POSE] = by_x, by_y, by_heading
    derivative[RING_TURN] = by_heading
    derivative[OFFSET] = derivative[OWN + sonar] = 1.0
    return derivative
