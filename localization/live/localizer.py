"""What a clock in steps leaves unknown where readings have no stamps: when they were taken, against when the robot was
where its states say.

    the ring was restarted up to a step later than the clock of its answer tells, and a state is of up to a step later
    than its own: echoes are laid to where the robot was too early or too late, and the estimate is ahead or behind

    P + LAG_STD_S^2 xdot xdot'        xdot = (v cos(heading), v sin(heading), omega)

The first of the two is the same for a whole run, so a filter cannot average it away: this is no noise of the echoes. It
is added to what is told, and never to what the filter goes on from. Rules: pure.

The filter live: states of a robot in, estimates out. It sees what the robot's API reports and nothing else.

    state ──> pose history ──┐
    state ──> new echoes ────┴─> for each, at the pose of its firing instant: move, hear ──> estimate

Rules: odometry from the encoder pose, readings from State's sonars, time from the robot's clock; no truth, no wall
clock, no socket. Each echo counts once; limits (6, 255) are never ranges. The same object runs on every address.

Whether readings fit what a filter was told of its robot: NIS and refusals, summed over a run.

    NIS        mean of innovation^2 / its variance of the readings taken in: 1 is right
    refused    share of the ranges that the gate refused

A filter that is told too little noise believes its own wrong numbers, and its standard deviations say nothing of it;
its readings do. Rules: values and words.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, sin, sqrt
from typing import Final, NamedTuple

import numpy as np

from localization.filters.base import Filter, LocalizationConfig, Place, Searching, Smoothing
from localization.filters.belief import HEADING, Belief, Floats, difference
from localization.filters.health import HEALTHY, FilterHealth
from localization.filters.odometry import POSE, pose_of, step_between
from localization.filters.registry import DEFAULT_METHOD, make
from localization.filters.update import Refusal
from localization.live import sensor_input as calibrated
from localization.live.sensor_input import (
    CLOCK_STEP_S,
    EncoderPose,
    FiringSchedule,
    FiringTime,
    PoseHistory,
    SensorInput,
)

LAG_STD_S: Final = CLOCK_STEP_S / sqrt(6.0)
"""The difference of two instants, each anywhere within one step of the clock."""


def with_lag(belief: Belief, before: EncoderPose, now: EncoderPose) -> Belief:
    """A belief over states (n,) of a robot whose encoders went from one pose to the other, widened by that; the belief
    itself where it stood."""
    passed_s = now.clock_s - before.clock_s
    dx, dy, turn = difference(now.pose, before.pose).tolist()
    if passed_s <= 0.0 or not (dx or dy or turn):
        return belief
    told, heading = float(before.pose[HEADING]) + 0.5 * turn, float(belief.mean[HEADING])
    way = LAG_STD_S * (dx * cos(told) + dy * sin(told)) / passed_s
    ahead = np.array([way * cos(heading), way * sin(heading), LAG_STD_S * turn / passed_s])
    cov = belief.cov.copy()
    cov[:POSE, :POSE] += ahead[:, None] * ahead
    return Belief(belief.mean, cov)


class Echo(NamedTuple):
    """One reading and what became of it.

    innovation_in   reading less expectation (0 where nothing was expected), and `nis`, its square over its variance
    bad_share       how likely it was a bad reading: 0 or 1 where a gate decides
    """

    sonar: int
    instant_s: float
    reading_in: float
    refusal: Refusal
    innovation_in: float
    nis: float = 0.0
    outlier_probability: float = 0.0


class Smoothed(NamedTuple):
    """Where the robot is believed to have been at `clock_s`, some time ago, by all that was heard until now."""

    clock_s: float
    belief: Belief


@dataclass(frozen=True, slots=True)
class Estimate:
    """Where the robot is believed to be at `clock_s` of its own clock, and the echoes heard since the last one;
    of a method that smooths, where it was a while ago besides; of one that searches, all places that it may be at."""

    clock_s: float
    belief: Belief
    echoes: tuple[Echo, ...]
    health: FilterHealth = HEALTHY
    smoothed: Smoothed | None = None
    places: tuple[Place, ...] = ()

    @property
    def pose(self) -> Floats:
        """x_in, y_in and the heading of the steering in radians, (3,)."""
        return pose_of(self.belief).mean


class Localizer:
    """A filter on one robot, fed with its states.

    `belief`: where it is thought to stand when the first state comes, over poses, or over longer states (systematic)
    where the encoders' own errors are to be found out as well. `method`: a name of filters.table, `seed` its chance;
    or a filter that is made already.
    """

    def __init__(
        self,
        known: LocalizationConfig,
        belief: Belief,
        schedule: FiringSchedule,
        method: str | Filter = DEFAULT_METHOD,
        seed: int = 0,
    ) -> None:
        self._filter = make(method, known, belief, seed) if isinstance(method, str) else method
        self._schedule, self._errs = schedule, known.errs
        self._history = PoseHistory()
        self._settled: EncoderPose | None = None
        self._heard_s = -np.inf
        self._searching = self._filter if isinstance(self._filter, Searching) else None
        self._smoothing = self._filter if isinstance(self._filter, Smoothing) else None
        self._instants: deque[float] = deque(maxlen=1 + (self._smoothing.lag if self._smoothing else 0))

    def update(self, told: SensorInput) -> Estimate:
        """Take in one state and say where the robot is. A state no later than the one before changes nothing.

        Raises ValueError for a state without a clock: nothing was received yet.
        """
        told = calibrated.of(told, self._errs)
        if told.clock_s is None:
            raise ValueError("a state without a clock: ask the robot for one (refresh) before localizing")
        now = EncoderPose(told.clock_s, np.array([told.x_in, told.y_in, told.steering_rad]), told.turret_rad)
        if self._settled is None:
            self._settled = now
            self._heard_s = now.clock_s
            self._instants.append(now.clock_s)
            self._history.add(now)
        elif now.clock_s > self._history.latest.clock_s:
            self._history.add(now)
        latest = self._history.latest
        firings = self._schedule.readable(self._heard_s, latest.clock_s)
        echoes = tuple(self._hear(firing, told.sonars_in[firing.sonar]) for firing in firings)
        step = step_between(self._settled.pose, latest.pose)
        smoothed = Smoothed(self._instants[0], self._smoothing.smoothed()) if self._smoothing else None
        lagged = with_lag(self._filter.ahead(step), *self._history.last_two)
        places = self._searching.places if self._searching else ()
        return Estimate(latest.clock_s, lagged, echoes, self._filter.health, smoothed, places)

    def _hear(self, firing: FiringTime, reading_in: float) -> Echo:
        """Bring the filter to where the encoders were at that instant, and let it hear."""
        assert self._settled is not None
        there = self._history.at(firing.instant_s)
        self._filter.move(step_between(self._settled.pose, there.pose))
        self._settled, self._heard_s = there, firing.instant_s
        self._instants.append(firing.instant_s)
        judgement = self._filter.hear(firing.sonar, there.turret_offset_rad, float(reading_in))
        refusal, innovation_in, nis, outlier_probability = judgement
        return Echo(*firing, reading_in, refusal, innovation_in, nis, outlier_probability)


LARGEST_NIS: Final = 1.5
MOST_REFUSED: Final = {True: 0.1, False: 0.35}
"""By whether sonars are exact rays; of a real ring's readings many are bad anyway."""


