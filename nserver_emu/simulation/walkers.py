"""A simulated walker: a disc that walks along a route, and waits where a robot, an obstacle or a closed door is.

The position follows from the time spent walking, a whole number of picoseconds: it does not depend on the caller's
steps. Robots detect walkers as they detect one another (multi_robot.py).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate, pairwise
from math import dist
from typing import Final, NamedTuple

from nserver_emu.simulation.collision import Capsule, WallSet
from nserver_emu.simulation.segments import PS_PER_S, TIME_MAX_PS
from nserver_emu.simulation.spatial_hash import Disc, SweptBounds
from nserver_emu.simulation.visibility import PositionProvider
from worlds.geometry import FloatArray
from worlds.world import Point, Walker

GAP_IN: Final = 4.0
"""Walkers stop this far from a robot: they do not bump into it. A robot may come nearer."""
WALL_FRACTION: Final = 0.5
"""Fraction of the radius that walls must leave free: people pass narrow doors with a shoulder first."""
MIN_LEG_PS: Final = PS_PER_S // 1000
"""Shortest time for a leg of a route: bounds the work of a step."""


class WalkerState(NamedTuple):
    """The state of a walker in a snapshot: time spent walking."""

    walked_ps: int


class SimulatedWalker:
    """A walker in a world; implements `MovingBody`."""

    def __init__(self, walker: Walker, walls: FloatArray, now_ps: int = 0) -> None:
        self.walker = walker
        self._time_ps = now_ps
        self._walked_ps = 0
        self._walls = WallSet(walls)
        self._obstacles: list[Capsule] = []
        # Since `start_trajectory`: begin of a piece of time, and the time spent walking before and after it.
        self._pieces: list[tuple[int, int, int]] = []
        # Corners of one round, and the times at which they are reached.
        points = walker.points_in
        self._corners = [*points, points[0]] if walker.is_closed else [*points, *points[-2::-1]]
        legs_s = [dist(*leg) / walker.speed_in_s for leg in pairwise(self._corners)]
        # A leg may take longer than simulated time lasts; Python's whole numbers do not overflow.
        legs_ps = (round(min(max(leg_s * PS_PER_S, MIN_LEG_PS), TIME_MAX_PS)) for leg_s in legs_s)
        self._reached_ps = list(accumulate(legs_ps, initial=0))

    def to_state(self) -> WalkerState:
        """Return all that changes."""
        return WalkerState(self._walked_ps)

    def set_state(self, state: WalkerState) -> None:
        """Continue from a state; raise ValueError if no walker has it."""
        if state.walked_ps < 0:
            raise ValueError("a walker that has walked for less than no time")
        self._walked_ps = state.walked_ps

    @property
    def disc(self) -> Disc:
        """The walker as an obstacle: x, y, radius in inches."""
        return (*self._position(self._walked_ps), self.walker.radius_in)

    def disc_at(self, instant_ps: int) -> Disc:
        """Return the disc at an instant since `start_trajectory`."""
        walked_ps = self._walked_ps
        for begin_ps, before_ps, until_ps in reversed(self._pieces):
            walked_ps = min(before_ps + max(instant_ps - begin_ps, 0), until_ps)
            if begin_ps <= instant_ps:
                break
        return (*self._position(walked_ps), self.walker.radius_in)

    def max_travel_in(self, span_s: float) -> float:
        """Return an upper bound of the distance walked within a time, and the gap to robots, inches."""
        return self.walker.speed_in_s * span_s + GAP_IN

    def swept_bounds(self, span_s: float) -> SweptBounds:
        """Return the same bound in every direction: a route may turn."""
        return SweptBounds(0.0, 0.0, 0.0, 0.0, self.max_travel_in(span_s))

    def advance_to(self, end_ps: int) -> None:
        """Walk until an instant that is not before the current one, as far as the route is free."""
        while self._time_ps < end_ps:
            # 1. The next piece of the route, at most to the next corner.
            round_ps = self._walked_ps % self._reached_ps[-1]
            leg_end_ps = self._reached_ps[bisect_right(self._reached_ps, round_ps)]
            piece_ps = min(end_ps - self._time_ps, leg_end_ps - round_ps)
            # 2. As much of it as is free. A walker that is stopped waits.
            before_ps = self._walked_ps
            free = self._free_fraction(self._position(before_ps), self._position(before_ps + piece_ps))
            is_stopped = free < 1.0
            self._walked_ps += int(free * piece_ps) if is_stopped else piece_ps
            self._pieces.append((self._time_ps, before_ps, self._walked_ps))
            self._time_ps = end_ps if is_stopped else self._time_ps + piece_ps

    def _position(self, walked_ps: int) -> Point:
        """Return the position after so much time of walking."""
        round_ps = walked_ps % self._reached_ps[-1]
        leg = bisect_right(self._reached_ps, round_ps) - 1
        begin_ps, end_ps = self._reached_ps[leg : leg + 2]
        fraction = (round_ps - begin_ps) / (end_ps - begin_ps)
        (x1, y1), (x2, y2) = self._corners[leg : leg + 2]
        return x1 + fraction * (x2 - x1), y1 + fraction * (y2 - y1)

    def _free_fraction(self, start: Point, end: Point) -> float:
        """Return the fraction of a straight path that is free; 1 or more: all of it."""
        (x, y), radius_in = start, self.walker.radius_in
        dx, dy = end[0] - x, end[1] - y
        thin_in = WALL_FRACTION * radius_in
        walls, _ = self._walls.within(x, y, thin_in + abs(dx) + abs(dy))
        return min(
            min((wall.free_fraction(x, y, dx, dy, thin_in) for wall in walls), default=1.0),
            min((each.free_fraction(x, y, dx, dy, radius_in + GAP_IN) for each in self._obstacles), default=1.0),
        )

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4), rows x1 y1 x2 y2 in inches."""
        self._walls = WallSet(walls)

    def set_obstacles(self, discs: Sequence[Disc]) -> None:
        """Replace the robots that are near, rows x y radius in inches."""
        self._obstacles = [Capsule.disc(*disc) for disc in discs]

    def set_positions(self, positions: PositionProvider, self_index: int) -> None:
        """Do nothing: a walker has no sensors."""

    def start_trajectory(self) -> None:
        """Start recording the path, for `disc_at`."""
        self._pieces = []

