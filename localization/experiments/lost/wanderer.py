"""Driving about for a long time: to place after place while the estimate is believed, groping while it is not.

    believed    a shortest way (planning.roadmap) to a place drawn by chance, turned to on the spot, then by the thesis'
                law
    lost        turning on the spot to look around, and then on wherever the sonars ahead hear room, so that places that
                look alike are told apart

Rules: estimate and readings in, a command out; no robot, no truth. All chance is handed in.
"""

from __future__ import annotations

from math import cos, tau
from typing import Final, Protocol

import numpy as np

from localization.belief import Floats
from localization.control import bearing_error
from localization.navigation import PERIOD_S, Command, Navigator, Speeds
from localization.planning.course import waypoints
from localization.planning.roadmap import NoWayError, Roadmap

STAND: Final = Command(0.0, 0.0)
TURN_RAD_S: Final = 0.4
TURN_FIRST_RAD: Final = 1.0
"""Farther off the bearing than this the robot turns on the spot: the law alone would drive a circle."""
LOOK_S: Final = 10.0
"""How long a lost robot turns before it drives on."""
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


class Wanderer:
    """Goes about on a roadmap. `places` (n, 2) are where it may go."""

    def __init__(self, roadmap: Roadmap, places: Floats, speeds: Speeds, chance: np.random.Generator) -> None:
        self._roadmap, self._places, self._speeds, self._chance = roadmap, places, speeds, chance
        self._navigator: Navigator | None = None
        self._groping = 0

    def command(self, pose: Floats) -> Command:
        """What to do at a pose (3,) that is believed."""
        self._groping = 0
        if self._navigator is None or (command := self._navigator.command(pose)) is None:
            self._navigator = self._somewhere(pose)
            return STAND
        goal = self._navigator.goal
        assert goal is not None
        error = float(bearing_error(pose, goal))
        if abs(error) > TURN_FIRST_RAD:
            return Command(0.0, float(np.copysign(TURN_RAD_S, error)))
        return command

    def grope(self, state: Heard) -> Command:
        """What to do when nothing is believed."""
        self._navigator = None
        self._groping += 1
        if self._groping * PERIOD_S < LOOK_S or not _room_ahead(state):
            return Command(0.0, TURN_RAD_S)
        return Command(0.6 * self._speeds.translation_in_s, 0.0)

    def _somewhere(self, pose: Floats) -> Navigator | None:
        goal = self._places[self._chance.integers(len(self._places))]
        try:
            path = self._roadmap.path((float(pose[0]), float(pose[1])), (float(goal[0]), float(goal[1])))
        except NoWayError:
            return None
        return Navigator(waypoints(path), self._speeds)


def _room_ahead(state: Heard) -> bool:
    """Whether all sonars that look ahead, an eighth of a turn to either side, hear nothing near."""
    looking = np.arange(len(state.sonars_in)) * (tau / len(state.sonars_in)) + state.turret_rad - state.steering_rad
    return all(reading > ROOM_AHEAD_IN for reading, way in zip(state.sonars_in, looking, strict=True)
               if cos(way) >= AHEAD)