@dataclass
class Fit:
    """The sums. `rays`: sonars are taken for exact rays."""

    rays: bool
    taken: int = 0
    refused: int = 0
    nis_sum: float = 0.0

    def add(self, echoes: Iterable[Echo]) -> None:
        """Echoes of another period."""
        for echo in echoes:
            if echo.refusal is Refusal.NONE:
                self.taken += 1
                self.nis_sum += echo.nis
            elif echo.refusal is Refusal.GATE:
                self.refused += 1

    @property
    def nis(self) -> float:
        """The mean of those taken in; 0 of none."""
        return self.nis_sum / self.taken if self.taken else 0.0

    @property
    def refused_share(self) -> float:
        """Of those taken in or refused by the gate; 0 of none."""
        return self.refused / (self.taken + self.refused) if self.refused else 0.0

    @property
    def good(self) -> bool:
        """Whether what was found can be believed as far as it says."""
        return self.nis <= LARGEST_NIS and self.refused_share <= MOST_REFUSED[self.rays]

    def line(self) -> str:
        """In words, with the remedy where it is not good."""
        told = f"readings fit with a NIS of {self.nis:.2f} (1 is right), {self.refused_share:.1%} refused"
        if self.good:
            return told
        ring = "a real ring's cones are taken for rays (--sonars cones), " if self.rays else ""
        return (
            f"{told}: do not believe this. The encoders miss more than --odometry-noise says, {ring}--start is "
            "elsewhere, or the map is not of this room"
        )
