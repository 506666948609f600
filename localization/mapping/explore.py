"""Exploration: where a robot that maps a room should drive next.

    echoes --> grid of free cells --> cells the robot can reach --> places worth visiting --> path to the best one

A cell is free where sound or the robot has been: along the path of each explained echo, within half of its cone, and
within the circle about each pose that is as large as the shortest reading of a turn of the ring. The grid is made anew
for each leg, from the map as it is.

    place        worth            where
    frontier     much             free cells beside unknown ones that no wall explains, by how much is unknown
    open end     much             6 in beyond the end of a wall, 18 in in front of it, and on along the wall
    span         much             18 in before the middle of two points between which it is open whether there is a wall
    vertex       then             around a point at which fewer than two walls end, where the robot has not looked from
    coverage     then             cells farther than 20 in from where the robot has been
    corner       last             5 in beside both walls of a corner: there ranges tell the offset of all sonars apart
                                  from the size of the room

Worth is divided by the time to get there; coverage and corners wait while there may be a room to enter. The path to a
frontier goes on through it, slowly and as far as cones show it to be free. Done when nothing is worth it any more; the
last leg is straight, since a turn leaves the heading uncertain.

References
----------
Yamauchi, A Frontier-Based Approach for Autonomous Exploration (1997). Quinlan, Khatib, Elastic Bands (1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from math import dist, hypot, inf
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats, wrap_angle
from localization.mapping.association import MapEstimate
from localization.mapping.live import LiveMapper, passed, walls_and_posts, with_openings
from localization.mapping.problem import NO_FEATURE, sensors_at
from localization.mapping.spans import POINT_ON_LINE_IN, pass_through, uncrossed_spans
from localization.mapping.survey import REVERSE_RAD, Geofence, Plan, Point
from localization.mapping.walls import ON_LINE_IN, Piece, extract_walls, free_paths
from localization.navigation.path import angle_difference, wall_distances
from localization.navigation.roadmap import segment_clearances
from nclient.errors import install_command
from worlds.geometry import crossings, nearest_points
from worlds.map_files import MapsExtraMissing
from worlds.raycast_arrays import cast_rays

Mask = npt.NDArray[np.bool_]

CELL_IN: Final = 2.0
BORDER_IN: Final = 30.0
SAMPLE_IN: Final = 2.0
FAN_RAD: Final = np.radians((-6.0, -3.0, 0.0, 3.0, 6.0))
"""Directions about the path of an echo that are free as well: half of the cone."""
SHORTENED: Final = 0.95
"""Of the range, so far the sector is free."""
CLEAR_IN: Final = 7.0
"""Space from which a path costs no more: nearer than 6 in sonars measure nothing, and the robot drives slowly."""
PASSED_IN: Final = 1.5
"""Walls nearer to the path than the body less this, for errors of the map, are doors: the robot has passed them."""
TIGHT: Final = 4.0
"""Cells beside a wall cost so many times more; half of that halfway."""
EXACT_IN: Final = 4.0
"""Space to walls is exact where it differs by less from the least space: that of cells is wrong by up to 3 in."""
MARGIN_IN: Final = 1.2
"""Least space between body and walls: a gap of 24 in leaves 2.3 in at each side, and cells are 2 in wide. Straight
lines and the controller take some tenths of it, and the guard stops at `survey.MAP_MARGIN_IN`, or beside one wall that
is too near to measure at `survey.BESIDE_MARGIN_IN`."""
COMFORT_IN: Final = 4.0
"""Space of places to look from, and of the last leg."""
WALL_SHADOW_IN: Final = 5.0
"""Unknown cells this near to a wall are its own."""
UNKNOWN_IN: Final = 8.0
"""The robot's axis stays this far from unknown cells that no wall explains: nearer, something may block it."""
CIRCLE_IN, MAX_CIRCLE_IN, SAME_POSE_IN = 2.0, 60.0, 4.0
"""Subtracted from the shortest range of a turn, for noise and motion; the largest circle; and one in such a square."""
NEAR_ECHO_IN, ECHO_SHADOW_IN = 36.0, 4.0
"""Unknown cells this near to the end of an echo that is shorter than this hide a wall that is not in the map yet: the
ends of longer echoes spread over the width of a door."""
MIN_FRONTIER_CELLS: Final = 7
"""14 in: more than the slits between echoes, less than a door."""
BEHIND_CELLS, MIN_SIZE, MAX_SIZE = 400.0, 0.25, 1.6
"""Unknown cells within SIGHT_IN behind a frontier that is worth as much as others, half of a half disc; and bounds of
its worth. A niche between furniture has few, a door to a room that was not entered has many."""
LOOK_IN, SIGHT_IN = 18.0, 44.0
"""A frontier is looked at from such distances: a wall nearer than 6 in to the body cannot be measured."""
END_AHEAD_IN, END_ASIDE_IN = 6.0, 18.0
ALONG_WALL_IN: Final = 48.0
"""The path to an open end goes on along the wall for this far, as long as it is free."""
VERTEX_IN: Final = 17.0
VERTEX_DIRECTIONS, VERTEX_SEEN_IN = 8, 30.0
"""Directions from which a vertex is looked at, and how far off the robot may have been there."""
CORNER_IN: Final = 5.0
"""Space beside the body at a corner: nearer ranges are more accurate, and as near the sonars still measure."""
NEAR_CORNER_IN, CORNER_NODES = 10.0, 24
"""So many half seconds this near to its place, and a corner is measured well enough."""
NEAR_WALL_END_IN: Final = 4.0
COVERAGE_IN: Final = 20.0
VISITED_IN: Final = 7.0
"""A place nearer than this to the path has been visited."""
HERE_IN: Final = 3.0
"""Where the robot stands it has measured: a place that remains needs the next solution of the map."""
REACH_CELLS_IN: Final = 6.0
"""A place is exchanged for the nearest cell within this distance that the robot can reach."""
MIN_FREE_IN: Final = 1.2
"""A leg that begins with less free distance is blocked at once."""
SAME_PLACE_IN: Final = 0.5
ESCAPE_IN: Final = 8.0
"""Then the robot drives back by this much: the edge of a wall that reflects little may be near in other directions."""
AHEAD_IN, BLOCKED_S = 3.0, 60.0
"""Distance from the body to what blocked a leg, and how long it counts."""
SAME_DIRECTION_RAD: Final = 0.3
"""A leg that was blocked is not tried again nearer to its direction than this."""
SAME_HIT_IN: Final = 5.0
"""Two rays that end nearer to each other hit the same thing; one alone may be a bad reading."""
MAX_REVISIONS: Final = 2
START_LEG_IN: Final = 30.0
START_TURN_IN: Final = 5.0
"""Of a first leg: a turn of 1 rad counts as 5 in."""
FIRST_ROUNDS: Final = 2
LAST_LEG_IN: Final = 24.0
LAST_LEG_S: Final = 15.0
TURN_RAD_S, TURN_BASE_IN = 0.5, 16.0
"""Speed of turns, and the cost of the part of a path that gives its first direction."""
MAX_TURNS_COMPARED: Final = 12
SETTLE_S: Final = 4.0
"""Added to the time to a place: near places are not visited one after the other for ever."""
WORTH: Final = {"frontier": 1.5, "end": 3.0, "span": 2.0, "vertex": 1.0, "coverage": 0.6, "corner": 0.1}
MEASURING_PACE, DRIVEN_FRACTION, LONG_IN = 2.0 / 3.0, 0.7, 80.0
"""Paths are driven at this fraction of the top speed, and at the top speed while there may be a room to enter, where at
least the second fraction of the path has been driven before, and if the path is longer than the third."""
MAX_TRIES: Final = {"frontier": 8, "end": 2, "span": 2, "vertex": 2, "coverage": 2, "corner": 4}
SAME_FRONTIER_IN, STAY = 12.0, 1.5
"""Frontiers nearer to one another are one; that to which the robot is driving is worth so many times more, or it turns
back and forth between two."""
AGAIN_S, MAX_TRIES_EVER = 90.0, 16
"""A frontier that was tried in vain is tried again after this time, and so often at most."""
SAME_GOAL_IN, MAX_LOOKS = 5.0, 2
"""A frontier is looked at from cells this near to one another so often: in a door it recedes as the robot proceeds."""
SEEN_AT_ONCE: Final = 64
"""Cells that are tested at once for whether a frontier is in sight: mostly one of the nearest is."""
ROOM_SIZE: Final = 1.2
"""Size of a frontier behind which there may be a room."""
CORNER_REST_IN, BESIDE_LINE_IN = 36.0, 0.01
"""Walls probably go on to a corner that is this near."""
ONWARD_IN: Final = 24.0
"""The path to a frontier goes on behind it for this far, as long as sonars show it to be free."""
MAX_SHORTENED: Final = 3
"""Frontiers that are left out at one decision, since something is before them."""
BLOCKED_TRIES: Final = 2
"""A leg that was blocked counts as so many."""


