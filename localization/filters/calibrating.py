"""A filter that finds out what wheels and sonars get wrong every time, while it localizes: one long state.

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
from math import radians, sqrt
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import HEADING, Belief, Floats, add
from localization.estimation.chi_square import chi_square_quantile
from localization.estimation.hearing import Sense
from localization.estimation.motion import step_variance
from localization.estimation.observation import TELLING, Judgement, Refusal, told_as
from localization.estimation.systematic import LARGEST, POSE, move_states, step_jacobians
from localization.filters.surroundings import Surroundings, sense_of
from localization.filters.watch import Verdict, Watch
from localization.sonar.aim import Aiming, Look
from localization.sonar.cone import ConeModel
from localization.sonar.measurement import SonarModel
from worlds.bodies import SONARS

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

    def __init__(self, known: Surroundings, start: Belief, stds: tuple[float, ...] = CONSTANTS_STD) -> None:
        size = len(start.mean)
        self.belief = Belief(np.zeros(SIZE), np.diag(np.append(np.zeros(POSE), stds) ** 2))
        self.belief.mean[:size] = start.mean
        self.belief.cov[:size, :size] = start.cov
        self._odometry = known.odometry
        self._lowest_in, self._highest_in = known.sonar.lowest_in, known.sonar.highest_in
        self._variance: Callable[[Floats], Floats] = known.sonar.variance
        self._sense = _tolerant(known.walls, known)
        self._aiming = None
        if isinstance(known.sonar, ConeModel):
            self._aiming = Aiming(known.walls, known.body, known.sonar)
        self._watch = Watch()
        self._threshold = chi_square_quantile(GATE_PROBABILITY, 1)

    @property
    def verdict(self) -> Verdict:
        """How far it can be believed."""
        return self._watch.verdict(self.belief)

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

    def hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        """A reading of sonar number `sonar`, the turret being turned by so much against the heading."""
        judgement = self._hear(sonar, turret_offset_rad, reading_in)
        if judgement.refusal in TELLING:
            self._watch.look(judgement)
        return judgement

    def _hear(self, sonar: int, turret_offset_rad: float, reading_in: float) -> Judgement:
        if reading_in > self._lowest_in:
            self._aim(sonar, turret_offset_rad, reading_in)
        if not self._lowest_in < reading_in < self._highest_in:
            return Judgement(Refusal.LIMIT, 0.0, 0.0, 1.0)
        mean = self.belief.mean
        range_in = float(np.clip(reading_in - mean[OFFSET] - mean[OWN + sonar], self._lowest_in + _INSIDE_IN,
                                 self._highest_in - _INSIDE_IN))  # fmt: skip
        sensed = self._sense.sense(self._looking(), sonar, turret_offset_rad + float(mean[RING_TURN]), range_in)
        heard = sensed.candidates
        if heard is None:
            return Judgement(sensed.refusal, 0.0, 0.0, 1.0)
        by_state = np.zeros((len(heard.ranges_in), SIZE))
        by_state[:, :POSE] = heard.jacobian
        by_state[:, RING_TURN] = heard.jacobian[:, HEADING]
        by_state[:, [OFFSET, OWN + sonar]] = 1.0
        pull = by_state @ self.belief.cov
        spread = (pull * by_state).sum(axis=-1) + self._variance(heard.ranges_in)
        innovation = range_in - heard.ranges_in
        nis = innovation * innovation / spread
        if not heard.bad_share and nis[0] > self._threshold:
            return Judgement(Refusal.GATE, float(innovation[0]), float(nis[0]), 1.0)
        return self._absorb(heard.probability, heard.bad_share, heard.bad_density, pull, spread, innovation)

    def _absorb(
        self, probability: Floats, bad_share: float, bad_density: float, pull: Floats, spread: Floats,
        innovation: Floats,
    ) -> Judgement:  # fmt: skip
        """Probabilistic data association (mixture.py): the first two moments of all hypotheses."""
        good, nis = 1.0 - bad_share, innovation * innovation / spread
        weight = good * probability * np.exp(-0.5 * nis) / np.sqrt(2.0 * np.pi * spread)
        bad = bad_density * (1.0 - good * probability.sum())
        total = weight.sum() + bad
        share, bad_share = weight / total, float(bad / total)
        moves = pull * (innovation / spread)[:, None]
        change = share @ moves
        away = moves - change
        cov = self.belief.cov - (pull * (share / spread)[:, None]).T @ pull
        cov += (away * share[:, None]).T @ away + bad_share * np.outer(change, change)
        self.belief = Belief(add(self.belief.mean, change), 0.5 * (cov + cov.T))
        best = int(np.argmax(share))
        return Judgement(told_as(bad_share), float(innovation[best]), float(nis[best]), bad_share)

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
        off_rad, share = self._aiming.after(
            Look((x, y, heading), sonar, ring_rad, sqrt(variance), read_in, spread_in2)
        )
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


def _tolerant(walls: npt.ArrayLike, known: Surroundings) -> Sense:
    """A sense whose own gate, which knows poses only, leaves room for the offsets; ours is taken afterwards."""
    sonar: SonarModel | ConeModel = known.sonar
    if isinstance(sonar, SonarModel):
        sonar = replace(sonar, rounding_var_in2=sonar.rounding_var_in2 + _LOOSE_IN2)
    return sense_of(walls, known.body, sonar, known.gate)
