"""Driving about for a long time: to place after place while the estimate is believed, groping while it is not.

    believed    a shortest way (planning.roadmap) to a place drawn by chance, turned to on the spot, then by the thesis'
                law
    lost        groping: a look around, and then on wherever the sonars ahead hear room

Rules: estimate and readings in, a command out; no robot, no truth. All chance is handed in.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from localization.driving.control import bearing_error
from localization.driving.groping import TURN_RAD_S, Groping, Heard
from localization.driving.navigation import PERIOD_S, Command, Navigator, Speeds
from localization.filters.belief import Floats
from localization.planning.course import waypoints
from localization.planning.roadmap import NoWayError, Roadmap

STAND: Final = Command(0.0, 0.0)
TURN_FIRST_RAD: Final = 1.0
"""Farther off the bearing than this the robot turns on the spot: the law alone would drive a circle."""


class Wanderer:
    """Goes about on a roadmap. `places` (n, 2) are where it may go."""

    def __init__(self, roadmap: Roadmap, places: Floats, speeds: Speeds, chance: np.random.Generator) -> None:
        self._roadmap, self._places, self._speeds, self._chance = roadmap, places, speeds, chance
        self._navigator: Navigator | None = None
        self._groping = Groping(PERIOD_S)

    def command(self, pose: Floats) -> Command:
        """What to do at a pose (3,) that is believed."""
        self._groping.reset()
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
        return Command(*self._groping.command(state))

    def _somewhere(self, pose: Floats) -> Navigator | None:
        goal = self._places[self._chance.integers(len(self._places))]
        try:
            path = self._roadmap.path((float(pose[0]), float(pose[1])), (float(goal[0]), float(goal[1])))
        except NoWayError:
            return None
        return Navigator(waypoints(path), self._speeds)

