"""The result of mapping: a world file, a picture, a calibration, and why a map is refused.

The frame has its origin at the start of the drive and its axes along the longest walls. The start of the world is where
the robot stands at the end, so that `nomad localize --map room.toml` continues from there.

While a map is being learned, the page of an nserver shows it (`nomad map learn ADDRESS --publish URL`):

    survey ──> MapPublisher ──> POST URL/publish ──> all pages: walls, uncertain ones dashed

On the page its frame lies so that its path fits the true one of a simulated robot best; that of a real robot begins
where the encoders began.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import degrees, radians
from pathlib import Path
from typing import Any, Final

import numpy as np

from localization.filters.belief import HEADING, POSE, Floats, compose, relative_pose, rigid_fit, rotate, wrap_angle
from localization.filters.odometry import OdometryParameter
from localization.live.run import GroundTruth, Publisher
from localization.mapping.association import MapEstimate
from localization.mapping.consistency import (
    LATE,
    LATE_MAP,
    MIN_EXPLAINED,
    MIN_EXPLAINED_OF_ALL,
    Part,
    Stretch,
    check_parts,
    compare_returns,
    explained_fractions,
    explains_enough,
    least_explained,
)
from localization.mapping.features import MIN_BASE_IN
from localization.mapping.live import LiveMapper
from localization.mapping.merging import find_undecided, overlap_in
from localization.mapping.problem import COMMON_OFFSET, NO_FEATURE, sensors_at
from localization.mapping.reflectors import crossings, segments_of
from localization.mapping.spans import SAME_CORNER_IN
from localization.mapping.survey import SurveyStep
from localization.mapping.walls import (
    MAX_STD_IN,
    Outline,
    Piece,
    axes_rad,
    extract_walls,
    final_pose,
    find_outlines,
    parameter_covariance,
    passed_walls,
)
from nclient.errors import NomadError
from worlds.geometry import lengths, nearest_points, polygon_segments
from worlds.robots import Calibration, Spread
from worlds.world import Polygon, StartPose, World

DECIMALS: Final = 7
"""Of coordinates in the file: far below the 1e-6 in within which ends touch."""
MIN_EXPLAINED_SOMEWHERE: Final = 0.6
"""The same in any 20 s of the drive, as far as their number tells."""
MAX_CHI_SQUARE: Final = 1.5
"""Highest sum of squared residuals per degree of freedom, 1 for a model that fits."""
MIN_WALLS: Final = 2
MIN_KNOWN: Final = 0.5
"""Least fraction of the walls that must be known so well."""
CROSSED_IN: Final = 2.0
"""A path that crosses a wall nearer to its end than this passes beside it."""
POST_IN: Final = 1.0
"""Side of the post that stands for a point."""
POST_SPACE_IN: Final = 6.0
"""A point nearer to a wall or a post is an end or a corner of it; one nearer to the path is a mistake, as the robot's
radius is larger."""
MAX_SURFACE_STDS: Final = 0.5
"""Highest standard deviation of a wall with a surface that is written, in standard deviations of its levels."""
MARGIN_IN: Final = 15.0
"""Around the walls in the picture."""


class MapRefused(NomadError):
    """A drive makes no map that holds together, or one that does not fit another map."""


@dataclass(frozen=True, slots=True)
class Quality:
    """Quality of a map: the fit of its readings.

    Attributes
    ----------
    explained
        Fraction of the ranges that a wall or a point explains.
    parts
        Chi-square tests of the residuals of odometry and explained ranges: of the whole drive, and of its parts.
    undecided
        Middles (k, 2) of walls that are as probably one with another wall beside them.
    least
        The stretch of the drive of which the map explains the least; None for a drive shorter than one.
    repeated
        Fraction of the ranges that repeat that a wall or a point explains.
    passed
        Middles (k, 2) of walls through which sound has passed: the same place is in the map twice.
    """

    explained: float
    parts: tuple[Part, ...]
    undecided: Floats = field(default_factory=lambda: np.empty((0, 2)))
    least: Stretch | None = None
    repeated: float = 1.0
    passed: Floats = field(default_factory=lambda: np.empty((0, 2)))

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals of the drive per degree of freedom, 1 for a model that fits."""
        return self.parts[0].total / max(self.parts[0].freedom, 1.0)

    @property
    def worst(self) -> Part:
        """The part whose sum is largest, compared with its quantile."""
        return max(self.parts, key=lambda part: part.excess)

    def turned(self, angle_rad: float) -> Quality:
        """Return the same with all places turned about the origin."""
        parts = tuple(replace(part, place=rotate(part.place, np.array(angle_rad))) for part in self.parts)
        least = self.least
        if least is not None:
            least = replace(least, place=rotate(least.place, np.array(angle_rad)))
        undecided = rotate(self.undecided, np.full(len(self.undecided), angle_rad))
        passed = rotate(self.passed, np.full(len(self.passed), angle_rad))
        return replace(self, parts=parts, undecided=undecided, least=least, passed=passed)


