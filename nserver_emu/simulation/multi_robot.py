"""Several robots in one world: which may meet, in which order they advance, and where their sensors see one another.

Walkers are bodies like robots; their rows come after those of the robots.

    a span of at most SPAN_PS    a robot that cannot meet another moving one in it advances through it at once; robots
                                 that stand are obstacles
    half of it, ...              the same for the others
    every tick of TICK_PS        the remaining robots advance one after another, each against those near it: they never
                                 overlap
    a firing                     measures where the others were at the tick before, computed afterwards from their
                                 trajectories

Ticks are multiples of simulated time itself, so neither the positions nor the order depend on the caller's steps. The
first robot changes from tick to tick, so that none always has priority.

Bounds of the motion of a robot by direction, and a grid of the positions of all robots.

A simulated walker: a disc that walks along a route, and waits where a robot, an obstacle or a closed door is.

The position follows from the time spent walking, a whole number of picoseconds: it does not depend on the caller's
steps. Robots detect walkers as they detect one another (`RobotGroup`).
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, pairwise
from math import dist, floor, hypot
from typing import Final, NamedTuple, Protocol

import numpy as np

from nserver_emu.simulation.collision import Capsule, walls_within
from nserver_emu.simulation.segments import PS_PER_S, TIME_MAX_PS, to_s
from nserver_emu.simulation.visibility import PositionProvider, RobotPositions
from worlds.geometry import FloatArray
from worlds.world import Point, Walker

CELL_IN: Final = 40.0
"""Two robots wide: a search examines four cells, or nine."""


class SweptBounds(NamedTuple):
    """Bounds of a robot's displacement: the straight paths ahead and behind, (dx, dy), and the deviation, inches."""

    ahead_x: float
    ahead_y: float
    behind_x: float
    behind_y: float
    deviation_in: float

    def towards(self, x: float, y: float) -> float:
        """Return an upper bound of the approach to a far point in the direction (x, y), a unit vector; inches."""
        ahead, behind = self.ahead_x * x + self.ahead_y * y, self.behind_x * x + self.behind_y * y
        return max(ahead, behind, 0.0) + self.deviation_in


STATIONARY: Final = SweptBounds(0.0, 0.0, 0.0, 0.0, 0.0)
"""The bounds of a robot that does not move."""


Disc = tuple[float, float, float]
"""x, y, radius in inches."""


