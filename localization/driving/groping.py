"""Driving without an estimate: turning on the spot to look around, and then on wherever the sonars ahead hear room.

Places that look alike from one spot are told apart on the way to another. Rules: readings in, velocities out; no map,
no robot, no clock: it is asked once a period.
"""

from __future__ import annotations

from math import cos, tau
from typing import Final, Protocol

import numpy as np

TURN_RAD_S: Final = 0.4
LOOK_RAD: Final = 4.0
"""How far it turns before it drives on: two thirds of a turn, in which each sonar hears a wall or two."""
DRIVE_IN_S: Final = 3.0
ROOM_AHEAD_IN: Final = 18.0
AHEAD: Final = cos(tau / 8)


class Heard(Protocol):
    """What is looked at of a robot's state."""

    @property
    def sonars_in(self) -> tuple[int, ...]: ...
    @property
    def steering_rad(self) -> float: ...
    @property
    def turret_rad(self) -> float: ...


class Groping:
    """See the head of this file. `period_s`: how often it is asked."""

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._looked_rad = 0.0

    def reset(self) -> None:
        """The place is known again; the next time begins with a look around."""
        self._looked_rad = 0.0

    def command(self, state: Heard) -> tuple[float, float]:
        """Translation in in/s and steering in rad/s."""
        if self._looked_rad < LOOK_RAD or not _room_ahead(state):
            self._looked_rad += TURN_RAD_S * self._period_s
            return 0.0, TURN_RAD_S
        return DRIVE_IN_S, 0.0


def _room_ahead(state: Heard) -> bool:
    """Whether all sonars that look ahead, an eighth of a turn to either side, hear nothing near."""
    looking = np.arange(len(state.sonars_in)) * (tau / len(state.sonars_in)) + state.turret_rad - state.steering_rad
    heard = zip(state.sonars_in, looking, strict=True)
    return all(reading > ROOM_AHEAD_IN for reading, way in heard if cos(way) >= AHEAD)