@dataclass(frozen=True, slots=True)
class LearnedMap:
    """A map in its own frame: walls, points, path (n, 3), and what the robot has moved after it (3,)."""

    walls: tuple[Piece, ...]
    points: Floats
    path: Floats
    calibration: Calibration
    quality: Quality
    turret_rad: float
    rest: Floats = field(default_factory=lambda: np.zeros(POSE))
    unexplored: Floats | None = None
    """Places (n, 2) beyond which the room goes on; None if they were not looked for."""
    uncertain: tuple[Piece, ...] = ()
    """Walls whose standard deviation is too high (`highest_std_in`): they are not written."""
    outlines: tuple[Outline, ...] = ()
    """Closed outlines of boxes, of walls that are written and of their corners: obstacles of the world."""

    @property
    def posts(self) -> Floats:
        """Points (n, 2) that stand alone: neither at a wall nor at one another, nor where the robot was."""
        walls = np.array([wall.ends.reshape(4) for wall in self.walls]).reshape(-1, 4)
        boxes = [polygon_segments(outline.corners) for outline in self.outlines]
        walls = np.concatenate((walls, *boxes))
        path = np.concatenate((self.path[:-1, :2], self.path[1:, :2]), axis=1)
        found: list[Floats] = []
        for point in self.points:
            things = np.concatenate((walls, path, *(np.concatenate((post, post))[None] for post in found)))
            if not len(things) or nearest_points(point[None], things)[1].min() > POST_SPACE_IN:
                found.append(point)
        return np.array(found).reshape(-1, 2)

    @property
    def crossed_walls(self) -> list[Piece]:
        """Walls that the robot's path crosses: the same place is in the map twice, or something has moved."""
        path = self.path[:, :2]
        segments = np.array([wall.ends.reshape(4) for wall in self.walls]).reshape(-1, 4)
        along = (segments[:, 2:] - segments[:, :2]) / np.maximum(lengths(segments), 1e-9)[:, None]
        inner = np.concatenate((segments[:, :2] + CROSSED_IN * along, segments[:, 2:] - CROSSED_IN * along), axis=1)
        crossed = crossings(path[:-1], path[1:], inner).any(axis=0) & (lengths(segments) > 2.0 * CROSSED_IN)
        return [self.walls[row] for row in np.flatnonzero(crossed)]

    @property
    def pose(self) -> Floats:
        """The robot's pose now (3,)."""
        pose: Floats = compose(self.path[-1], self.rest)
        pose[HEADING] = wrap_angle(pose[HEADING])
        return pose

    @property
    def open_ends(self) -> list[tuple[float, float]]:
        """Ends of walls without a corner, inches; the sides of a box have corners."""
        corners = np.array([outline.corners for outline in self.outlines]).reshape(-1, 2)
        return [
            (float(x), float(y))
            for wall in self.walls
            for (x, y), is_closed in zip(wall.ends, wall.closed, strict=True)
            if not is_closed and not (np.hypot(*(corners - (x, y)).T) <= SAME_CORNER_IN).any()
        ]

    def reason_to_refuse(self) -> str:
        """Return why this map must not be used; "" if it is sound."""
        quality = self.quality
        certain, uncertain = ([wall for wall in walls if wall.echoes] for walls in (self.walls, self.uncertain))
        if len(certain) + len(uncertain) < MIN_WALLS:
            return (
                f"{len(certain)} walls found: drive along the walls, at 12 to 60 in from them, and turn at corners"
            )
        if not explains_enough(quality.explained, quality.repeated):
            return (
                f"its walls explain {quality.explained:.0%} of the ranges and {quality.repeated:.0%} of those that "
                f"repeat, at least {MIN_EXPLAINED_OF_ALL:.0%} and {MIN_EXPLAINED:.0%} are needed: --sonars is wrong, "
                "things moved, or the odometry is worse than --odometry-noise"
            )
        if quality.least is not None and quality.least.at_most < MIN_EXPLAINED_SOMEWHERE:
            x, y = quality.least.place
            return (
                f"near ({x:.0f}, {y:.0f}) its walls explain {quality.least.explained:.0%} of the ranges of 20 s that "
                f"repeat, at least {MIN_EXPLAINED_SOMEWHERE:.0%} are needed everywhere: the path is bent there, or "
                "things moved; drive there again, along the walls"
            )
        if quality.chi_square > MAX_CHI_SQUARE:
            return (
                f"ranges and encoders contradict each other: chi-square is {quality.chi_square:.2f} per degree of "
                f"freedom, at most {MAX_CHI_SQUARE} is sound; --odometry-noise is too low, or --sonars is wrong"
            )
        worst = quality.worst
        if worst.excess > 1.0 and worst.kind.startswith(LATE):
            place = "" if worst.kind == LATE_MAP else " at ({:.0f}, {:.0f})".format(*worst.place)
            return (
                f"what was measured late contradicts what was measured early: chi-square of the {worst.kind}{place} is "
                f"{worst.total:.0f}, with {worst.freedom:.0f} degrees of freedom at most {worst.limit:.0f} is sound; "
                "--odometry-noise is too low, or something moved; drive in smaller loops"
            )
        if worst.excess > 1.0:
            place = "" if worst.kind == "drive" else " at ({:.0f}, {:.0f})".format(*worst.place)
            return (
                f"ranges and encoders contradict each other: chi-square of the {worst.kind}{place} is "
                f"{worst.total:.0f}, with {worst.freedom:.0f} degrees of freedom at most {worst.limit:.0f} is sound; "
                "--odometry-noise or --roughness is too low, --sonars is wrong, or something moved"
            )
        if len(quality.passed):
            x, y = quality.passed[0]
            return (
                f"sound has passed through {len(quality.passed)} of its walls, such as the one at ({x:.0f}, {y:.0f}): "
                "the same place is in the map twice, or something moved; drive in smaller loops, along walls and "
                "corners that are in the map already"
            )
        if len(quality.undecided):
            x, y = quality.undecided[0]
            return (
                f"one wall or two at ({x:.0f}, {y:.0f}): the readings do not decide it; drive along it again, in "
                "smaller loops"
            )
        if crossed := self.crossed_walls:
            (x1, y1), (x2, y2) = crossed[0].ends.tolist()
            return (
                f"the path crosses {len(crossed)} of its walls, such as ({x1:.0f}, {y1:.0f})-({x2:.0f}, {y2:.0f}): the "
                "robot came back to a place without recognizing it, or something moved; drive in smaller loops, along "
                "walls and corners that are in the map already"
            )
        count = len(certain) + len(uncertain)
        if len(certain) < max(MIN_KNOWN * count, MIN_WALLS):
            stds = [wall.std_in for wall in uncertain]
            lowest, highest = min(stds), max(stds)
            return (
                f"{len(certain)} of its {count} walls are known well enough, the others within {2.0 * lowest:.1f} "
                f"to {2.0 * highest:.1f} in, twice their standard deviation; at least {MIN_KNOWN:.0%} are needed: "
                "drive in smaller loops, along the walls, and come back to corners"
            )
        return ""

    def world(self, name: str) -> World:
        """Return the map as a world, with an obstacle for each outline instead of its walls."""
        of_boxes = {row for outline in self.outlines for row in outline.walls}
        others = [wall for row, wall in enumerate(self.walls) if row not in of_boxes]
        walls = np.array([wall.ends.reshape(4) for wall in others]).reshape(-1, 4)
        x, y, heading = self.pose.tolist()
        start = StartPose(round(x, 3), round(y, 3), round(heading, 4), round(wrap_angle(heading + self.turret_rad), 4))
        accuracies = {row: wall.accuracy for row, wall in enumerate(others)}
        square = 0.5 * POST_IN * np.array(((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)))
        solids = [(f"box {number}", outline.corners) for number, outline in enumerate(self.outlines, start=1)]
        solids += [(f"post {number}", square + post) for number, post in enumerate(self.posts, start=1)]
        obstacles = tuple(
            Polygon(tuple((round(x, 3), round(y, 3)) for x, y in corners.tolist()), solid) for solid, corners in solids
        )
        walls = np.round(walls, DECIMALS) + 0.0
        return World(name, inner_walls=walls, obstacles=obstacles, starts=(start,), accuracies=accuracies)

    def as_json(self) -> dict[str, Any]:
        """Return the result as plain data: inches, and units in the keys; the heading of `pose` is in radians."""
        return {
            "walls": [
                {
                    "ends_in": wall.ends.tolist(),
                    "closed": [bool(closed) for closed in wall.closed],
                    "end_stds_in": list(wall.end_stds_in),
                    "measured_in": wall.measured_in,
                    "echoes": wall.echoes,
                    "offset_std_in": wall.std_in,
                    "angle_std_deg": degrees(wall.std_rad),
                }
                for wall in self.walls
            ],
            "points_in": self.points.tolist(),
            "posts_in": self.posts.tolist(),
            "outlines_in": [outline.corners.tolist() for outline in self.outlines],
            "uncertain_in": [
                {"ends_in": wall.ends.tolist(), "offset_std_in": wall.std_in} for wall in self.uncertain
            ],
            "open_ends_in": self.open_ends,
            "unexplored_in": None if self.unexplored is None else self.unexplored.tolist(),
            "pose": self.pose.tolist(),
            "explained": self.quality.explained,
            "explained_of_repeated": self.quality.repeated,
            "chi_square": self.quality.chi_square,
            "distance_scale": self.calibration.distance_scale,
            "turn_scale": self.calibration.turn_scale,
            "drift_rad_in": self.calibration.drift_rad_in,
            "offsets_in": list(self.calibration.offsets_in),
            "refused": self.reason_to_refuse() or None,
        }


