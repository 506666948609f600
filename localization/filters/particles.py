"""Monte Carlo localization: a belief as weighted particles, for what no Gaussian can represent.

    predict     every particle takes the step with noise of its own
    update      weights are multiplied by the likelihood of the reading, to the power of its new information
    resample    where the effective number of particles 1 / sum w^2 falls below RESAMPLE_THRESHOLD of them

References: Thrun, Burgard, Fox, Probabilistic Robotics (2005), tables 4.3, 4.4 and 8.2, and section 6.3 for the beam
model. Parameters have the names that users of other localizers know.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters import sonar_ray, update
from localization.filters.base import Filter
from localization.filters.belief import HEADING, POSE, Belief, Floats, difference, normal_density, wrap_angle
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import NO_LAG, Lag, OdometryNoise, add_lag, move, step_variance
from localization.filters.sonar_cone import ConeSonar, echo_probabilities, reflectors
from localization.filters.sonar_ray import RangeNoise, RaySonar, constant_variance, range_variance
from localization.filters.update import RANGE_PARAMETERS, UpdateResult, gate_code, result_of
from worlds.robots import Body

# The likelihood of one reading at many poses. It is widened by what the number of particles cannot resolve: a
# likelihood narrower than the distance between particles would leave a single one.


class Likelihoods(NamedTuple):
    """Likelihoods of a reading at n poses, per inch, and what was expected there.

    Attributes
    ----------
    total, outlier
        (n,) the likelihood, and the part of outliers in it.
    expected_in, variance_in2
        (n,) range of the echo that the reading most probably is, and its variance; NaN where the map has none.
    """

    total: Floats
    outlier: Floats
    expected_in: Floats
    variance_in2: Floats


class Likelihood(ABC):
    """Likelihood of readings of one type of sonar, on a map.

    Parameters
    ----------
    widen_std_in
        Standard deviation added to the sonar's.
    """

    def __init__(self, body: Body, noise: RangeNoise, widen_std_in: float) -> None:
        self._mounts, self._noise, self._widen_in2 = body.ring.mounts, noise, widen_std_in**2

    def is_range(self, reading_in: float) -> bool:
        """Return True if a reading is a range, not a limit."""
        return self._noise.lowest_in < reading_in < self._noise.highest_in

    def information(self, reading_in: float, count: int) -> float:
        """Return the new information of the `count`-th reading from one pose, as a fraction of the first's.

        The widening counts as an error that stays.
        """
        variance, constant = range_variance(self._noise, reading_in), constant_variance(self._noise, reading_in)
        return update.information_fraction(variance + self._widen_in2, constant + self._widen_in2, count)

    @abstractmethod
    def at(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Likelihoods:
        """Return the likelihoods of a reading at poses (n, 3); never 0."""


class RayLikelihood(Likelihood):
    """Beam model z_hit N(z; range, variance) + z_rand / span, along exact rays.

    Parameters
    ----------
    outlier_probability
        z_rand: fraction of readings spread over all ranges.
    """

    def __init__(self, walls: npt.ArrayLike, body: Body, sonar: RaySonar, *, outlier_probability: float = 0.05,
                 widen_std_in: float = 0.5) -> None:  # fmt: skip
        super().__init__(body, sonar, widen_std_in)
        self._walls, self._sonar, self._outlier_probability = sonar_ray.wall_map(walls), sonar, outlier_probability

    def at(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Likelihoods:
        """Return the likelihoods of a reading at poses (n, 3); never 0."""
        mount = update.mount_at(self._mounts, sonar, turret_offset_rad)
        aimed = mount._replace(direction_rad=np.array([mount.direction_rad]))
        range_in = sonar_ray.ranges_along(poses, aimed, self._walls).range_in[:, 0]
        has_wall = np.isfinite(range_in)
        expected = np.where(has_wall, range_in, 0.0)
        variance = self._sonar.variance(expected)
        hit = normal_density(reading_in - expected, variance + self._widen_in2)
        outlier = np.full(len(poses), self._outlier_probability / self._sonar.range_span_in)
        total = (1.0 - self._outlier_probability) * np.where(has_wall, hit, 0.0) + outlier
        return Likelihoods(total, outlier, np.where(has_wall, range_in, np.nan), variance)


class ConeLikelihood(Likelihood):
    """The same over all reflectors in the cone.

    Parameters
    ----------
    heading_std_rad
        Blur of the edge of the cone.
    """

    def __init__(self, walls: npt.ArrayLike, body: Body, sonar: ConeSonar, *, heading_std_rad: float = 0.03,
                 widen_std_in: float = 0.5) -> None:  # fmt: skip
        super().__init__(body, sonar, widen_std_in)
        self._around, self._sonar = reflectors(sonar_ray.wall_map(walls).segments), sonar
        self._heading_std = np.array(heading_std_rad)

    def at(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Likelihoods:
        """Return the likelihoods of a reading at poses (n, 3); never 0."""
        noise = self._sonar
        mount = update.mount_at(self._mounts, sonar, turret_offset_rad)
        ranges, probability = echo_probabilities(poses, self._heading_std, mount, self._around, noise)
        hits = normal_density(reading_in - ranges, noise.variance(ranges) + self._widen_in2)
        inlier = 1.0 - noise.outlier_probability
        outlier = noise.outlier_density * (1.0 - inlier * probability.sum(axis=-1))
        weighted = probability * hits
        if not weighted.shape[-1]:
            # No wall in reach: no particle expects an echo.
            expected = np.full(len(poses), np.nan)
            return Likelihoods(outlier.copy(), outlier, expected, expected)
        best = weighted.argmax(axis=-1)[:, None]
        expected = np.take_along_axis(ranges, best, axis=-1)[:, 0]
        expected = np.where(np.take_along_axis(weighted, best, axis=-1)[:, 0] > 0.0, expected, np.nan)
        return Likelihoods(inlier * weighted.sum(axis=-1) + outlier, outlier, expected, noise.variance(expected))


MAX_NIS: Final = 9.0
"""An innovation beyond three standard deviations is an outlier, and says nothing of the errors of all readings."""


# The filter.


PARTICLES: Final = 1000
"""Number of particles."""
RESAMPLE_THRESHOLD: Final = 0.5
"""Fraction of them to which the effective number may fall."""


class ParticleFilter(Filter):
    """Particle filter over poses, or states with odometry parameters.

    Parameters
    ----------
    states
        (N, n), the particles at the start, of equal weight.
    rng
        The only source of randomness.
    range_stds
        Prior standard deviations of the errors that all readings have in common (`LocalizationConfig`). A Kalman filter
        beside the particles estimates them from the innovations, and readings are corrected by it.
    middle_in
        Middle of the map, about which its scale may be wrong.
    """

    def __init__(self, states: Floats, likelihood: Likelihood, odometry: OdometryNoise, rng: np.random.Generator,
                 range_stds: Sequence[float] = (), middle_in: tuple[float, float] = (0.0, 0.0)) -> None:  # fmt: skip
        self.range_errors, self._errors_cov = np.zeros(RANGE_PARAMETERS), np.diag(np.square(range_stds or (0.0, 0.0)))
        """Offset and scale of all readings (`update.RANGE_PARAMETERS`), and their covariance."""
        self._middle_in = np.array(middle_in)
        self.states = states
        self.weights = np.full(len(states), 1.0 / len(states))
        self._likelihood, self._odometry, self._rng = likelihood, odometry, rng
        self._monitor, self._used = IntegrityMonitor(), update.new_used()

    @property
    def belief(self) -> Belief:
        """The Gaussian with the mean and covariance of the particles."""
        return moments(self.states, self.weights)

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate."""
        return self._monitor.health(self.belief.cov)

    @property
    def effective(self) -> float:
        """Effective number of particles, 1 / sum w^2."""
        return float(1.0 / (self.weights @ self.weights))

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Move each particle by the step that the encoders report, with noise of its own."""
        step = np.array((distance_in, turn_rad))
        noise = np.sqrt(step_variance(step, self._odometry)) * self._rng.standard_normal((len(self.states), 2))
        self.states = move(self.states, step + noise)
        update.move_on(self._used, distance_in, turn_rad)

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step without drawing: the step's variance is added to the Gaussian."""
        step = np.array((distance_in, turn_rad))
        after = moments(move(self.states, step), self.weights)
        q_distance, q_turn = step_variance(step, self._odometry)
        cov = after.cov.copy()
        ahead = np.array([np.cos(after.mean[HEADING]), np.sin(after.mean[HEADING])])
        cov[:2, :2] += q_distance * np.outer(ahead, ahead)
        cov[HEADING, HEADING] += q_turn
        # Readings do not tell colder air from a map that is too small: its poses are off by the scale.
        off = self.range_errors[1] * (after.mean[:2] - self._middle_in)
        cov[:2, :2] += np.outer(off, off)
        return add_lag(Belief(after.mean, cov), lag)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Weigh the particles by a reading; limits change nothing."""
        if not self._likelihood.is_range(reading_in):
            return UpdateResult(update.Refusal.LIMIT, 0.0, 0.0, 1.0)
        # 1. The information of a repeated reading.
        count = update.count_used(self._used, sonar, turret_offset_rad) + 1
        update.record_used(self._used, sonar, turret_offset_rad, count)
        power = self._likelihood.information(reading_in, count)
        # 2. Weights, the innovation before them, and the probability of an outlier.
        offset_in, scale = self.range_errors.tolist()
        range_in = (reading_in - offset_in) / (1.0 + scale)
        at = self._likelihood.at(self.states[:, :POSE], sonar, turret_offset_rad, range_in)
        innovation_in, nis = self._innovation(range_in, at, power)
        likelihood, outlier = at.total, at.outlier
        outlier_probability = float(self.weights @ outlier / (self.weights @ likelihood))
        self.weights = self.weights * likelihood**power
        self.weights /= self.weights.sum()
        # 3. Resampling.
        if self.effective < RESAMPLE_THRESHOLD * len(self.states):
            chosen = resample_low_variance(self.weights, float(self._rng.random()))
            self.states, self.weights = self.states[chosen], np.full(len(chosen), 1.0 / len(chosen))
        result = result_of((gate_code(outlier_probability), innovation_in, nis, outlier_probability, 1.0, 0.0))
        self._monitor.add(result)
        return result

    def _innovation(self, range_in: float, at: Likelihoods, power: float) -> tuple[float, float]:
        """Return innovation and NIS of a corrected reading, and correct the common errors by it."""
        innovation, nis = weighted_innovation(self.weights, range_in, at)
        if nis == 0.0:
            return innovation, nis
        # The variance of the innovation has that of the expected reading by the particles, and by the common errors.
        R = innovation * innovation / nis
        H = np.array((1.0, range_in))
        PHt = self._errors_cov @ H
        nis = innovation * innovation / float(H @ PHt + R)
        if nis < MAX_NIS and power > 0.0:
            K = PHt / (H @ PHt + R / power)
            self.range_errors += K * innovation
            self._errors_cov -= np.outer(K, PHt)
        return innovation, nis


def weighted_innovation(weights: Floats, reading_in: float, at: Likelihoods) -> tuple[float, float]:
    """Return innovation and NIS of a reading under weighted particles; 0 and 0 if none of them expects an echo.

    The expected reading is a mixture: its mean is that of the particles', and S the spread of theirs and the mean
    variance of a reading, without the widening of the likelihood.
    """
    has_echo = np.isfinite(at.expected_in)
    share = weights[has_echo]
    total = share.sum()
    if total <= 0.0:
        return 0.0, 0.0
    share, expected = share / total, at.expected_in[has_echo]
    mean = share @ expected
    S = share @ ((expected - mean) ** 2 + at.variance_in2[has_echo])
    innovation = reading_in - float(mean)
    return innovation, innovation * innovation / float(S)


def resample_low_variance(weights: Floats, start: float) -> np.typing.NDArray[np.intp]:
    """Return the indices (N,) of the resampled particles, from one draw `start` in [0, 1) for all.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 4.4.
    """
    count = len(weights)
    marks = (np.arange(count) + start) / count
    chosen: np.typing.NDArray[np.intp] = np.searchsorted(np.cumsum(weights), marks, side="right")
    return np.minimum(chosen, count - 1)


def moments(states: Floats, weights: Floats) -> Belief:
    """Return mean (n,) and covariance (n, n) of weighted states (N, n), the heading's mean by its direction."""
    mean: Floats = weights @ states
    heading = states[:, HEADING]
    mean[HEADING] = np.arctan2(weights @ np.sin(heading), weights @ np.cos(heading))
    residual = difference(states, mean[None, :])
    cov: Floats = (residual * weights[:, None]).T @ residual
    return Belief(mean, 0.5 * (cov + cov.T))


def draw_particles(belief: Belief, count: int, rng: np.random.Generator) -> Floats:
    """Return states (count, n) drawn from a Gaussian belief."""
    root = np.linalg.cholesky(belief.cov + 1e-12 * np.eye(len(belief.mean)))
    states: Floats = belief.mean + rng.standard_normal((count, len(belief.mean))) @ root.T
    states[:, HEADING] = wrap_angle(states[:, HEADING])
    return states