class SpatialHash:
    """Robots as discs in a grid of cells, by their numbers; none is ever removed."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[tuple[int, Disc]]] = {}
        self._max_radius_in = 0.0

    def add(self, number: int, disc: Disc) -> None:
        """Add a robot."""
        # A disc is stored in the cell of its centre; searches add the largest radius.
        x, y, radius = disc
        self._cells.setdefault((floor(x / CELL_IN), floor(y / CELL_IN)), []).append((number, disc))
        self._max_radius_in = max(self._max_radius_in, radius)

    def touched(self, x_in: float, y_in: float, radius_in: float) -> list[tuple[int, Disc]]:
        """Return the robots that a robot of this radius would touch there, sorted by their numbers."""
        return sorted((number, (x, y, radius))
                      for number, (x, y, radius) in self._around(x_in, y_in, radius_in + self._max_radius_in)
                      if hypot(x_in - x, y_in - y) - radius_in - radius <= 0.0)

    def _around(self, x_in: float, y_in: float, reach_in: float) -> Iterator[tuple[int, Disc]]:
        for column in range(floor((x_in - reach_in) / CELL_IN), floor((x_in + reach_in) / CELL_IN) + 1):
            for row in range(floor((y_in - reach_in) / CELL_IN), floor((y_in + reach_in) / CELL_IN) + 1):
                yield from self._cells.get((column, row), ())


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
        self._walls = walls
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
        walls, _ = walls_within(x, y, thin_in + abs(dx) + abs(dy), self._walls)
        return min(min((wall.free_fraction(x, y, dx, dy, thin_in) for wall in walls), default=1.0),
                   min((each.free_fraction(x, y, dx, dy, radius_in + GAP_IN) for each in self._obstacles), default=1.0))

    def set_walls(self, walls: FloatArray) -> None:
        """Replace the walls (m, 4), rows x1 y1 x2 y2 in inches."""
        self._walls = walls

    def set_obstacles(self, discs: Sequence[Disc]) -> None:
        """Replace the robots that are near, rows x y radius in inches."""
        self._obstacles = [Capsule.disc(*disc) for disc in discs]

    def set_positions(self, positions: PositionProvider, self_index: int) -> None:
        """Do nothing: a walker has no sensors."""

    def start_trajectory(self) -> None:
        """Start recording the path, for `disc_at`."""
        self._pieces = []


TICK_PS: Final = PS_PER_S // 100
"""A hundredth of a second: a robot at 20 in/s is detected at most 0.2 in from where it is, a fifth of a sonar's
resolution."""

SPAN_PS: Final = 12 * TICK_PS
"""Two firings of a ring at its default rate, where motion with noise is divided anyway."""

SLACK_IN: Final = 0.01
"""Robots that are not tested for contact stay at least this far apart: bumpers resolve 1e-3 in, rounding is 1e-11."""

Pair = tuple[int, int]
"""Rows of two robots, the smaller first."""

GroupState = tuple[tuple[int, tuple[Disc, ...]], ...]
"""The positions of all robots, by tick."""


class MovingBody(Protocol):
    """A disc that moves and stops at others: a robot or a walker."""

    @property
    def disc(self) -> Disc:
        """x, y, radius in inches."""

    def disc_at(self, instant_ps: int) -> Disc:
        """Return the disc at an instant since `start_trajectory`."""

    def max_travel_in(self, span_s: float) -> float:
        """Return an upper bound of the distance travelled within a time."""

    def swept_bounds(self, span_s: float) -> SweptBounds:
        """Return the same bound by direction; STATIONARY if it stands."""

    def advance_to(self, end_ps: int) -> None:
        """Advance to an instant."""

    def set_obstacles(self, discs: Sequence[Disc]) -> None:
        """Replace the other bodies that can be touched."""

    def set_positions(self, positions: PositionProvider, self_index: int) -> None:
        """Set the source of all positions; row `self_index` is this body."""

    def start_trajectory(self) -> None:
        """Start recording the path, for `disc_at`."""


class RobotGroup:
    """The robots of one world; provides their positions to their sensors."""

    def __init__(self) -> None:
        self._positions: dict[int, RobotPositions] = {}

    def to_state(self) -> GroupState:
        """Return the positions that sensors may still use."""
        return tuple((tick, tuple((x, y, radius) for x, y, radius in positions.discs.tolist()))
                     for tick, positions in self._positions.items())

    def set_state(self, state: GroupState, robots: Sequence[MovingBody]) -> None:
        """Continue from a state; raise ValueError if it is not one of these robots."""
        for tick, discs in state:
            if len(discs) != len(robots) or not all(radius > 0.0 for _, _, radius in discs):
                raise ValueError("positions of other robots")
            self._positions[tick] = RobotPositions(np.array(discs))
        if state:
            self._connect(robots)

    def at(self, instant_ps: int) -> RobotPositions:
        """Return the positions at the last tick before an instant; they are filled in when `advance` has ended."""
        tick = (instant_ps - 1) // TICK_PS
        positions = self._positions.get(tick)
        return self._positions.setdefault(tick, RobotPositions()) if positions is None else positions

    def set_bodies(self, bodies: Sequence[MovingBody], now_ps: int) -> None:
        """Replace the bodies; their current positions count from now on."""
        self._connect(bodies)
        self._positions = {(now_ps - 1) // TICK_PS: RobotPositions(discs_of(bodies))}

    def _connect(self, robots: Sequence[MovingBody]) -> None:
        for row, robot in enumerate(robots):
            robot.set_positions(self, row)
            robot.start_trajectory()

    def advance(self, robots: Sequence[MovingBody], begin_ps: int, end_ps: int) -> None:
        """Advance all robots from one instant to another."""
        while begin_ps < end_ps:
            until_ps = min(end_ps, begin_ps + SPAN_PS)
            _advance_span(robots, begin_ps, until_ps)
            self._fill_in(robots, until_ps)
            begin_ps = until_ps

    def _fill_in(self, robots: Sequence[MovingBody], now_ps: int) -> None:
        """Compute the positions that sensors have requested, and keep those that count until the next tick."""
        # The tick before now may still be used by firings until the next one.
        last = self.at(now_ps)
        for tick, positions in self._positions.items():
            if not len(positions.discs):
                positions.discs = discs_of(robots, tick * TICK_PS)
        self._positions = {(now_ps - 1) // TICK_PS: last}
        for robot in robots:
            robot.start_trajectory()


def discs_of(robots: Iterable[MovingBody], instant_ps: int | None = None) -> FloatArray:
    """Return robots as discs (n, 3), rows x y radius in inches, now or at an instant since the last span began."""
    if instant_ps is None:
        return np.array([robot.disc for robot in robots]).reshape(-1, 3)
    return np.array([robot.disc_at(instant_ps) for robot in robots])


def candidate_pairs(robots: Sequence[MovingBody], span_ps: int) -> list[Pair]:
    """Return the pairs that may meet within a span of time, sorted."""
    # Each disc is enlarged by the distance that its robot may travel.
    discs = discs_of(robots)
    span_s = to_s(span_ps)
    discs[:, 2] += [robot.max_travel_in(span_s) for robot in robots]
    pairs = neighbours(discs, SLACK_IN)
    # Walkers pass one another.
    first = next((row for row, body in enumerate(robots) if isinstance(body, SimulatedWalker)), len(robots))
    return [pair for pair in pairs if pair[0] < first] if first < len(robots) else pairs


def neighbours(discs: FloatArray, within_in: float) -> list[Pair]:
    """Return the pairs of discs (n, 3) whose gap is less than `within_in`, sorted.

    Sweep and prune: sorted by x, each is compared with the next, the one after the next ... until all of those are too
    far away.
    """
    # No pair whose x differ by more than this reach can be nearer than the gap.
    order = np.argsort(discs[:, 0])
    x, y, radius = discs[order].T
    reach = within_in + 2.0 * radius.max(initial=0.0)
    pairs: list[Pair] = []
    for apart in range(1, len(discs)):
        dx = x[apart:] - x[:-apart]
        if dx.min() >= reach:
            break
        gaps = np.hypot(dx, y[apart:] - y[:-apart]) - (radius[apart:] + radius[:-apart])
        first = np.flatnonzero(gaps < within_in)
        rows = np.sort(np.column_stack((order[first], order[first + apart])))
        pairs += [(row, other) for row, other in rows.tolist()]
    return sorted(pairs)


def update_obstacles(robots: Sequence[MovingBody], pairs: Iterable[Pair] | None = None) -> None:
    """Set the obstacles of the robots to the current positions of the others, for their bumpers.

    Parameters
    ----------
    pairs
        The pairs that can touch, if already computed; no other robots are updated then.
    """
    rows = range(len(robots)) if pairs is None else sorted({row for pair in pairs for row in pair})
    candidates = candidate_pairs(robots, 0) if pairs is None else pairs
    neighbours_of = _neighbours_of(_may_meet(robots, candidates, dict.fromkeys(rows, STATIONARY)))
    for row in rows:
        _set_obstacles(robots, row, neighbours_of.get(row, ()))


def _advance_span(robots: Sequence[MovingBody], begin_ps: int, end_ps: int) -> None:
    """Advance robots that cannot meet another at once, the others gradually."""
    # 1. Robots in no pair.
    pairs = candidate_pairs(robots, end_ps - begin_ps)
    for row in set(range(len(robots))).difference(*pairs):
        _set_obstacles(robots, row, ())
        robots[row].advance_to(end_ps)
    # 2. Moving robots in pairs. 3. Standing ones.
    _advance_pairs(robots, pairs, begin_ps, end_ps)
    for row in {row for pair in pairs for row in pair}:
        robots[row].advance_to(end_ps)
    # 4. The bumpers.
    update_obstacles(robots, pairs)


def _advance_pairs(robots: Sequence[MovingBody], pairs: Iterable[Pair], begin_ps: int, end_ps: int) -> None:
    """Advance the moving robots of the pairs; they can meet in no others. Standing robots may wait.

    A robot that may meet another moving one is held back: within a tick these take turns; in longer spans they advance
    through the first half and then the second, by the same rules.
    """
    # 1. Pairs of which at least one moves and that may meet, by the bounds of their motion.
    span_s = to_s(end_ps - begin_ps)
    bounds = {row: robots[row].swept_bounds(span_s) for row in {row for pair in pairs for row in pair}}
    moving = {row for row in bounds if bounds[row] is not STATIONARY}
    pairs = _may_meet(robots, [pair for pair in pairs if not moving.isdisjoint(pair)], bounds)
    neighbours_of = _neighbours_of(pairs)
    # 2. Robots that can only meet standing ones.
    held = {row for pair in pairs if moving.issuperset(pair) for row in pair}
    for row in moving - held:
        _advance_one(robots, row, neighbours_of.get(row, ()), end_ps)
    # 3. The others: halves of the span, divided at a tick ...
    ticks = range(begin_ps // TICK_PS + 1, -(-end_ps // TICK_PS))
    if held and ticks:
        left = [pair for pair in pairs if not held.isdisjoint(pair)]
        middle_ps = ticks[len(ticks) // 2] * TICK_PS
        _advance_pairs(robots, left, begin_ps, middle_ps)
        _advance_pairs(robots, left, middle_ps, end_ps)
        return
    # ... or, within one tick, one after another.
    first = begin_ps // TICK_PS % len(robots)
    for row in sorted(held, key=lambda row: (row < first, row)):
        _advance_one(robots, row, neighbours_of[row], end_ps)


def _advance_one(robots: Sequence[MovingBody], row: int, others: Iterable[int], end_ps: int) -> None:
    """Advance one robot while the others stand."""
    _set_obstacles(robots, row, others)
    robots[row].advance_to(end_ps)


def _set_obstacles(robots: Sequence[MovingBody], row: int, others: Iterable[int]) -> None:
    robots[row].set_obstacles([robots[other].disc for other in others])


def _may_meet(robots: Sequence[MovingBody], pairs: Iterable[Pair], bounds: Mapping[int, SweptBounds]) -> list[Pair]:
    """Return the pairs that may meet if each robot moves within its bounds."""
    met: list[Pair] = []
    for row, other in pairs:
        (x, y, radius), (other_x, other_y, other_radius) = robots[row].disc, robots[other].disc
        dx, dy = other_x - x, other_y - y
        distance = hypot(dx, dy)
        gap = distance - radius - other_radius - SLACK_IN
        if gap > 0.0:
            dx, dy = dx / distance, dy / distance
            gap -= bounds[row].towards(dx, dy) + bounds[other].towards(-dx, -dy)
        if gap <= 0.0:
            met.append((row, other))
    return met


def _neighbours_of(pairs: Iterable[Pair]) -> dict[int, list[int]]:
    """Return the partners of each row in the pairs, in their order."""
    partners: dict[int, list[int]] = {}
    for row, other in pairs:
        partners.setdefault(row, []).append(other)
        partners.setdefault(other, []).append(row)
    return partners