def describe(
    estimate: MapEstimate, turret_rad: float = 0.0, rest: Floats | None = None, unexplored: Floats | None = None
) -> LearnedMap:
    """Return the map of an estimate in its own frame.

    Parameters
    ----------
    estimate
        A finished estimate.
    turret_rad
        Angle of the turret from the heading at the end.
    rest
        What the robot has moved after the last pose (3,).
    unexplored
        Places (n, 2) beyond which the room goes on, in the frame of the estimate.
    """
    walls = extract_walls(estimate)
    # 1. The frame: the origin stays, the axes turn to the longest walls.
    turn = axes_rad(walls)
    pose = final_pose(estimate)
    path = np.concatenate((estimate.state.poses[:-1], pose[None]))
    path[:, :2] = rotate(path[:, :2], np.full(len(path), -turn))
    path[:, HEADING] -= turn
    points = rotate(estimate.state.points, np.full(len(estimate.state.points), -turn))
    turned = [wall.placed(lambda points: rotate(points, np.full(len(points), -turn))) for wall in walls]
    rest = np.zeros(POSE) if rest is None else rest
    if unexplored is not None:
        unexplored = rotate(unexplored, np.full(len(unexplored), -turn))
    # 2. Walls that are known well enough.
    highest = highest_std_in(estimate)
    is_certain = [wall.std_in <= highest for wall in turned]
    certain = tuple(wall for wall, is_written in zip(turned, is_certain, strict=True) if is_written)
    uncertain = tuple(wall for wall, is_written in zip(turned, is_certain, strict=True) if not is_written)
    # 3. Boxes of which all walls are.
    numbers = np.cumsum(is_certain) - 1
    outlines = tuple(
        Outline(rotate(outline.corners, np.full(4, -turn)), tuple(int(numbers[row]) for row in outline.walls))
        for outline in find_outlines(estimate, walls) if all(is_certain[row] for row in outline.walls)
    )  # fmt: skip
    return LearnedMap(
        certain, points, path, calibration_of(estimate), quality_of(estimate, walls).turned(-turn), turret_rad, rest,
        unexplored, uncertain, outlines,
    )  # fmt: skip


