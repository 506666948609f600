"""What the sonars of a robot on an estimate say of things that the map does not have, and to its filter.

    take_in    the echoes of an estimate, each at the place it was heard at, into the finds
    spared     a state whose readings that are nearer than the map allows say "no nearer" instead: they are of something
               else, and would pull an estimate to a wall that they are not of (a novelty filter: Fox, Burgard, Thrun,
               Cremers 1998). Where more than MOST_SPARED are so, the estimate is to blame and must hear them all

Rules: pure; estimates and states in, nothing asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from typing import Final

import numpy as np

from localization.filters.health import HealthStatus
from localization.live.localizer import Estimate
from localization.live.sensor_input import SensorInput, with_readings
from localization.planning.unmapped import NEAREST_IN, Unmapped
from nclient.robot_state import RobotState

MOST_SPARED: Final = 6


def spared(unmapped: Unmapped, estimate: Estimate, state: RobotState, angles_rad: Sequence[float]) -> SensorInput:
    """The state for the filter whose last estimate is given; the sonars stand at `angles_rad` on the turret."""
    readings = state.sonars_in
    if estimate.health.status is not HealthStatus.LOST:
        x, y, heading = (float(value) for value in estimate.pose)
        looking, std = heading + state.turret_rad - state.steering_rad, _std_in(estimate)
        near = unmapped.too_near((x, y), looking + np.asarray(angles_rad), np.array(readings, dtype=np.float64), std)
        if sum(near) <= MOST_SPARED:
            readings = tuple(int(NEAREST_IN) if hidden else told for hidden, told in zip(near, readings, strict=True))
    return with_readings(state, readings)


def take_in(unmapped: Unmapped, estimate: Estimate, state: RobotState, angles_rad: Sequence[float]) -> None:
    """Tell the finds of an estimate's echoes. Each was heard up to two tenths of a second before the estimate: the way
    since then is taken off at the velocities of the state."""
    if estimate.health.status is HealthStatus.LOST:
        unmapped.forget()
        return
    x, y, heading = (float(value) for value in estimate.pose)
    offset, std = state.turret_rad - state.steering_rad, _std_in(estimate)
    for echo in estimate.echoes:
        ago_s = estimate.clock_s - echo.instant_s
        then = heading - ago_s * state.steering_rad_s
        middle, gone = 0.5 * (heading + then), ago_s * state.translation_in_s
        place = (x - gone * cos(middle), y - gone * sin(middle))
        reading = float(state.sonars_in[echo.sonar])
        unmapped.hear(echo.instant_s, place, then + offset + angles_rad[echo.sonar], reading, std)


def _std_in(estimate: Estimate) -> float:
    """The spread of the position along its worst direction."""
    return float(np.sqrt(np.linalg.eigvalsh(estimate.belief.cov[:2, :2])[-1]))
