"""Starts and goals drawn at random in a world's free room, and what a drive from one to the other is run with. Data.

Both have ROOM_IN between body and walls and are APART_IN apart or more; the heading at the start is any. A pair is
drawn by its world and number alone. What errs is a live scenario's, all but its bad readings.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot
from typing import Final

import numpy as np

from localization.experiments.live.scenario import SCENARIOS, Scenario
from localization.planning.circles import room
from worlds.bodies import N150
from worlds.files import load_world, world_names
from worlds.geometry import inside, polygon_segments

ROOM_IN: Final = 1.5
APART_IN: Final = 12.0
WORLDS: Final = world_names()
SPEED_IN_S: Final = 5.0
METHOD: Final = "finder"


@dataclass(frozen=True, slots=True)
class Pair:
    """A drive: the world, the number of the pair in it, and the name of what errs (live.scenario)."""

    world: str
    number: int
    scenario: str

    @property
    def errs(self) -> Scenario:
        """What errs and how."""
        return SCENARIOS[self.scenario]


@dataclass(frozen=True, slots=True)
class Ends:
    """Where a drive begins, and where it is to end: inches, degrees."""

    start: tuple[float, float]
    heading_deg: float
    goal: tuple[float, float]


def ends_of(pair: Pair) -> Ends:
    """The ends of a pair."""
    world = load_world(pair.world)
    chance = np.random.default_rng([WORLDS.index(pair.world), pair.number])
    low, high = world.walls[:, :2].min(axis=0), world.walls[:, :2].max(axis=0)
    outline = polygon_segments(world.rooms[0].corners_in)
    walls = np.asarray(world.walls)
    while True:
        start, goal = (np.round(chance.uniform(low, high), 1) for _ in range(2))
        heading = float(np.round(chance.uniform(0.0, 360.0), 1))
        free = room(np.stack((start, goal)), walls).min() >= N150.radius_in + ROOM_IN
        within = bool(np.all(inside(np.stack((start, goal)), outline)))
        if free and within and hypot(*(goal - start)) >= APART_IN:
            return Ends((float(start[0]), float(start[1])), heading, (float(goal[0]), float(goal[1])))
