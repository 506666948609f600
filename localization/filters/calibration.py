"""Where a sonar looks, told by what it hears at all: a wall that is met head-on just inside the cone, or just not.

A range hardly depends on the angle under which a smooth wall is met, so ranges alone say little of how the ring is
mounted. Which wall is heard does: each is heard over as many degrees as the cone is wide, about its own normal. So for
a normal prior N(0, s^2) of the axis, off from where it is thought to look,

    posterior(off) ~ N(off; 0, s^2) p(reading | off)        p: bad readings and all that the cone may hear there

is worked out at some offs, and what is left of it is its mean and its variance (assumed density). Rules: pure; one
reading, one axis; what it means for a state is filters.calibrating's to say.

A filter that finds out what wheels and sonars get wrong every time, while it localizes: one long state.

    0..5     pose, way_scale, turn_scale, drift                      (systematic)
    6        range offset of all sonars: readings less ranges, inches
    7        ring turn: the ring stands turned by this against the turret, radians
    8..23    what each sonar reads more than that, inches

A range grows by the offsets one for one, and by the ring's turn as by the heading: only where the turn puts the ring,
not where the robot then drives. So the ring's turn is told from the heading by driving, one sonar's offset from
another's by turning the ring, the offset of all from the way by walls on both sides. Of a real ring, whose ranges
hardly depend on the angle, its turn is told by which walls its sonars hear at all (aim).

Rules: a Filter (filters.method). What a reading may be of is a sense's to say; mixture of hypotheses as in mixture.py,
with derivatives by the longer state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import exp, pi, radians, sqrt
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.base import LocalizationConfig, measurement_model
from localization.filters.belief import HEADING, Belief, Floats, add, chi_square_quantile
from localization.filters.health import FilterHealth, IntegrityMonitor
from localization.filters.odometry import LARGEST, POSE, move_states, step_jacobians, step_variance
from localization.filters.reflectors import reflectors
from localization.filters.sonar_cone import ConeSensor, ConeSonar, EchoCandidate, SonarMount
from localization.filters.sonar_ray import RaySonar, SonarRing, wall_map
from localization.filters.update import INFORMATIVE, MeasurementModel, Refusal, UpdateResult, refusal_of
from worlds.robots import SONARS

EDGE_STD_RAD: Final = radians(0.5)
"""How sharp the rim of a cone is taken to be."""
NODES: Final = np.arange(-3.0, 3.01, 0.5)
"""Where the posterior is worked out, in standard deviations."""
_WEIGHTS: Final = np.exp(-0.5 * NODES * NODES) / np.exp(-0.5 * NODES * NODES).sum()
_VARIANCE: Final = float(_WEIGHTS @ (NODES * NODES))
_SPACING: Final = 0.5
_FROM_THE_ENDS: Final = [6, 0, 12, *(at for at in range(1, 12) if at != 6)]
NARROW_RAD: Final = radians(1.0)
"""With an axis known so well nothing is heard in the middle of both ends only: a cone is wider than that."""
ALIKE: Final = 0.01


class Look(NamedTuple):
    """A reading and what is believed of the sonar before it.

    pose          of the robot                     sonar, offset_rad    its number; the ring against the heading
    std_rad       of the heading and ring, together
    reading_in    less the sonar's own offset; at or above the model's highest: nothing was heard
    spread_in2    variance of ranges by all but the reading's own noise
    """

    pose: tuple[float, float, float]
    sonar: int
    offset_rad: float
    std_rad: float
    reading_in: float
    spread_in2: float


class Aiming:
    """The sonars of a body in a map."""

    def __init__(self, walls: npt.ArrayLike, body: SonarRing, model: ConeSonar) -> None:
        self._listener = ConeSensor(reflectors(wall_map(walls).segments), model)
        self._body, self._model = body, model

    def after(self, look: Look) -> tuple[float, float]:
        """How far off the axis looks after it, radians, and the variance of that as a share of what it was."""
        edge_rad = max(EDGE_STD_RAD, _SPACING * look.std_rad)
        direction_rad = look.offset_rad + self._body.sonar_angles_rad[look.sonar]
        likelihood = np.empty(len(NODES))
        known: dict[int, float] = {}
        for count, at in enumerate(_FROM_THE_ENDS):
            ear = SonarMount(direction_rad + float(NODES[at]) * look.std_rad, self._body.sonar_ring_radius_in)
            likelihood[at] = _likelihood(self._listener.hear(look.pose, edge_rad, ear), known, self._model, look)
            if count == 2 and look.std_rad < NARROW_RAD and _alike(likelihood[_FROM_THE_ENDS[:3]]):
                return 0.0, 1.0
        posterior = _WEIGHTS * likelihood
        posterior /= posterior.sum()
        mean = float(posterior @ NODES)
        return mean * look.std_rad, float(posterior @ np.square(NODES - mean)) / _VARIANCE


def _alike(likelihood: Floats) -> bool:
    """Whether nothing is told."""
    return float(likelihood.max() - likelihood.min()) <= ALIKE * float(likelihood.max())


def _likelihood(heard: list[EchoCandidate], known: dict[int, float], model: ConeSonar, look: Look) -> float:
    """p(reading | what may be heard); `known`: densities by reflector, which hold for all offs alike."""
    good = 1.0 - model.outlier_probability
    if look.reading_in >= model.highest_in:
        return 1.0 - good * sum([found.probability for found in heard])
    total, any_of = 0.0, 0.0
    for found in heard:
        density = known.get(found.which)
        if density is None:
            variance, off_in = look.spread_in2 + model.variance_at(found.range_in), look.reading_in - found.range_in
            known[found.which] = density = exp(-0.5 * off_in * off_in / variance) / sqrt(2.0 * pi * variance)
        total += found.probability * density
        any_of += found.probability
    return good * total + model.bad_density * (1.0 - good * any_of)


OFFSET: Final = LARGEST
RING_TURN: Final = OFFSET + 1
OWN: Final = RING_TURN + 1
SIZE: Final = OWN + SONARS

CONSTANTS_STD: Final = (0.05, 0.05, 0.003, 2.0, radians(5.0), *(0.5,) * SONARS)
"""What is taken for possible beforehand: wheels 5 % off, 3 mrad an inch, sonars 2 in, the ring 5 degrees."""
GATE_PROBABILITY: Final = 0.999
_LOOSE_IN2: Final = 16.0
_INSIDE_IN: Final = 1e-3


class CalibratingFilter:
    """See the head of this file. `start`: the belief over states (n,) at the start, 3 <= n <= 6: `stds` is of all
    constants, those that it has already are its own."""

    def __init__(self, known: LocalizationConfig, start: Belief, stds: tuple[float, ...] = CONSTANTS_STD) -> None:
        size = len(start.mean)
        self.belief = Belief(np.zeros(SIZE), np.diag(np.append(np.zeros(POSE), stds) ** 2))
        self.belief.mean[:size] = start.mean
        self.belief.cov[:size, :size] = start.cov
        self._odometry = known.odometry
        self._lowest_in, self._highest_in = known.sonar.lowest_in, known.sonar.highest_in
        self._variance: Callable[[Floats], Floats] = known.sonar.variance
        self._sense = _tolerant(known.walls, known)
        self._aiming = None
        if isinstance(known.sonar, ConeSonar):
            self._aiming = Aiming(known.walls, known.body, known.sonar)
        self._watch = IntegrityMonitor()
        self._threshold = chi_square_quantile(GATE_PROBABILITY, 1)

    @property
    def health(self) -> FilterHealth:
        """How far it can be believed."""
        return self._watch.health(self.belief)

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,)."""
        self.belief = self.ahead(step)

    def ahead(self, step: Floats) -> Belief:
        """The belief after such a step, which is not taken."""
        belief = self.belief
        mean, by_state = belief.mean.copy(), np.eye(SIZE)
        by_state[:LARGEST, :LARGEST], by_step = step_jacobians(mean[:LARGEST], step)
        mean[:LARGEST] = move_states(mean[:LARGEST], step)
        cov = by_state @ belief.cov @ by_state.T
        cov[:POSE, :POSE] += (by_step * step_variance(step, self._odometry)) @ by_step.T
        return Belief(mean, 0.5 * (cov + cov.T))

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """A reading of sonar number `sonar`, the turret being turned by so much against the heading."""
        judgement = self._hear(sonar, turret_offset_rad, reading_in)
        if judgement.refusal in INFORMATIVE:
            self._watch.look(judgement)
        return judgement

    def _hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        if reading_in > self._lowest_in:
            self._aim(sonar, turret_offset_rad, reading_in)
        if not self._lowest_in < reading_in < self._highest_in:
            return UpdateResult(Refusal.LIMIT, 0.0, 0.0, 1.0)
        mean = self.belief.mean
        range_in = float(np.clip(reading_in - mean[OFFSET] - mean[OWN + sonar], self._lowest_in + _INSIDE_IN,
                                 self._highest_in - _INSIDE_IN))  # fmt: skip
        sensed = self._sense.sense(self._looking(), sonar, turret_offset_rad + float(mean[RING_TURN]), range_in)
        heard = sensed.candidates
        if heard is None:
            return UpdateResult(sensed.refusal, 0.0, 0.0, 1.0)
        by_state = np.zeros((len(heard.ranges_in), SIZE))
        by_state[:, :POSE] = heard.jacobian
        by_state[:, RING_TURN] = heard.jacobian[:, HEADING]
        by_state[:, [OFFSET, OWN + sonar]] = 1.0
        pull = by_state @ self.belief.cov
        spread = (pull * by_state).sum(axis=-1) + self._variance(heard.ranges_in)
        innovation = range_in - heard.ranges_in
        nis = innovation * innovation / spread
        if not heard.outlier_probability and nis[0] > self._threshold:
            return UpdateResult(Refusal.GATE, float(innovation[0]), float(nis[0]), 1.0)
        return self._absorb(heard.probability, heard.outlier_probability, heard.bad_density, pull, spread, innovation)

    def _absorb(
        self, probability: Floats, outlier_probability: float, bad_density: float, pull: Floats, spread: Floats,
        innovation: Floats,
    ) -> UpdateResult:  # fmt: skip
        """Probabilistic data association (mixture.py): the first two moments of all hypotheses."""
        good, nis = 1.0 - outlier_probability, innovation * innovation / spread
        weight = good * probability * np.exp(-0.5 * nis) / np.sqrt(2.0 * np.pi * spread)
        bad = bad_density * (1.0 - good * probability.sum())
        total = weight.sum() + bad
        share, outlier_probability = weight / total, float(bad / total)
        moves = pull * (innovation / spread)[:, None]
        change = share @ moves
        away = moves - change
        cov = self.belief.cov - (pull * (share / spread)[:, None]).T @ pull
        cov += (away * share[:, None]).T @ away + outlier_probability * np.outer(change, change)
        self.belief = Belief(add(self.belief.mean, change), 0.5 * (cov + cov.T))
        best = int(np.argmax(share))
        return UpdateResult(
            refusal_of(outlier_probability), float(innovation[best]), float(nis[best]), outlier_probability
        )

    def _aim(self, sonar: int, turret_offset_rad: float, reading_in: float) -> None:
        """What is heard at all tells where the sonar looks: heading and ring together."""
        mean, cov = self.belief.mean, self.belief.cov
        pull = cov[:, HEADING] + cov[:, RING_TURN]
        variance = float(pull[HEADING] + pull[RING_TURN])
        if self._aiming is None or variance <= 0.0:
            return
        offset = [OFFSET, OWN + sonar]
        read_in = reading_in if reading_in >= self._highest_in else reading_in - float(mean[offset].sum())
        spread_in2 = float(cov[0, 0] + cov[1, 1] + cov[np.ix_(offset, offset)].sum())
        x, y, heading = mean[:POSE].tolist()
        ring_rad = turret_offset_rad + float(mean[RING_TURN])
        off_rad, share = self._aiming.after(Look((x, y, heading), sonar, ring_rad, sqrt(variance), read_in, spread_in2))
        gain = pull / variance
        self.belief = Belief(add(mean, gain * off_rad), cov - np.outer(gain, pull) * (1.0 - share))

    def _looking(self) -> Belief:
        """The belief over where the robot is and where its ring looks: the heading as uncertain as both together."""
        cov = self.belief.cov[:POSE, :POSE].copy()
        by_ring = self.belief.cov[: RING_TURN + 1, RING_TURN]
        cov[HEADING, HEADING] += by_ring[RING_TURN] + 2.0 * by_ring[HEADING]
        cov[:HEADING, HEADING] += by_ring[:HEADING]
        cov[HEADING, :HEADING] += by_ring[:HEADING]
        return Belief(self.belief.mean[:POSE], cov)


def _tolerant(walls: npt.ArrayLike, known: LocalizationConfig) -> MeasurementModel:
    """A sense whose own gate, which knows poses only, leaves room for the offsets; ours is taken afterwards."""
    sonar: RaySonar | ConeSonar = known.sonar
    if isinstance(sonar, RaySonar):
        sonar = replace(sonar, rounding_var_in2=sonar.rounding_var_in2 + _LOOSE_IN2)
    return measurement_model(walls, known.body, sonar, known.gate)
