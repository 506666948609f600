"""How well many poses explain one reading: what Monte Carlo localization weighs its particles with.

    RayLikelihood     z_hit N(z; ray, sigma) + z_rand / range        the beam model (Thrun, Burgard, Fox 2005, 6.3)
    ConeLikelihood    the same over all reflectors in the cone       the densities of mixture

Rules: pure arrays; a pose a row, a likelihood a row, never 0; no particle is changed here. Widened by what the number
of particles cannot resolve: a likelihood sharper than the distance between particles kills all but one, and so would
many from one place. What it is widened by counts as an error that stays (repeats).

Monte Carlo localization: a belief as weighted particles. For what no gaussian can hold, and as another opinion.

    move    every particle takes the step with its own noise         (sampled from motion's random walk)
    hear    weights are multiplied with the reading's likelihood      (likelihood), to the power of what it adds to
            those that came from the same place                       (repeats)
    watch   the share of a reading's likelihood, over all of them, that is of bad readings: whether it is explained
    then    where the effective number 1 / sum w^2 falls below `resample_threshold` of them: low-variance resampling

Probabilistic Robotics (Thrun, Burgard, Fox 2005), tables 4.4 and 8.2, its parameters by the names that users of other
localizers know.

Rules: all chance comes from the generator handed in; particles are states (N, n), as long as the first belief's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Belief, Floats, difference, wrap_angle
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import POSE, OdometryNoise, move_states, step_variance
from localization.filters.reflectors import reflectors
from localization.filters.sonar_cone import ConeSonar, SonarMount, cone_chances
from localization.filters.sonar_ray import RangeNoise, RaySonar, SonarRing, pick, rays, ring, wall_map
from localization.filters.update import CorrelatedReadings, Refusal, UpdateResult, information_fraction, refusal_of
from worlds.raycast import cast_rays

SPAN_IN: Final = 249.0
"""Bad readings of a ray lie anywhere from 6 to 255 inches."""


class Weighed(NamedTuple):
    """Likelihoods of a reading at n poses, per inch: of whatever it may be (n,), and of them the part of bad readings
    (n,)."""

    whole: Floats
    bad: Floats


class Likelihood(Protocol):
    """A kind of sonar, in a map, on a body."""

    def is_range(self, reading_in: float) -> bool:
        """Whether a reading tells a range at all."""
        ...

    def news(self, reading_in: float, times: int) -> float:
        """What the `times`-th of such readings from one place adds, as a share of the first (repeats)."""
        ...

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        """Of a reading at poses (n, 3)."""
        ...


def _news(noise: RangeNoise, widened_in2: float, reading_in: float, times: int) -> float:
    variance, constant = np.array((noise.variance_at(reading_in), noise.constant_at(reading_in))) + widened_in2
    return float(information_fraction(variance, constant, times))


class RayLikelihood:
    """One exact ray a sonar; `bad_share` of the readings spread over all ranges; `widen_std_in` beside the sonar's."""

    def __init__(
        self,
        walls: npt.ArrayLike,
        body: SonarRing,
        sonar: RaySonar,
        *,
        outlier_probability: float = 0.05,
        widen_std_in: float = 0.5,
    ) -> None:
        self._walls, self._body, self._sonar = wall_map(walls), body, sonar
        self._bad_share, self._widen = outlier_probability, widen_std_in**2

    def is_range(self, reading_in: float) -> bool:
        return self._sonar.lowest_in < reading_in < self._sonar.highest_in

    def news(self, reading_in: float, times: int) -> float:
        return _news(self._sonar, self._widen, reading_in, times)

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        beam = pick(ring(self._body, turret_offset_rad), sonar)
        aimed = rays(poses[:, None, :], beam)
        from_axis = cast_rays(aimed.axes_in, aimed.directions, self._walls.segments)[0][:, 0]
        seen = np.isfinite(from_axis)
        expected = np.where(seen, from_axis, 0.0) - beam.standoff_in
        variance = self._sonar.variance(expected) + self._widen
        hit = np.exp(-0.5 * (reading_in - expected) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        bad = np.full(len(poses), self._bad_share / SPAN_IN)
        return Weighed((1.0 - self._bad_share) * np.where(seen, hit, 0.0) + bad, bad)


class ConeLikelihood:
    """All reflectors in the cone; `heading_std_rad` makes its rim soft, `widen_std_in` its ranges."""

    def __init__(
        self,
        walls: npt.ArrayLike,
        body: SonarRing,
        model: ConeSonar,
        *,
        heading_std_rad: float = 0.03,
        widen_std_in: float = 0.5,
    ) -> None:
        self._around, self._body, self._model = reflectors(wall_map(walls).segments), body, model
        self._heading_std, self._widen = np.array(heading_std_rad), widen_std_in**2

    def is_range(self, reading_in: float) -> bool:
        return self._model.lowest_in < reading_in < self._model.highest_in

    def news(self, reading_in: float, times: int) -> float:
        return _news(self._model, self._widen, reading_in, times)

    def of(self, poses: Floats, sonar: int, turret_offset_rad: float, reading_in: float) -> Weighed:
        model = self._model
        ear = SonarMount(turret_offset_rad + self._body.sonar_angles_rad[sonar], self._body.sonar_ring_radius_in)
        ranges, probability = cone_chances(poses, self._heading_std, ear, self._around, model)
        variance = model.variance(ranges) + self._widen
        hits = np.exp(-0.5 * (reading_in - ranges) ** 2 / variance) / np.sqrt(2.0 * np.pi * variance)
        good = 1.0 - model.outlier_probability
        bad = model.bad_density * (1.0 - good * probability.sum(axis=-1))
        return Weighed(good * (probability * hits).sum(axis=-1) + bad, bad)


@dataclass(frozen=True, slots=True)
class MonteCarlo:
    """Parameters of a particle filter, with the usual names.

    particles              how many
    resample_threshold     the share of them that the effective number may fall to
    """

    particles: int = 1000
    resample_threshold: float = 0.5


class ParticleFilter:
    """See the head of this file. `states` (N, n) and `weights` (N,), which sum to 1."""

    def __init__(
        self,
        states: Floats,
        likelihood: Likelihood,
        odometry: OdometryNoise,
        chance: np.random.Generator,
        parameters: MonteCarlo | None = None,
    ) -> None:
        self.states = states
        self.weights = np.full(len(states), 1.0 / len(states))
        self._likelihood, self._odometry, self._chance = likelihood, odometry, chance
        self._parameters = parameters or MonteCarlo(len(states))
        self._watch, self._repeats = IntegrityMonitor(), CorrelatedReadings()

    @property
    def belief(self) -> Belief:
        """The gaussian of the particles' first two moments."""
        return moments(self.states, self.weights)

    @property
    def health(self) -> FilterHealth:
        return self._watch.health(self.belief)

    @property
    def effective(self) -> float:
        """1 / sum w^2: how many particles of equal weight would say as much."""
        return float(1.0 / (self.weights @ self.weights))

    def move(self, step: Floats) -> None:
        """Each particle takes the step that the encoders tell, with its own noise."""
        noise = np.sqrt(step_variance(step, self._odometry)) * self._chance.standard_normal((len(self.states), 2))
        self.states = move_states(self.states, step + noise)
        self._repeats.move(step)

    def ahead(self, step: Floats) -> Belief:
        """Without chance: the particles moved as told, and the step's own variance to the gaussian."""
        told = moments(move_states(self.states, step), self.weights)
        along, turn = step_variance(step, self._odometry)
        cov = told.cov.copy()
        way = np.array([np.cos(told.mean[HEADING]), np.sin(told.mean[HEADING])])
        cov[:2, :2] += along * np.outer(way, way)
        cov[HEADING, HEADING] += turn
        return Belief(told.mean, cov)

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Weigh the particles with a reading; limits say nothing."""
        if not self._likelihood.is_range(reading_in):
            return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)
        times = self._repeats.before(sonar, turret_offset_rad) + 1
        self._repeats.take(sonar, turret_offset_rad)
        likelihood, bad = self._likelihood.of(self.states[:, :POSE], sonar, turret_offset_rad, reading_in)
        outlier_probability = float(self.weights @ bad / (self.weights @ likelihood))
        self.weights = self.weights * likelihood ** self._likelihood.news(reading_in, times)
        self.weights /= self.weights.sum()
        if self.effective < self._parameters.resample_threshold * len(self.states):
            self._resample()
        judgement = UpdateResult(refusal_of(outlier_probability), 0.0, 0.0, outlier_probability)
        self._watch.look(judgement)
        return judgement

    def _resample(self) -> None:
        chosen = low_variance(self.weights, float(self._chance.random()))
        self.states = self.states[chosen]
        self.weights = np.full(len(chosen), 1.0 / len(chosen))


def low_variance(weights: Floats, start: float) -> np.typing.NDArray[np.intp]:
    """Which particles live on (N,): systematic resampling, one draw `start` in [0, 1) for all (table 4.4)."""
    count = len(weights)
    marks = (np.arange(count) + start) / count
    chosen: np.typing.NDArray[np.intp] = np.searchsorted(np.cumsum(weights), marks, side="right")
    return np.minimum(chosen, count - 1)


def moments(states: Floats, weights: Floats) -> Belief:
    """Mean (n,) and covariance (n, n) of weighted states (N, n), the heading's mean by its direction."""
    mean: Floats = weights @ states
    heading = states[:, HEADING]
    mean[HEADING] = np.arctan2(weights @ np.sin(heading), weights @ np.cos(heading))
    off = difference(states, mean[None, :])
    cov: Floats = (off * weights[:, None]).T @ off
    return Belief(mean, 0.5 * (cov + cov.T))


def drawn_from(belief: Belief, count: int, chance: np.random.Generator) -> Floats:
    """States (count, n) drawn from a gaussian belief."""
    root = np.linalg.cholesky(belief.cov + 1e-12 * np.eye(len(belief.mean)))
    states: Floats = belief.mean + chance.standard_normal((count, len(belief.mean))) @ root.T
    states[:, HEADING] = wrap_angle(states[:, HEADING])
    return states
