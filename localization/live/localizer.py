"""The filter live: states of a robot in, estimates out. It sees what the robot's API reports and nothing else.

    state ──> pose history ──┐
    state ──> new echoes ────┴─> for each, at the pose of its firing instant: move, hear ──> estimate

Rules: odometry from the encoder pose, readings from State's sonars, time from the robot's clock; no truth, no wall
clock, no socket. Each echo counts once; limits (6, 255) are never ranges. The same object runs on every address.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from localization.estimation.belief import Belief, Floats
from localization.estimation.motion import step_between
from localization.estimation.observation import Refusal
from localization.estimation.systematic import pose_of
from localization.filters.method import Filter, Place, Searching, Smoothing
from localization.filters.surroundings import Surroundings
from localization.filters.table import DEFAULT_METHOD, make
from localization.filters.watch import ALL_WELL, Verdict
from localization.live import calibrated
from localization.live.echoes import FiringSchedule, FiringTime
from localization.live.lag import with_lag
from localization.live.odometry import EncoderPose, PoseHistory
from localization.live.told import Told


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
    bad_share: float = 0.0


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
    verdict: Verdict = ALL_WELL
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
        known: Surroundings,
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

    def update(self, told: Told) -> Estimate:
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
        return Estimate(latest.clock_s, lagged, echoes, self._filter.verdict, smoothed, places)

    def _hear(self, firing: FiringTime, reading_in: float) -> Echo:
        """Bring the filter to where the encoders were at that instant, and let it hear."""
        assert self._settled is not None
        there = self._history.at(firing.instant_s)
        self._filter.move(step_between(self._settled.pose, there.pose))
        self._settled, self._heard_s = there, firing.instant_s
        self._instants.append(firing.instant_s)
        judgement = self._filter.hear(firing.sonar, there.turret_offset_rad, float(reading_in))
        refusal, innovation_in, nis, bad_share = judgement
        return Echo(*firing, reading_in, refusal, innovation_in, nis, bad_share)