@dataclass(slots=True)
class Place:
    """A place worth visiting, in inches."""

    kind: str
    x_in: float
    y_in: float
    size: float = 1.0
    """Of a frontier: the unknown area behind it by BEHIND_CELLS, within limits."""
    seen_from_in: Point = (inf, inf)
    """The cell to which the robot drives for it."""
    tried_s: float = 0.0
    """When it was tried."""
    along: Point = (0.0, 0.0)
    """Direction in which the wall of an open end may go on."""


@dataclass(slots=True)
class Grid:
    """Cells of CELL_IN: which are free, how far each is from a wall, and which the robot can reach at what cost.

    `driven` are the cells of the path so far, `echo_in` is the distance to the ends of short echoes.
    """

    low: Floats
    free: Mask
    space: Floats
    walls: Floats
    echoed: Mask
    driven: Mask = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    echo_in: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    cost: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    before: npt.NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))

    def cells(self, points: Floats) -> npt.NDArray[np.intp]:
        """Return rows and columns (n, 2) of points (n, 2), limited to the grid."""
        index = np.floor((points - self.low) / CELL_IN).astype(np.intp)
        limited: npt.NDArray[np.intp] = np.clip(index, 0, np.array(self.free.shape) - 1)
        return limited

    def centres(self, cells: npt.NDArray[np.intp]) -> Floats:
        """Return the centres (n, 2) of cells (n, 2)."""
        return self.low + (cells + 0.5) * CELL_IN

    def square(self, centre: Floats, half_in: float) -> tuple[slice, slice]:
        """Return the rows and columns of the cells in a square about a point (2,)."""
        low = np.floor((centre - half_in - self.low) / CELL_IN).astype(int)
        high = np.floor((centre + half_in - self.low) / CELL_IN).astype(int) + 1
        rows, columns = (slice(max(a, 0), max(b, 0)) for a, b in zip(low.tolist(), high.tolist(), strict=True))
        return rows, columns

    @property
    def reached(self) -> Mask:
        """Cells that the robot can reach."""
        return np.isfinite(self.cost)


class _ReachedCells:
    """The cells (n, 2) of a grid that the robot can reach, numbered, and what is known of each."""

    def __init__(self, grid: Grid, reached: npt.NDArray[np.intp]) -> None:
        at = reached[:, 0], reached[:, 1]
        self.centres, self.costs = grid.centres(reached), grid.cost[at]
        self.space, self.echo_in = grid.space[at], grid.echo_in[at]
        self._numbers = np.full(grid.free.shape, -1, dtype=np.intp)
        self._numbers[at] = np.arange(len(reached))

    def about(self, grid: Grid, centre: Floats, radius_in: float) -> tuple[npt.NDArray[np.intp], Floats]:
        """Return the numbers (k,) of the cells within a radius of a point (2,), and their distances (k,) from it."""
        rows = self._numbers[grid.square(centre, radius_in)].ravel()
        rows = rows[rows >= 0]
        away = np.hypot(*(self.centres[rows] - centre).T)
        is_within = away < radius_in
        return rows[is_within], away[is_within]


class _Choice(NamedTuple):
    """A place to drive to: what it is worth, the time to get there, and the cell (2,) from which it is looked at."""

    place: Place
    worth: float
    seconds: float
    cell: npt.NDArray[np.intp]


class _Finished:
    """A finished map, as far as the grid needs one."""

    def __init__(self, estimate: MapEstimate) -> None:
        self.estimate: MapEstimate | None = estimate
        self.recent: MapEstimate | None = None
        self.poses, self.pieces = estimate.state.poses, extract_walls(estimate, with_accuracy=False)
        self.walls = walls_and_posts(with_openings(estimate, self.pieces))


class _Solution:
    """Results of a solution of the map, computed once: walls, paths of sound, and places that depend on it alone."""

    def __init__(self, mapper: LiveMapper | _Finished | None = None) -> None:
        self.estimate = None if mapper is None else mapper.estimate
        self.pieces: list[Piece] = []
        self.paths: tuple[Floats, Floats] = np.zeros((0, 2)), np.zeros((0, 2))
        self.places: list[Place] | None = None
        if mapper is not None and mapper.estimate is not None:
            self.pieces, self.paths = mapper.pieces, free_paths(mapper.estimate)


