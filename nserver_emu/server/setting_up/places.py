"""Where there is room for one more robot: at a start of the world, or in rings of places around the starts."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, hypot, inf, sin, tau
from typing import Final

from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose

GAP_IN: Final = 1.0
"""Between neighbours in a ring."""

MOST_RINGS: Final = 60
"""Around each start: 11,000 places. A world as wide as that has room for a thousand robots."""


class FreePlaces:
    """Places for robots that come one after another; a place that was refused once is not asked for again.

    So robots may come meanwhile, but none may go or move.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._untried: dict[float, Iterator[StartPose]] = {}

    def next(self, radius_in: float) -> StartPose | None:
        """The first place where a robot of this radius touches nothing and nobody; None where there is none."""
        standing, world = self._simulation.standing, self._simulation.world
        for place in self._untried.setdefault(radius_in, self._places(2.0 * radius_in + GAP_IN)):
            here = place.x_in, place.y_in
            if not standing.touched(*here, radius_in) and world.clearance(*here) > radius_in:
                return place
        return None

    def _places(self, spacing_in: float) -> Iterator[StartPose]:
        """The starts, then rings around each, as far as the world goes."""
        starts = self._simulation.world.starts
        yield from starts
        reach_in = {start: self._reach_in(start) for start in starts}
        for ring in range(1, MOST_RINGS + 1):
            for start in (start for start in starts if ring * spacing_in <= reach_in[start]):
                for number in range(6 * ring):
                    angle = tau * number / (6 * ring)
                    x = start.x_in + ring * spacing_in * cos(angle)
                    y = start.y_in + ring * spacing_in * sin(angle)
                    yield StartPose(x, y, start.steering_rad, start.turret_rad)

    def _reach_in(self, start: StartPose) -> float:
        """From a start to the farthest corner of a room; without rooms there is no end."""
        corners = [corner for room in self._simulation.world.rooms for corner in room.corners_in]
        return max((hypot(x - start.x_in, y - start.y_in) for x, y in corners), default=inf)
