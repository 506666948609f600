"""Readings made bad on purpose: of each echo decided once, as it is first shown, whether it is replaced and by what.

Rules: the filter sees the same interface; all chance is the seed's. Which echo a state shows is the schedule's to tell.
"""

from __future__ import annotations

import numpy as np

from localization.live.sensor_input import FiringSchedule, SensorInput, with_readings

LOWEST_IN, HIGHEST_IN = 6, 255


class BadReadings:
    """Replaces a share of all echoes by whole inches anywhere from 6 to 255."""

    def __init__(self, share: float, schedule: FiringSchedule, chance: np.random.Generator) -> None:
        self._share, self._schedule, self._chance = share, schedule, chance
        self._late_s = [schedule.order.index(sonar) * schedule.interval_s for sonar in range(len(schedule.order))]
        self._round_s = schedule.round_s
        self._replaced: dict[int, tuple[int, int | None]] = {}

    def of(self, told: SensorInput) -> SensorInput:
        """What the robot told as the filter is shown it."""
        if not self._share or told.clock_s is None:
            return told
        readings = [self._reading(sonar, told.clock_s, int(heard)) for sonar, heard in enumerate(told.sonars_in)]
        return with_readings(told, tuple(readings))

    def _reading(self, sonar: int, clock_s: float, heard_in: int) -> int:
        since_s = clock_s - self._schedule.start_s - self._late_s[sonar]
        turn = int(since_s // self._round_s)
        if self._replaced.get(sonar, (None, None))[0] != turn:
            bad, instead = self._chance.random() < self._share, int(self._chance.integers(LOWEST_IN, HIGHEST_IN + 1))
            self._replaced[sonar] = turn, instead if bad else None
        instead_in = self._replaced[sonar][1]
        return heard_in if instead_in is None else instead_in