class Explorer:
    """Chooses where to drive; a driver of `survey`.

    Parameters
    ----------
    body_in
        Radius of the robot.
    speed_in_s
        Top speed.
    time_limit_s
        The last leg begins before it.
    fence
        Where the robot must stay.
    """

    def __init__(self, body_in: float, speed_in_s: float, time_limit_s: float, fence: Geofence | None = None) -> None:
        try:
            import scipy.ndimage
            import scipy.sparse.csgraph
        except ImportError as error:
            raise MapsExtraMissing(f"exploring needs scipy: {install_command('maps')}") from error
        self._image: Any = scipy.ndimage
        self._sparse: Any = scipy.sparse
        self._graph: Any = scipy.sparse.csgraph
        self._body_in, self._speed_in_s, self._fence = body_in, speed_in_s, fence
        self._time_limit_s = time_limit_s
        self.blocked: dict[Point, float] = {}
        """Points at which something blocked a leg, and when, in seconds."""
        self._tried: list[Place] = []
        self._before: Place | None = None
        self._clock_s = 0.0
        self._place: Place | None = None
        self._is_blocked = self._is_undecided = self._is_stuck = self._is_fast = self._is_going_back = False
        self._blocked_at: Point = inf, inf
        self._blocked_legs: list[tuple[float, Point, float]] = []
        """When legs were blocked, where, and in which directions."""
        self._revisions = 0
        self._free_directions: list[float] = []
        self._is_last = self._may_have_rooms = False
        self._optional_in = 0.0
        self._solution = _Solution()
        self.places: list[Place] = []
        """Places worth visiting at the last decision: what is open when the drive ends."""

    # The driver.

    def leg(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> Plan | None:
        """Return the next path."""
        self._optional_in = 0.0
        points = self._points(clock_s, pose, mapper, free_in)
        return None if points is None else Plan(points, self._pace, self._optional_in, waits=False)

    def _points(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> list[Point] | None:
        self._clock_s = clock_s
        path = None if self._is_last else self._free_path(clock_s, pose, mapper, free_in)
        was_blocked, self._is_blocked = self._is_blocked, False
        if path and was_blocked and not self._is_last:
            direction = float(np.arctan2(path[0][1] - pose[1], path[0][0] - pose[0]))
            if self._is_stuck or free_in(direction) < MIN_FREE_IN:
                # The same reading would block this leg as well: first away from what is near.
                self._place = None
                back = [] if self._is_going_back else self._leg_back(pose, mapper.poses)
                self._is_going_back = bool(back)
                self._optional_in = 0.0
                return back or self._free_leg(pose, free_in, ESCAPE_IN)
        self._is_going_back = False
        return path

    @property
    def _pace(self) -> float:
        """Fraction of the top speed for the leg: less where walls are to be measured, as short ones get few echoes."""
        is_fast = self._is_fast or self._may_have_rooms
        return 1.0 if self._place is not None and is_fast else MEASURING_PACE

    def _leg_back(self, pose: Floats, poses: Floats) -> list[Point]:
        """Return a leg to where the robot was ESCAPE_IN ago: there is nothing on it; none at the beginning."""
        far = np.flatnonzero(np.hypot(*(poses[:, :2] - pose[:2]).T) > ESCAPE_IN)
        return [(float(poses[far[-1], 0]), float(poses[far[-1], 1]))] if len(far) else []

    def _free_path(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> list[Point] | None:
        """Return a path, to a frontier that was looked at only as far as the sonars show its beginning to be free.

        There is a wall beside unknown cells as often as a door, and a leg that is blocked takes seconds.
        """
        path = self._chosen_leg(clock_s, pose, mapper, free_in)
        for _ in range(MAX_SHORTENED):
            place = self._place
            if not path or place is None or place.kind != "frontier" or not self._tries(place):
                break
            off = np.array(path[0]) - pose[:2]
            length = float(np.hypot(*off))
            free = free_in(float(np.arctan2(off[1], off[0])))
            if free > length:
                break
            self._optional_in = 0.0
            if free > HERE_IN:
                x, y = (pose[:2] + free / length * off).tolist()
                return [(x, y)]
            self._add_tries(place, BLOCKED_TRIES)
            self._place = None
            path = self._chosen_leg(clock_s, pose, mapper, free_in)
        return path

    def _chosen_leg(
        self, clock_s: float, pose: Floats, mapper: LiveMapper, free_in: Callable[[float], float]
    ) -> list[Point] | None:
        # 1. At first where the sonars show the longest free distance, so that there is something to measure.
        if mapper.rounds < FIRST_ROUNDS:
            first = self._free_leg(pose, free_in, START_LEG_IN)
            self._free_directions.append(float(np.arctan2(first[0][1] - pose[1], first[0][0] - pose[0])))
            return first
        path: list[Point] | None = None
        while clock_s < self._time_limit_s - LAST_LEG_S:
            path = self._next_path(self._grid(mapper, pose), mapper, pose)
            if self._is_undecided and mapper.recent is not None:
                # In a door: the echoes from beyond it make walls there, and free cells before them.
                mapper.solve()
                path = self._next_path(self._grid(mapper, pose), mapper, pose)
            if path is not None or self._revisions == MAX_REVISIONS:
                break
            # Nothing left to do: with the map revised, without what has blocked legs, and at frontiers before rooms
            # that were tried, there may be.
            self._revisions += 1
            self._tried = [place for place in self._tried if place.kind != "frontier" or place.size < ROOM_SIZE]
            mapper.revise()
            self._solution = _Solution()
            self.blocked.clear()
            self._blocked_legs.clear()
        # 2. At the end a straight leg.
        if path is None:
            self._is_last = True
            self._place = None
            return self._last_leg(pose, mapper)
        return path

    def _free_leg(self, pose: Floats, free_in: Callable[[float], float], most_in: float) -> list[Point]:
        """Return a straight leg in the direction with the longest free distance, less a distance for the turn."""
        best, chosen = -np.inf, (0.0, 0.0)
        turns = np.linspace(-np.pi, np.pi, 16, endpoint=False)
        is_open = np.array([not self._was_blocked(pose, float(pose[2] + turn)) for turn in turns])
        for turn in turns[is_open] if is_open.any() else turns:
            length = min(free_in(float(pose[2]) + float(turn)), most_in)
            # Backwards is no turn.
            cost = START_TURN_IN * min(abs(turn), np.pi - abs(turn))
            been = sum(abs(angle_difference(other, float(pose[2] + turn))) < 1.0 for other in self._free_directions)
            if length - cost - 6.0 * been > best:
                best, chosen = length - cost - 6.0 * been, (float(pose[2] + turn), length)
        direction, length = chosen
        return [(float(pose[0]) + length * np.cos(direction), float(pose[1]) + length * np.sin(direction))]

    def _was_blocked(self, pose: Floats, direction_rad: float) -> bool:
        """Return True if a leg was blocked near here, in about this direction, not long ago.

        What blocked it (`blocked`) need not be ahead: beside a wall that is too near to measure, the guard ends a leg
        after some inches, however far it is free.
        """
        return any(
            self._clock_s - since_s < BLOCKED_S and dist(place, pose[:2]) < ESCAPE_IN
            and abs(angle_difference(blocked_rad, direction_rad)) < SAME_DIRECTION_RAD
            for since_s, place, blocked_rad in self._blocked_legs
        )  # fmt: skip

    def end_leg(self, pose: Floats, reason: str, direction_rad: float = 0.0) -> None:
        """Record what blocked a leg, ahead of the body, and which place was tried."""
        self._is_blocked = bool(reason)
        if reason:
            reach = self._body_in + AHEAD_IN
            # Twice at the same place: beside a wall too near to measure only the leg back is left.
            self._is_stuck = dist(self._blocked_at, pose[:2]) < SAME_PLACE_IN
            self._blocked_at = float(pose[0]), float(pose[1])
            self._blocked_legs.append((self._clock_s, self._blocked_at, direction_rad))
            x, y = pose[:2] + reach * np.array((np.cos(direction_rad), np.sin(direction_rad)))
            self.blocked[float(x), float(y)] = self._clock_s
        if self._place is not None:
            self._add_tries(self._place, BLOCKED_TRIES if reason else 1)
        self._before = None if reason else self._place
        self._place = None

    def unexplored(self, estimate: MapEstimate) -> Floats:
        """Return the frontiers (n, 2) of a finished map that are in sight of where the robot was."""
        finished = _Finished(estimate)
        grid = self._grid(finished, finished.poses[-1])
        reached = np.argwhere(grid.reached)
        centres = grid.centres(reached)
        space = grid.space[reached[:, 0], reached[:, 1]]
        comfortable = centres[space > self._body_in + COMFORT_IN]
        found = []
        for frontier in self._frontiers(grid)[:, :2]:
            near = comfortable[np.hypot(*(comfortable - frontier).T) < SIGHT_IN]
            if len(near) and not _crossed(near, frontier, grid.walls).all():
                found.append(frontier)
        return np.array(found).reshape(-1, 2)

    # The grid.

    def _grid(self, mapper: LiveMapper | _Finished, pose: Floats) -> Grid:
        """Return the grid of the map as it is."""
        # Walls as far as they were seen, and as far as their corners.
        if self._solution.estimate is not mapper.estimate:
            self._solution = _Solution(mapper)
        ends = np.array([piece.ends.reshape(4) for piece in self._solution.pieces]).reshape(-1, 4)
        positions = mapper.poses[:, :2]
        walls = passed(np.concatenate((mapper.walls, ends)), positions, self._body_in - PASSED_IN)
        everything = np.concatenate((walls.reshape(-1, 2), positions, pose[None, :2]))
        low = everything.min(axis=0) - BORDER_IN
        shape = np.ceil((everything.max(axis=0) + BORDER_IN - low) / CELL_IN).astype(int)
        nowhere = np.zeros(tuple(shape), dtype=np.bool_)
        grid = Grid(low, nowhere.copy(), np.full(tuple(shape), np.inf), walls, nowhere)
        # 1. Where sound went: in the map, and since it was solved.
        for estimate in (mapper.estimate, mapper.recent):
            if estimate is not None:
                self._mark_sectors(grid, self._solution.paths if estimate is mapper.estimate else free_paths(estimate))
                self._mark_echoes(grid, estimate)
                self._mark_circles(grid, estimate)
        grid.echo_in = np.full(grid.free.shape, np.inf)
        if grid.echoed.any():
            grid.echo_in = self._image.distance_transform_edt(~grid.echoed, sampling=CELL_IN)
            grid.echoed = grid.echo_in <= ECHO_SHADOW_IN
        # 2. Where the robot was.
        driven = grid.cells(_dense(np.concatenate((positions, pose[None, :2]))))
        grid.driven = np.zeros(grid.free.shape, dtype=np.bool_)
        grid.driven[driven[:, 0], driven[:, 1]] = True
        grid.free |= self._image.distance_transform_edt(~grid.driven, sampling=CELL_IN) <= self._body_in
        # Slits between neighbouring echoes.
        grid.free |= self._image.binary_closing(grid.free, iterations=2)
        # 3. Space to the walls, exact where it matters. What blocked a leg where the robot has been is gone, and a bad
        # reading in a door must not close it for ever.
        been = positions if len(positions) else pose[None, :2]
        self.blocked = {
            point: since_s for point, since_s in self.blocked.items()
            if self._clock_s - since_s < BLOCKED_S and np.hypot(*(been - point).T).min() > self._body_in
        }  # fmt: skip
        hits = [_unexplained_hits(estimate) for estimate in (mapper.estimate, mapper.recent) if estimate is not None]
        spots = passed(_posts(np.concatenate(hits)), been, self._body_in) if hits else np.zeros((0, 4))
        grid.walls = obstacles = np.concatenate((walls, self._blocks(), spots))
        if len(obstacles):
            marks = np.zeros(grid.free.shape, dtype=np.bool_)
            samples = np.concatenate([_samples(row) for row in obstacles])
            at = grid.cells(samples)
            marks[at[:, 0], at[:, 1]] = True
            grid.space = self._image.distance_transform_edt(~marks, sampling=CELL_IN)
            near = np.argwhere(grid.free & (np.abs(grid.space - self._body_in - MARGIN_IN) < EXACT_IN))
            if len(near):
                grid.space[near[:, 0], near[:, 1]] = wall_distances(grid.centres(near), obstacles)
        self.find_reach(grid, pose)
        return grid

    def _blocks(self) -> Floats:
        """Return what blocked legs, as short segments (n, 4)."""
        return _posts(np.array(list(self.blocked)).reshape(-1, 2))

    def _mark_sectors(self, grid: Grid, paths: tuple[Floats, Floats]) -> None:
        """Mark the sectors about paths of sound, of starts and ends (p, 2), to the spots that reflected it."""
        starts, ends = paths
        span = ends - starts
        length, angle = np.hypot(span[:, 0], span[:, 1]), np.arctan2(span[:, 1], span[:, 0])
        keep = length > SAMPLE_IN
        starts, length, angle = starts[keep], length[keep], angle[keep]
        if not len(starts):
            return
        steps = np.arange(0.0, float(length.max()), SAMPLE_IN)
        for fan in FAN_RAD:
            reach = length if not fan else SHORTENED * length
            along = np.stack((np.cos(angle + fan), np.sin(angle + fan)), axis=-1)
            number, step = np.nonzero(steps[None, :] < reach[:, None])
            at = grid.cells(starts[number] + steps[step, None] * along[number])
            grid.free[at[:, 0], at[:, 1]] = True

    def _mark_echoes(self, grid: Grid, estimate: MapEstimate) -> None:
        """Mark the cells at the ends of short echoes that the map does not explain: something is there."""
        state, trajectory = estimate.state, estimate.problem.trajectory
        echoes = estimate.echoes()
        is_open = estimate.assignment.feature[echoes] == NO_FEATURE
        echoes = echoes[is_open & (trajectory.readings_in[echoes] < NEAR_ECHO_IN)]
        sensors = sensors_at(state.poses, state.parameters, trajectory, echoes)
        along = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
        at = grid.cells(sensors.face + sensors.range_in[:, None] * along)
        grid.echoed[at[:, 0], at[:, 1]] = True

    def _mark_circles(self, grid: Grid, estimate: MapEstimate) -> None:
        """Mark the circles that the shortest readings of a turn of the ring leave free."""
        trajectory, count = estimate.problem.trajectory, len(estimate.state.poses)
        # From the node: the sonars stand on a ring about it.
        reach = trajectory.readings_in + np.hypot(*trajectory.mounts.T)
        shortest = np.full(count, np.inf)
        np.minimum.at(shortest, trajectory.node, reach)
        shortest[trajectory.is_too_near[:count]] = 0.0
        # A turn of the ring is two nodes; one more at either side for what a bad reading hides.
        turn = np.minimum.reduce([np.roll(shortest, shift) for shift in (-1, 0, 1)])
        radii = np.minimum(turn - CIRCLE_IN, MAX_CIRCLE_IN)
        # Of the poses in a square the one with the largest circle.
        order = np.argsort(-radii, kind="stable")
        _, first_of = np.unique(np.floor(estimate.state.poses[order, :2] / SAME_POSE_IN), axis=0, return_index=True)
        largest = order[first_of]
        for (x, y), radius in zip(estimate.state.poses[largest, :2], radii[largest].tolist(), strict=True):
            if not radius > self._body_in:
                continue
            first, last = grid.cells(np.array(((x - radius, y - radius), (x + radius, y + radius))))
            cells = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(first, last, strict=True)),
                                         indexing="ij"), axis=-1).reshape(-1, 2)  # fmt: skip
            inside = np.hypot(*(grid.centres(cells) - (x, y)).T) < radius
            grid.free[cells[inside, 0], cells[inside, 1]] = True

    def find_reach(self, grid: Grid, pose: Floats) -> None:
        """Find the cells that the robot can reach, and the cheapest paths to them."""
        passable = grid.free & (grid.space >= self._body_in + MARGIN_IN)
        unknown = ~grid.free & (grid.space > WALL_SHADOW_IN)
        if unknown.any():
            passable &= self._image.distance_transform_edt(~unknown, sampling=CELL_IN) > UNKNOWN_IN
        # Where the robot has been it comes again, though a wall of the map may end an inch or two too far in a door.
        if len(grid.driven):
            passable |= grid.driven
        if self._fence is not None:
            first, last = grid.cells(np.array((self._fence.low, self._fence.high)))
            inside = np.zeros(passable.shape, dtype=np.bool_)
            inside[first[0] + 1 : last[0], first[1] + 1 : last[1]] = True
            passable &= inside
        # 1. The robot may stand on a cell that is not passable: begin at the nearest one that is.
        (row, column), = grid.cells(pose[None, :2]).tolist()
        if not passable[row, column]:
            cells = np.argwhere(passable)
            if not len(cells):
                grid.cost = np.full(passable.shape, np.inf)
                return
            row, column = cells[np.hypot(*(grid.centres(cells) - pose[:2]).T).argmin()].tolist()
        # 2. Eight neighbours; narrow places cost more.
        tight = np.clip((self._body_in + CLEAR_IN - grid.space) / CLEAR_IN, 0.0, 1.0)
        price = CELL_IN * (1.0 + TIGHT * tight)
        number = np.arange(passable.size).reshape(passable.shape)
        ones, others, costs = [], [], []
        for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
            a = (slice(0, passable.shape[0] - dr), slice(max(-dc, 0), passable.shape[1] - max(dc, 0)))
            b = (slice(dr, None), slice(max(dc, 0), passable.shape[1] + min(dc, 0)))
            both = passable[a] & passable[b]
            ones.append(number[a][both])
            others.append(number[b][both])
            costs.append(hypot(dr, dc) * 0.5 * (price[a] + price[b])[both])
        graph = self._sparse.coo_matrix(
            (np.concatenate(costs), (np.concatenate(ones), np.concatenate(others))), shape=(passable.size,) * 2
        ).tocsr()
        cost, before = self._graph.dijkstra(
            graph, directed=False, indices=number[row, column], return_predecessors=True
        )
        grid.cost, grid.before = cost.reshape(passable.shape), before

    # Places.

    def _next_path(self, grid: Grid, mapper: LiveMapper, pose: Floats) -> list[Point] | None:
        """Return the path to the best place; None if there is none."""
        self.places, self._optional_in = [], 0.0
        choices, here = self._choices(grid, mapper, pose)
        # 1. Cells without anything, and corners, wait while there may be a room to enter.
        self._may_have_rooms = any(c.place.kind == "frontier" and c.place.size >= ROOM_SIZE for c in choices)
        if self._may_have_rooms:
            choices = [choice for choice in choices if choice.place.kind not in ("coverage", "corner")]
        # 2. The best by distance, with the turn before the leg.
        best, chosen = 0.0, None
        for choice in sorted(choices, key=lambda choice: -choice.worth / choice.seconds)[:MAX_TURNS_COMPARED]:
            value = choice.worth / (choice.seconds + self._turn_seconds(grid, pose, choice.cell))
            if value > best:
                best, chosen = value, choice
        self._is_undecided = here > best
        if chosen is None:
            return None
        # 3. The path, which to a frontier goes on.
        self._place = chosen.place
        path = self.path(grid, pose, chosen.cell)
        samples = _dense(np.concatenate((pose[None, :2], path)))
        near = np.hypot(*(samples[:, None] - mapper.poses[:, :2]).transpose(2, 0, 1)).min(axis=1) < VISITED_IN
        self._is_fast = bool(near.mean() > DRIVEN_FRACTION) or CELL_IN * len(samples) > LONG_IN
        if self._goes_on(self._place, mapper):
            onward, self._optional_in = self._onward(grid, path[-1], self._place)
            is_here = len(path) == 1 and dist(path[0], pose[:2]) < HERE_IN
            path = onward if onward and is_here else path + onward
        elif chosen.place.kind == "end":
            path += self._beside_wall(grid, (float(pose[0]), float(pose[1])), path, chosen.place)
        return path

    def _choices(self, grid: Grid, mapper: LiveMapper, pose: Floats) -> tuple[list[_Choice], float]:
        """Return the places to drive to, and the most that one is worth per second that can be seen from here."""
        choices, here = list[_Choice](), 0.0
        reached = np.argwhere(grid.reached)
        if not len(reached):
            return choices, here
        cells = _ReachedCells(grid, reached)
        for place, radius in self._candidates(grid, mapper, reached):
            number = self._cell_for(place, radius, cells, grid)
            if number is None:
                continue
            goal = cells.centres[number]
            place.seen_from_in = float(goal[0]), float(goal[1])
            if self._is_visited(place, mapper.poses[:, :2]):
                continue
            self.places.append(place)
            seconds = SETTLE_S + float(cells.costs[number]) / (0.7 * self._speed_in_s)
            worth = WORTH[place.kind] * place.size * (STAY if self._is_for(place) else 1.0)
            is_here = dist(place.seen_from_in, pose[:2]) < HERE_IN
            if is_here and not (self._goes_on(place, mapper) and self._onward(grid, place.seen_from_in, place)[0]):
                here = max(here, worth / seconds)
            else:
                choices.append(_Choice(place, worth, seconds, reached[number]))
        return choices, here

    def _cell_for(self, place: Place, radius_in: float, cells: _ReachedCells, grid: Grid) -> int | None:
        """Return the number of the cell from which a place is looked at; None if it is tried in vain, or there is none.

        The nearest of those within a radius that are good to look from, and cheap to reach.
        """
        at = np.array((place.x_in, place.y_in))
        rows, away = cells.about(grid, at, radius_in)
        tries = self._tries(place)
        if not len(rows) or tries >= MAX_TRIES[place.kind]:
            return None
        chosen = self._cells_to_look_from(place, tries, cells.space[rows], away, cells.echo_in[rows])
        rows, away = rows[chosen], away[chosen]
        rows = rows[np.argsort(away + 0.3 * cells.costs[rows], kind="stable")]
        return _first_in_sight(cells.centres, rows, at, grid.walls) if place.kind == "frontier" else int(rows[0])

    def _is_visited(self, place: Place, visited: Floats) -> bool:
        """Return True if a place was looked at from where it is seen, by the positions (n, 2) of the robot so far."""
        if place.kind == "frontier":
            return self._tries(place, SAME_GOAL_IN) >= MAX_LOOKS
        past = np.hypot(*(visited - place.seen_from_in).T)
        if place.kind == "corner":
            # Another one comes between two visits.
            return bool((past < NEAR_CORNER_IN).sum() >= CORNER_NODES or past[-1] < 2.0 * NEAR_CORNER_IN)
        return float(past.min(initial=np.inf)) < VISITED_IN

    def _goes_on(self, place: Place, mapper: LiveMapper) -> bool:
        """Return True for a frontier through which the path goes on: exact rays leave gaps in what is unknown."""
        return place.kind == "frontier" and not mapper.rays

    def _onward(self, grid: Grid, start: Point, frontier: Place) -> tuple[list[Point], float]:
        """Return where the path to look at a frontier goes on, as far as walls of the map leave space, if it does.

        And the length (in) of the part that is not known to be free.
        """
        off = np.array((frontier.x_in - start[0], frontier.y_in - start[1]))
        length = float(np.hypot(*off))
        steps = np.arange(1.0, (length + ONWARD_IN) / CELL_IN) * CELL_IN
        points = start + steps[:, None] / length * off
        if len(grid.walls):
            has_space = wall_distances(points, grid.walls) > self._body_in + MARGIN_IN
            points = points if has_space.all() else points[: has_space.argmin()]
        if self._fence is not None:
            inside = [self._fence.contains(*point) for point in points.tolist()]
            points = points if all(inside) else points[: inside.index(False)]
        if len(points) * CELL_IN <= HERE_IN:
            return [], 0.0
        cells = grid.cells(points)
        is_known = grid.reached[cells[:, 0], cells[:, 1]]
        first_unknown = len(points) if is_known.all() else int(is_known.argmin())
        return [(float(points[-1, 0]), float(points[-1, 1]))], (len(points) - first_unknown) * CELL_IN

    def _beside_wall(self, grid: Grid, start: Point, path: list[Point], end: Place) -> list[Point]:
        """Return where the path to an open end goes on along the wall, as far as it is free, if it leads there.

        At the end itself only some inches more of the wall are measured.
        """
        goal, along = np.array(path[-1]), np.array(end.along)
        came = goal - np.array(path[-2] if len(path) > 1 else start)
        if came @ along < 0.0:
            return []
        points = goal + np.arange(1.0, ALONG_WALL_IN / CELL_IN + 1.0)[:, None] * CELL_IN * along
        cells = grid.cells(points)
        at = cells[:, 0], cells[:, 1]
        is_free = grid.reached[at] & (grid.space[at] > self._body_in + COMFORT_IN)
        count = len(points) if is_free.all() else int(is_free.argmin())
        return [(float(points[count - 1, 0]), float(points[count - 1, 1]))] if count * CELL_IN > HERE_IN else []

    def _cells_to_look_from(
        self, place: Place, tries: int, space: Floats, away: Floats, echo_in: Floats
    ) -> Mask:
        """Return the cells (n,) of those near a place from which it is looked at; of a frontier it may be none.

        Beside a wall nearer than sonars measure nothing shows how near it is: there only where there is no other cell.
        A frontier is looked at first from where sonars measure a wall, then from as near as the robot can come, but not
        where they have measured something: the edge of a door reflects little from near.
        """
        for least_in in (CLEAR_IN, COMFORT_IN):
            with_space = space > self._body_in + least_in
            if place.kind == "frontier" and tries:
                with_space &= (least_in == COMFORT_IN) & (echo_in > self._body_in + COMFORT_IN)
            elif place.kind == "frontier":
                with_space &= away > LOOK_IN
            if with_space.any() or (place.kind == "frontier" and least_in == COMFORT_IN):
                return with_space
        return np.ones(len(space), dtype=np.bool_)

    def _is_for(self, place: Place) -> bool:
        """Return True for the frontier for which the leg before was driven."""
        before = self._before
        return (
            before is not None and place.kind == before.kind == "frontier"
            and hypot(place.x_in - before.x_in, place.y_in - before.y_in) < SAME_FRONTIER_IN
        )  # fmt: skip

    def _turn_seconds(self, grid: Grid, pose: Floats, goal: npt.NDArray[np.intp]) -> float:
        """Return the time that the turn into the path to a cell takes, backwards if that is the smaller one."""
        width = grid.free.shape[1]
        cell = int(goal[0]) * width + int(goal[1])
        # Back along the path, to the first cell that is far enough to give it a direction.
        while (before := int(grid.before[cell])) >= 0 and grid.cost[divmod(before, width)] >= TURN_BASE_IN:
            cell = before
        place = grid.centres(np.array(divmod(cell, width))[None])[0]
        turn = abs(angle_difference(float(np.arctan2(place[1] - pose[1], place[0] - pose[0])), float(pose[2])))
        return (turn if turn < REVERSE_RAD else np.pi - turn) / TURN_RAD_S

    def _add_tries(self, place: Place, count: int) -> None:
        place.tried_s = self._clock_s
        self._tried += [place] * count

    def _tries(self, place: Place, from_within_in: float = inf) -> int:
        """Return how often a place, or one near to it, was tried, from cells within a distance of the present one.

        A frontier is tried again after a while: the map may have changed, and a door leads to all that is behind it.
        """
        radius = SAME_FRONTIER_IN if place.kind == "frontier" else 5.0
        ages_s = [
            self._clock_s - other.tried_s
            for other in self._tried
            if other.kind == place.kind
            and hypot(other.x_in - place.x_in, other.y_in - place.y_in) < radius
            and (from_within_in == inf or dist(other.seen_from_in, place.seen_from_in) < from_within_in)
        ]
        if place.kind != "frontier" or len(ages_s) >= MAX_TRIES_EVER:
            return len(ages_s)
        return sum(age_s < AGAIN_S for age_s in ages_s)

    def _candidates(
        self, grid: Grid, mapper: LiveMapper, reached: npt.NDArray[np.intp]
    ) -> list[tuple[Place, float]]:
        """Return places worth visiting, each with the radius within which it may be visited."""
        found: list[tuple[Place, float]] = [
            (Place("frontier", x, y, size), SIGHT_IN) for x, y, size in self._frontiers(grid).tolist()
        ]
        places = self._solution.places
        if places is None and mapper.estimate is not None and len(mapper.estimate.state.walls):
            pieces = self._solution.pieces
            corners = _corner_places(pieces, self._body_in + CORNER_IN)
            spans = _span_places(mapper.estimate, self._solution.paths)
            self._solution.places = places = _end_places(mapper.estimate, pieces) + spans + corners
        found += [(replace(place), REACH_CELLS_IN) for place in places or ()]
        # Cells (n, 2) far from the path and from walls, the farthest first.
        rows, columns = reached.T
        away = self._image.distance_transform_edt(~grid.driven, sampling=CELL_IN)[rows, columns]
        away[grid.space[rows, columns] <= self._body_in + COMFORT_IN] = 0.0
        centres, left = grid.centres(reached), np.flatnonzero(away > COVERAGE_IN)
        while len(left):
            centre = centres[left[away[left].argmax()]]
            found.append((Place("coverage", *centre.tolist()), REACH_CELLS_IN))
            left = left[np.hypot(*(centres[left] - centre).T) > COVERAGE_IN]
        return found

    def _frontiers(self, grid: Grid) -> Floats:
        """Return centres and sizes (n, 3) of runs of unknown cells beside free ones, away from walls."""
        unknown = ~grid.free & ~grid.echoed & (grid.space > WALL_SHADOW_IN)
        # Only what lies beside free cells that are open themselves.
        open_cells = grid.free & (grid.space > WALL_SHADOW_IN)
        border = unknown & self._image.binary_dilation(open_cells)
        labels, count = self._image.label(border, structure=np.ones((3, 3)))
        is_passable = unknown & (grid.space > self._body_in)
        rests = rests_of_corners(self._solution.pieces)
        if len(rests):
            at = grid.cells(np.concatenate([_samples(row) for row in rests]))
            is_passable[at[:, 0], at[:, 1]] = False
        found = []
        for number in range(1, count + 1):
            cells = np.argwhere(labels == number)
            if len(cells) < MIN_FRONTIER_CELLS:
                continue
            # A long one in parts.
            parts = max(1, len(cells) // 30)
            for part in np.array_split(cells[np.argsort(cells @ np.ptp(cells, axis=0))], parts):
                centres = grid.centres(part)
                middle = centres[np.hypot(*(centres - centres.mean(axis=0)).T).argmin()]
                # Behind gaps that are too narrow for the robot there is nothing for it.
                wide = part[is_passable[part[:, 0], part[:, 1]]]
                behind = 0
                if len(wide):
                    behind = self._behind(is_passable, wide[grid.space[wide[:, 0], wide[:, 1]].argmax()])
                found.append((*middle, np.clip(behind / BEHIND_CELLS, MIN_SIZE, MAX_SIZE)))
        return np.array(found).reshape(-1, 3)

    def _behind(self, unknown: Mask, cell: npt.NDArray[np.intp]) -> int:
        """Return the number of unknown cells about an unknown one, within SIGHT_IN, that no wall separates from it."""
        reach = int(SIGHT_IN / CELL_IN)
        low = np.maximum(cell - reach, 0)
        part = unknown[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1]
        labels, _ = self._image.label(part)
        row, column = cell - low
        rows, columns = np.nonzero(labels == labels[row, column])
        return int((np.hypot(rows - row, columns - column) <= reach).sum())

    # Paths.

    def path(self, grid: Grid, pose: Floats, goal: npt.NDArray[np.intp]) -> list[Point]:
        """Return the waypoints to a cell: the cheapest cells, pushed away from walls, straightened."""
        # 1. The cells.
        width = grid.free.shape[1]
        cells = [int(goal[0]) * width + int(goal[1])]
        while (cell := int(grid.before[cells[-1]])) >= 0:
            cells.append(cell)
        points = grid.centres(np.stack(np.divmod(np.array(cells[::-1]), width), axis=-1))
        # From its own cell straight on; from one that is not passable to the nearest one that is, away from the wall.
        is_at_first = float(np.abs(points[0] - pose[:2]).max()) <= CELL_IN / 2.0
        points = np.concatenate((pose[None, :2], points[1:] if is_at_first else points))
        walls = grid.walls
        if len(walls) and len(points) > 2:
            points = pushed(points, walls, self._body_in + CLEAR_IN)
        # 2. Straight lines as long as they leave as much space as the cells do.
        space = wall_distances(points, walls)
        path, at = [], 0
        while at < len(points) - 1:
            to = len(points) - 1
            while to > at + 1 and not self._is_clear(points, at, to, walls, space):
                to = at + max((to - at) * 3 // 4, 1)
            path.append((float(points[to, 0]), float(points[to, 1])))
            at = to
        return path or [(float(points[-1, 0]), float(points[-1, 1]))]

    def _is_clear(self, points: Floats, at: int, to: int, walls: Floats, space: Floats) -> bool:
        """Return True if the straight line between two points of a path leaves as much space as the path."""
        if not len(walls):
            return True
        line = np.concatenate((points[at], points[to]))[None]
        needed = min(float(space[at : to + 1].min()) - 0.3, self._body_in + CLEAR_IN)
        # A path around a corner must not be cut through what is unknown.
        off = points[at : to + 1]
        if nearest_points(off, line)[1].max() > self._body_in:
            return False
        return bool(segment_clearances(line, walls)[0] >= needed)

    def _last_leg(self, pose: Floats, mapper: LiveMapper) -> list[Point] | None:
        """Return a straight leg with little turning, forwards or backwards; None without space."""
        walls = np.concatenate((mapper.walls, self._blocks()))
        for turn in np.radians((0.0, 15.0, -15.0, 35.0, -35.0, 60.0, -60.0)):
            for length in (LAST_LEG_IN, -LAST_LEG_IN):
                along = length * np.array((np.cos(pose[2] + turn), np.sin(pose[2] + turn)))
                line = np.concatenate((pose[:2], pose[:2] + along))[None]
                if self._fence is not None and not self._fence.contains(*line[0, 2:].tolist()):
                    continue
                if segment_clearances(line, walls)[0] > self._body_in + COMFORT_IN + 2.0:
                    return [(float(line[0, 2]), float(line[0, 3]))]
        return None


def _unexplained_hits(estimate: MapEstimate) -> Floats:
    """Return where exact rays have hit something that the map does not have (n, 2), twice near to each other at least.

    Cones do not tell where something is.
    """
    echoes = estimate.echoes()
    echoes = echoes[estimate.assignment.feature[echoes] == NO_FEATURE]
    if not estimate.problem.rays or not len(echoes):
        return np.zeros((0, 2))
    state, trajectory = estimate.state, estimate.problem.trajectory
    sensors = sensors_at(state.poses, state.parameters, trajectory, echoes)
    axes = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
    hits: Floats = sensors.face + sensors.range_in[:, None] * axes
    is_near = np.hypot(*(hits[:, None] - hits).transpose(2, 0, 1)) < SAME_HIT_IN
    hits = hits[is_near.sum(axis=1) > 1]
    _, first_of = np.unique(np.floor(hits / CELL_IN), axis=0, return_index=True)
    return np.asarray(hits[first_of])


def _posts(points: Floats) -> Floats:
    """Return points (n, 2) as short segments (n, 4)."""
    half = np.array((1.0, 0.0))
    posts: Floats = np.concatenate((points - half, points + half), axis=1)
    return posts


def _dense(path: Floats) -> Floats:
    """Return a path (p, 2) with points at most a cell apart."""
    count = int(np.hypot(*np.diff(path, axis=0).T).max(initial=0.0) / CELL_IN) + 1
    fraction = np.arange(count)[None, :, None] / count
    between = path[:-1, None] + fraction * np.diff(path, axis=0)[:, None]
    return np.concatenate((between.reshape(-1, 2), path[-1:]))


def _samples(segment: Floats) -> Floats:
    """Return points (n, 2) along a segment (4,), at most a cell apart."""
    count = int(np.hypot(*(segment[2:] - segment[:2])) / (0.7 * CELL_IN)) + 2
    return np.linspace(segment[:2], segment[2:], count)


def pushed(points: Floats, walls: Floats, wanted_in: float) -> Floats:
    """Return a path whose inner points are pushed away from walls nearer than a distance: an elastic band."""
    points = points.copy()
    for _ in range(30):
        nearest, distances = nearest_points(points[1:-1], walls)
        rows = np.arange(len(points) - 2)
        which = distances.argmin(axis=1)
        distance = np.maximum(distances[rows, which], 1e-6)
        away = (points[1:-1] - nearest[rows, which]) / distance[:, None]
        push = 0.3 * np.maximum(wanted_in - distance, 0.0)[:, None] * away
        pull = 0.25 * (points[:-2] + points[2:] - 2.0 * points[1:-1])
        points[1:-1] += push + pull
    return points


def _first_in_sight(centres: Floats, rows: npt.NDArray[np.intp], place: Floats, walls: Floats) -> int | None:
    """Return the first of some rows of points (n, 2) from which no wall hides a place; None if all do."""
    for start in range(0, len(rows), SEEN_AT_ONCE):
        some = rows[start : start + SEEN_AT_ONCE]
        in_sight = some[~_crossed(centres[some], place, walls)]
        if len(in_sight):
            return int(in_sight[0])
    return None


def _crossed(starts: Floats, end: Floats, walls: Floats) -> Mask:
    """Return True (n,) for straight lines from points (n, 2) to one that cross a wall."""
    if not len(walls):
        return np.zeros(len(starts), dtype=np.bool_)
    lines = np.concatenate((starts, np.broadcast_to(end, starts.shape)), axis=1)
    return np.asarray(crossings(lines, walls).any(axis=1), dtype=np.bool_)


def _end_places(estimate: MapEstimate, pieces: list[Piece]) -> list[Place]:
    """Return places from which open ends of walls, and vertices with fewer than two walls, are seen."""
    found = []
    # 1. Open ends: beyond the end, at either side of the wall.
    for piece in pieces:
        for end, is_closed in enumerate(piece.closed):
            if is_closed:
                continue
            here, there = piece.ends[end], piece.ends[1 - end]
            along = (here - there) / max(float(np.hypot(*(here - there))), 1e-6)
            normal = np.array((-along[1], along[0]))
            for side in (END_ASIDE_IN, -END_ASIDE_IN):
                x, y = here + END_AHEAD_IN * along + side * normal
                found.append(Place("end", float(x), float(y), along=(float(along[0]), float(along[1]))))
    # 2. Vertices, in directions from which the robot has not looked.
    turns = np.arange(VERTEX_DIRECTIONS) * (2.0 * np.pi / VERTEX_DIRECTIONS)
    for point in estimate.state.points:
        ends = [end for piece in pieces for end in piece.ends]
        if sum(float(np.hypot(*(point - end))) < NEAR_WALL_END_IN for end in ends) >= 2:
            continue
        off = estimate.state.poses[:, :2] - point
        off = off[np.hypot(*off.T) < VERTEX_SEEN_IN]
        aside = wrap_angle(np.arctan2(off[:, 1], off[:, 0])[:, None] - turns)
        is_seen = (np.abs(aside) < np.pi / VERTEX_DIRECTIONS).any(axis=0)
        for turn in turns[~is_seen]:
            x, y = point + VERTEX_IN * np.array((np.cos(turn), np.sin(turn)))
            found.append(Place("vertex", float(x), float(y)))
    return found



def _span_places(estimate: MapEstimate, paths: tuple[Floats, Floats]) -> list[Place]:
    """Return the places before both sides of spans between which sound has not passed, too seldom to be a wall."""
    found = []
    for span in uncrossed_spans(estimate, paths):
        if span.is_wall or pass_through(estimate.state.walls, span.ends[None], POINT_ON_LINE_IN).any():
            continue
        ends = span.ends.reshape(2, 2)
        along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
        for side in (END_ASIDE_IN, -END_ASIDE_IN):
            x, y = ends.mean(axis=0) + side * np.array((-along[1], along[0]))
            found.append(Place("span", float(x), float(y)))
    return found


def rests_of_corners(pieces: list[Piece]) -> Floats:
    """Return the segments (n, 4) between open ends of walls and the walls or other such segments that they meet soon.

    A wall probably goes on to the next corner.
    """
    opens = [(piece.ends[end], piece.ends[1 - end]) for piece in pieces for end in range(2) if not piece.closed[end]]
    if not opens:
        return np.zeros((0, 4))
    starts, others = np.array(opens).transpose(1, 0, 2)
    along = (starts - others) / np.maximum(np.hypot(*(starts - others).T), 1e-9)[:, None]
    longest = np.concatenate((starts, starts + CORNER_REST_IN * along), axis=1)
    walls = np.array([piece.ends.reshape(4) for piece in pieces])
    # From a hair beside the line, or each would meet itself.
    aside = BESIDE_LINE_IN * np.stack((-along[:, 1], along[:, 0]), axis=-1)
    distance, _ = cast_rays(starts + aside, along, np.concatenate((walls, longest)))
    meets = distance < CORNER_REST_IN
    ends = starts[meets] + distance[meets, None] * along[meets]
    return np.concatenate((starts[meets], ends), axis=1)


def _corner_places(pieces: list[Piece], space_in: float) -> list[Place]:
    """Return the places at a distance from both walls of each corner, between them."""
    found = []
    ends = [
        (piece.ends[end], piece.ends[1 - end])
        for piece in pieces if piece.length_in > ON_LINE_IN
        for end in range(2) if piece.closed[end]
    ]  # fmt: skip
    for number, (corner, far) in enumerate(ends):
        for other, other_far in ends[:number]:
            if float(np.hypot(*(other - corner))) > ON_LINE_IN:
                continue
            one, two = ((end - corner) / np.hypot(*(end - corner)) for end in (far, other_far))
            # Along both walls by space / sin(angle): as far from the one as from the other.
            x, y = corner + (one + two) * space_in / max(abs(one[0] * two[1] - one[1] * two[0]), 0.1)
            found.append(Place("corner", float(x), float(y)))
    return found