def highest_std_in(estimate: MapEstimate) -> float:
    """Return the highest standard deviation of a wall that is written: that of a smooth one, and of its surface."""
    trajectory = estimate.problem.trajectory
    rough = trajectory.other_var_in2 - trajectory.step_in**2 / 12.0
    of_plane = float(np.sqrt(MAX_STD_IN**2 + rough.mean()))
    return max(of_plane, MAX_SURFACE_STDS * estimate.problem.reflection.surface_std_in)


def quality_of(estimate: MapEstimate, walls: Sequence[Piece]) -> Quality:
    """Return how well a map, whose walls these are, explains its readings."""
    middles = segments_of(estimate.state.walls, estimate.extents).reshape(-1, 2, 2).mean(axis=1)
    undecided = middles[[one for one, other in find_undecided(estimate) if _are_side_by_side(walls, one, other)]]
    of_all, of_repeated = explained_fractions(estimate)
    parts = (*check_parts(estimate), *compare_returns(estimate))
    passed = np.array([wall.ends.mean(axis=0) for wall in passed_walls(estimate, walls)]).reshape(-1, 2)
    return Quality(of_all, parts, undecided, least_explained(estimate), of_repeated, passed)


def _are_side_by_side(pieces: Sequence[Piece], one: int, other: int) -> bool:
    """Return True if pieces of two walls of the map lie side by side, as they are written.

    Where another wall divides a wall, the echoes of its parts lie on both lines, and the parts one after the other.
    """
    return any(
        overlap_in(first.ends.reshape(4), second.ends.reshape(4)) > MIN_BASE_IN
        for first in pieces if first.wall == one
        for second in pieces if second.wall == other
    )  # fmt: skip


