"""Monte Carlo localization: a belief as weighted particles. For what no gaussian can hold, and as another opinion.

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

import numpy as np

from localization.estimation.belief import HEADING, Belief, Floats, difference, wrap_angle
from localization.estimation.motion import OdometryNoise, step_variance
from localization.estimation.observation import Judgement, Refusal, told_as
from localization.estimation.repeats import Repeats
from localization.estimation.systematic import POSE, move_states
from localization.filters.likelihood import Likelihood
from localization.filters.watch import Verdict, Watch


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
        self._watch, self._repeats = Watch(), Repeats()

    @property
    def belief(self) -> Belief:
        """The gaussian of the particles' first two moments."""
        return moments(self.states, self.weights)

    @property
    def verdict(self) -> Verdict:
        return self._watch.verdict(self.belief)

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

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        """Weigh the particles with a reading; limits say nothing."""
        if not self._likelihood.is_range(reading_in):
            return Judgement(Refusal.LIMIT, 0.0, 0.0, 1.0)
        times = self._repeats.before(sonar, turret_offset_rad) + 1
        self._repeats.take(sonar, turret_offset_rad)
        likelihood, bad = self._likelihood.of(self.states[:, :POSE], sonar, turret_offset_rad, reading_in)
        bad_share = float(self.weights @ bad / (self.weights @ likelihood))
        self.weights = self.weights * likelihood ** self._likelihood.news(reading_in, times)
        self.weights /= self.weights.sum()
        if self.effective < self._parameters.resample_threshold * len(self.states):
            self._resample()
        judgement = Judgement(told_as(bad_share), 0.0, 0.0, bad_share)
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
