"""The live localizer: polled states of a robot go in, estimates come out.

    state --> pose history --+
    state --> new echoes ----+--> for each echo, at the pose of its instant: predict, update --> Estimate

It uses what the robot's interface reports and nothing else: odometry from the encoders, readings from State's sonars,
time from the robot's clock. Each echo counts once; limits are never ranges.
"""

from __future__ import annotations

from collections import deque
from math import sqrt
from typing import Final

import numpy as np

from localization.filters.base import EncoderRow, Filter, LocalizationConfig
from localization.filters.belief import Belief
from localization.filters.registry import DEFAULT_METHOD, make
from localization.filters.update import REFUSALS
from localization.live import sensor_input
from localization.live.estimate import Echo, Estimate, Smoothed
from nclient.common.process import show_seconds

__all__ = ["LAG_STD_S", "Estimate", "Localizer", "Smoothed"]

LAG_STD_S: Final = sensor_input.CLOCK_STEP_S / sqrt(6.0)
"""Standard deviation of the difference of two instants, each anywhere within one step of the clock."""


class Localizer:
    """A filter on one robot, fed with its states.

    Parameters
    ----------
    config
        Map, robot and noise models.
    belief
        Belief at the first state: over poses, or longer states where the odometry parameters are estimated as well.
    schedule
        Instants at which the sonars fire.
    method
        A name of registry.METHODS, or a filter.
    seed
        For filters that draw samples.
    """

    def __init__(self, config: LocalizationConfig, belief: Belief, schedule: sensor_input.FiringSchedule,
                 method: str | Filter = DEFAULT_METHOD, seed: int = 0) -> None:  # fmt: skip
        with show_seconds("preparing the filter; numba compiles it once on a machine"):
            self._filter = make(method, config, belief, seed) if isinstance(method, str) else method
        self._schedule, self._calibration, self.ring = schedule, config.calibration, config.body.ring
        self._history, self._slip = sensor_input.PoseHistory(), sensor_input.SlipCorrection()
        self._encoders: EncoderRow | None = None
        """Encoders at the instant to which the filter has predicted."""
        self._last_echo_s = -np.inf
        self._instants: deque[float] = deque(maxlen=1 + self._filter.lag)

    def update(self, state: sensor_input.SensorInput) -> Estimate:
        """Take one state into account and return the estimate. A state no later than the one before changes nothing.

        Raises
        ------
        ValueError
            A state without a clock: nothing was received yet.
        """
        # 1. The state without the systematic errors of the sonars, into the history.
        state = sensor_input.corrected(state, self._calibration, self.ring)
        if state.clock_s is None:
            raise ValueError("a state without a clock: poll the robot once (refresh) before localizing")
        x_in, y_in = self._slip.position_of(state)
        now = sensor_input.EncoderPose(state.clock_s, x_in, y_in, state.steering_rad, state.turret_rad)
        history = self._history
        if self._encoders is None:
            self._encoders = now
            self._last_echo_s = now.clock_s
            self._instants.append(now.clock_s)
            history.add(now)
        elif now.clock_s > history.latest.clock_s:
            history.add(now, state.touching)
        is_uneven = history.is_uneven
        self._filter.detects_slips = not is_uneven
        if self._slip.rolled_in:
            self._filter.roll_on_spot(self._slip.rolled_in)
        # 2. Every new echo: predict to the pose of its instant, update. Then the estimate now: predicted from the last
        #    echo, widened by the uncertain instants.
        late_s, clock_std_s = (history.clock_late_s, history.clock_rms_s) if is_uneven else (0.0, LAG_STD_S)
        sonars_in, latest = state.sonars_in, history.latest
        new = [
            (instant_s, sonar, float(sonars_in[sonar]))
            for sonar, instant_s in self._schedule.readable(self._last_echo_s, latest.clock_s, late_s)
        ]
        poses = history.since(new[0][0] if new else latest.clock_s)
        outcomes, self._encoders, belief = self._filter.advance(self._encoders, poses, new, clock_std_s)
        if new:
            self._last_echo_s = new[-1][0]
        self._instants.extend([instant_s for instant_s, _, _ in new])
        # 3. What else the filter reports.
        echoes = tuple([
            Echo(sonar, instant_s, sonars_in[sonar], REFUSALS[code], innovation_in, nis, outlier)
            for (instant_s, sonar, _), (code, innovation_in, nis, outlier, _, _) in zip(new, outcomes, strict=True)
        ])
        past, filter_ = self._filter.smoothed(), self._filter
        smoothed = Smoothed(self._instants[0], past) if past else None
        return Estimate(latest.clock_s, belief, echoes, filter_.health, smoothed, filter_.places,
                        filter_.informative_turn_rad)