def calibration_of(estimate: MapEstimate) -> Calibration:
    """Return the systematic errors of wheels and sonars that the map was estimated with."""
    parameters, covariance = estimate.state.parameters, parameter_covariance(estimate)
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    first = int(OdometryParameter.DISTANCE_SCALE)
    scale, turn, drift = (int(p) - first for p in OdometryParameter)
    # An offset is that of all sonars and the sonar's own.
    own = slice(COMMON_OFFSET + 1, None)
    offsets = parameters[COMMON_OFFSET] + parameters[own]
    sums = covariance[COMMON_OFFSET, COMMON_OFFSET] + 2.0 * covariance[COMMON_OFFSET, own] + np.diag(covariance)[own]
    spread = Spread(
        float(std[scale]), float(std[turn]), float(std[drift]), tuple(np.sqrt(np.maximum(sums, 0.0)).tolist()), 0.0
    )
    return Calibration(
        1.0 + float(parameters[scale]), 1.0 + float(parameters[turn]), float(parameters[drift]),
        tuple(offsets.tolist()), 0.0, spread,
    )  # fmt: skip


def draw_learned(path: Path, found: LearnedMap, estimate: MapEstimate) -> None:
    """Draw walls, those that are not written dashed, points, echoes and path as PNG.

    Raises
    ------
    OutputFileError
        If the file cannot be written.
    """
    from localization.plot import save
    from worlds.drawing import ESTIMATE, FAINT, GOAL, ODOMETRY, TRUTH, blank, draw_walls

    # 1. Echoes along their axes, in the frame of the map.
    state, trajectory = estimate.state, estimate.problem.trajectory
    sensors = sensors_at(state.poses, state.parameters, trajectory, slice(None))
    along = np.stack((np.cos(sensors.axis), np.sin(sensors.axis)), axis=-1)
    spots = sensors.face + sensors.range_in[:, None] * along
    turn = found.path[0, HEADING] - state.poses[0, HEADING]
    spots = rotate(spots, np.full(len(spots), turn))
    is_explained = estimate.assignment.feature != NO_FEATURE
    picture = blank(9.0, 8.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    for shown, color, label in (
        (spots[is_explained], FAINT, "echoes"), (spots[~is_explained], ESTIMATE, "unexplained")
    ):  # fmt: skip
        axes.plot(*shown.T, marker=".", markersize=3, color=color, linestyle="", label=label)
    # 2. The map and the path.
    axes.plot(*found.path[:, :2].T, color=ODOMETRY, linewidth=1.0, label="path")
    draw_walls(axes, [wall.ends.reshape(4) for wall in found.walls])
    for outline in found.outlines:
        axes.fill(*outline.corners.T, facecolor=FAINT, edgecolor=TRUTH, linewidth=1.5)
    for wall in found.uncertain:
        axes.plot(*wall.ends.T, color=TRUTH, linewidth=1.5, linestyle="--")
    axes.plot(*found.points.T, marker="s", markersize=4, color=GOAL, linestyle="", label="points")
    if found.open_ends:
        axes.plot(*np.array(found.open_ends).T, marker="x", color=ESTIMATE, linestyle="", label="open ends")
    ends = np.array([wall.ends for wall in (*found.walls, *found.uncertain)]).reshape(-1, 2)
    low, high = (
        np.concatenate((ends, found.path[:, :2])).min(0) - MARGIN_IN,
        np.concatenate((ends, found.path[:, :2])).max(0) + MARGIN_IN,
    )
    axes.set(xlabel="x (in)", ylabel="y (in)", xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=5, frameon=False)
    save(picture, path)


def summary(found: LearnedMap) -> str:
    """Return the result as a few lines of text."""
    lines = [
        f"({a[0]:7.1f}, {a[1]:7.1f})-({b[0]:7.1f}, {b[1]:7.1f})  {wall.length_in:6.1f} in, measured "
        f"{wall.measured_in:5.1f} in by {wall.echoes} echoes, ± {wall.std_in:.2f} in {degrees(wall.std_rad):.2f} deg"
        for wall in found.walls
        for a, b in [wall.ends]
    ]
    length = float(np.hypot(*np.diff(found.path[:, :2], axis=0).T).sum())
    lines.append(
        f"{len(found.walls)} walls from {length:.0f} in of driving; {found.quality.explained:.0%} of the ranges "
        f"explained, chi-square {found.quality.chi_square:.2f} (1 is right)"
    )
    lines += [
        "closed outline: " + ", ".join(f"({x:.1f}, {y:.1f})" for x, y in outline.corners) for outline in found.outlines
    ]
    if found.unexplored is not None:
        lines += [f"not explored beyond ({x:.0f}, {y:.0f})" for x, y in found.unexplored]
    lines += [
        f"the wall at ({x:.0f}, {y:.0f}) is known within {2.0 * wall.std_in:.1f} in only, and not written: drive there"
        for wall in found.uncertain
        for x, y in [wall.ends.mean(axis=0)]
    ]
    lines += [f"open end at ({x:.1f}, {y:.1f}): drive there to find its corner" for x, y in found.open_ends]
    return "\n".join(lines)


PERIOD_S: Final = 0.25
"""Real seconds between two messages."""
MAX_STD_RAD: Final = radians(1.0)
"""Of a certain wall: it is within 2 degrees by two standard deviations, and within 1 in by MAX_STD_IN."""
MIN_MEASURED: Final = 0.5
"""Least fraction of a certain wall on which something was measured."""


def is_uncertain(wall: Piece) -> bool:
    """Return True for a wall whose place is uncertain, or that was measured on less than half of its length."""
    is_short = wall.measured_in < MIN_MEASURED * wall.length_in
    return is_short or wall.std_in > MAX_STD_IN or wall.std_rad > MAX_STD_RAD


class MapPublisher:
    """Observer of a drive that shows its map on a page; waypoints set there are ignored.

    Parameters
    ----------
    publisher
        Connection to the page.
    clock
        Monotonic clock in seconds.
    """

    def __init__(self, publisher: Publisher, clock: Callable[[], float]) -> None:
        self._publisher, self._clock = publisher, clock
        self.ground_truth: GroundTruth | None = None
        """Of the robot, set before the drive: it only places the map on the page."""
        self._due_s = -np.inf
        self._rounds = -1
        self._truth: list[tuple[float, float, float]] = []
        self._frame: Floats | None = None
        """Pose (3,) of the map's frame on the page."""
        self._drawn: dict[str, Any] = {"walls": [], "points": []}
        self._last: dict[str, Any] | None = None

    def add(self, step: SurveyStep, mapper: LiveMapper) -> None:
        """Publish the map and the pose of this period, if the last message is old enough."""
        truths = self.ground_truth
        if truths is None or step.pose is None or step.state is None:
            return
        # 1. Where the map's frame is on the page. Every period counts: the path has corners between two messages.
        clock_s = step.state.clock_s or 0.0
        truth = truths.at(clock_s)
        if truth is not None:
            self._truth.append((clock_s, *truth[:2]))
        if self._frame is None:
            state = step.state
            outside = truth or (state.x_in, state.y_in, state.steering_rad)
            self._frame = _frame_at(step.pose, np.array(outside))
        if self._clock() < self._due_s:
            return
        self._due_s = self._clock() + PERIOD_S
        # 2. Walls and points of a new solution.
        if mapper.rounds != self._rounds and mapper.estimate is not None:
            self._rounds = mapper.rounds
            self._draw(mapper.estimate)
        pose = compose(self._frame, step.pose)
        self._send({"robot": truths.robot_id, "elapsed_s": step.elapsed_s, "pose": pose.tolist(), "outcome": ""})

    def finish(self, estimate: MapEstimate, outcome: str) -> None:
        """Publish the final map, and what has become of it."""
        if self._last is not None and self._frame is not None:
            self._draw(estimate)
            pose = compose(self._frame, estimate.state.poses[-1])
            self._send(self._last | {"pose": pose.tolist(), "outcome": outcome})

    def close(self) -> None:
        """Close the connection."""
        self._publisher.close()

    def _draw(self, estimate: MapEstimate) -> None:
        """Bring the walls and points of an estimate into the frame of the page."""
        path = estimate.state.poses[:, :2]
        instants_s = estimate.problem.trajectory.instants_s[: len(path)]
        if len(self._truth) > 1:
            times, *columns = np.array(self._truth).T
            is_timed = (instants_s >= times[0]) & (instants_s <= times[-1])
            if is_timed.sum() > 1:
                targets = np.stack([np.interp(instants_s[is_timed], times, column) for column in columns], -1)
                turn, shift = rigid_fit(path[is_timed], targets)
                self._frame = np.array((*shift, turn))
        frame = np.zeros(POSE) if self._frame is None else self._frame
        walls = extract_walls(estimate)
        self._drawn = {
            "walls": [
                {"ends": _placed(frame, wall.ends).round(2).tolist(), "is_uncertain": is_uncertain(wall)}
                for wall in walls
            ],
            "points": _placed(frame, estimate.state.points).round(2).tolist(),
        }

    def _send(self, message: dict[str, Any]) -> None:
        self._last = message | self._drawn
        self._publisher.publish(self._last)


def _placed(frame: Floats, places: Floats) -> Floats:
    """Return places (n, 2) of a frame at a pose (3,)."""
    return rotate(places, np.full(len(places), frame[HEADING])) + frame[:2]


def _frame_at(inside: Floats, outside: Floats) -> Floats:
    """Return the pose of a frame from the pose of one thing, given inside and outside the frame."""
    return compose(outside, relative_pose(inside, np.zeros(POSE)))
