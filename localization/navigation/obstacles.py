"""What stands in the room and not in the map: found by sonars that hear something too near, again and again.

    near      a reading shorter than anything of the map within the sonar's cone allows; second echoes by way of another
              wall are longer than the first, so they never are. It joins a find within JOIN_IN of it, or begins one
    through   a reading from beyond a find, its beam going through it: the find loses weight
    sure      a find of SURE readings of late; it stays until its weight is below GONE

Chance readings (cross-talk, noise) seldom fall together, and the next ring sees through them. Weights fade with time,
for things are moved. What a bumper felt is sure at once, and sonars do not see through it: they may miss it.
Rules: pure; readings with their poses in, short segments out, as if they were walls. One who is lost adds nothing.

What the sonars of a robot on an estimate say of things that the map does not have, and to its filter.

    take_in    the echoes of an estimate, each at the place it was heard at, into the finds
    spared     a state whose readings that are nearer than the map allows say "no nearer" instead: they are of something
               else, and would pull an estimate to a wall that they are not of (a novelty filter: Fox, Burgard, Thrun,
               Cremers 1998). Where more than MOST_SPARED are so, the estimate is to blame and must hear them all

Rules: pure; estimates and states in, nothing asked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, exp, hypot, sin
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.filters.health import HealthStatus
from localization.live.localizer import Estimate
from localization.live.sensor_input import SensorInput, with_readings
from localization.navigation.path import angle_difference
from nclient.state import RobotState
from worlds.raycast import cast_rays

JOIN_IN: Final = 5.0
SURE, GONE, MOST = 2.5, 1.0, 6.0
FADE_S: Final = 20.0
"""A find that is never looked at again loses two thirds of its weight in this time."""
SEEN_THROUGH: Final = 0.7
THROUGH_RAD, THROUGH_IN = 0.1, 4.0
"""How near its axis a beam must pass, and how far beyond a reading must be, to have gone through."""
NEAREST_IN, FARTHEST_IN = 6.0, 60.0
"""Readings looked at: nearer ones are dead sonars', farther ones wait until they matter."""
MOST_STD_IN: Final = 1.5
"""One who knows no better where he is adds nothing."""
HALF_WIDTH_IN: Final = 5.0
"""Of the segment that stands for a find, across the beams that found it: half of what lies between two at 24 in."""
Point = tuple[float, float]
Mask = np.typing.NDArray[np.bool_]
_FAN_RAD: Final = np.radians(np.linspace(-16.0, 16.0, 17))
_TOLERANCE_IN, _TOLERANCE_SHARE = 3.0, 0.03


@dataclass(slots=True)
class Obstacle:
    x_in: float
    y_in: float
    towards_rad: float
    weight: float
    felt: bool = False
    sure: bool = False


class ObstacleTracker:
    """The finds of a robot with sonars `ring_in` from its axis, in a map of walls (m, 4)."""

    def __init__(self, walls: Floats, ring_in: float) -> None:
        self._walls, self._ring_in = np.asarray(walls, dtype=np.float64).reshape(-1, 4), ring_in
        self._corners = np.unique(self._walls.reshape(-1, 2), axis=0)
        self._finds: list[Obstacle] = []
        self._clock_s = 0.0

    @property
    def segments(self) -> Floats:
        """What is sure, as walls (k, 4)."""
        return self._as_walls([find for find in self._finds if find.sure])

    @property
    def suspects(self) -> Floats:
        """What may be there and was not heard often enough, as walls (k, 4)."""
        return self._as_walls([find for find in self._finds if not find.sure])

    @staticmethod
    def _as_walls(finds: list[Obstacle]) -> Floats:
        rows = []
        for find in finds:
            dx, dy = -HALF_WIDTH_IN * sin(find.towards_rad), HALF_WIDTH_IN * cos(find.towards_rad)
            rows.append((find.x_in - dx, find.y_in - dy, find.x_in + dx, find.y_in + dy))
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    def forget(self) -> None:
        """Drop all: who was lost saw them elsewhere."""
        self._finds.clear()

    def too_near(self, place: Point, towards_rad: Floats, readings_in: Floats, std_in: float) -> Mask:
        """Which readings (n,) of sonars of a robot at `place`, known to `std_in`, looking `towards_rad` (n,) in the
        map, are nearer than anything of the map can be."""
        near: Mask = (readings_in >= NEAREST_IN) & (readings_in <= FARTHEST_IN)
        if std_in > MOST_STD_IN or not near.any():
            return np.zeros(len(near), dtype=np.bool_)
        ranges = readings_in[near] + self._ring_in
        tolerance = _TOLERANCE_IN + _TOLERANCE_SHARE * ranges + 3.0 * std_in
        near[near] = ranges < self._nearest_of_map(place, towards_rad[near]) - tolerance
        return near

    def hear(self, clock_s: float, place: Point, towards_rad: float, reading_in: float, std_in: float) -> None:
        """Take in such a reading."""
        self._fade(clock_s)
        if reading_in < NEAREST_IN or std_in > MOST_STD_IN:
            return
        range_in = reading_in + self._ring_in
        self._see_through(place, towards_rad, range_in)
        if self.too_near(place, np.array([towards_rad]), np.array([reading_in]), std_in)[0]:
            self._add(place[0] + range_in * cos(towards_rad), place[1] + range_in * sin(towards_rad), towards_rad)

    def touch(self, clock_s: float, place: Point, towards_rad: float, body_in: float) -> None:
        """Something was felt by a body of that radius on its way towards there."""
        self._fade(clock_s)
        x, y = place[0] + body_in * cos(towards_rad), place[1] + body_in * sin(towards_rad)
        self._finds.append(Obstacle(x, y, towards_rad, MOST, felt=True, sure=True))

    def _fade(self, clock_s: float) -> None:
        share = exp(-max(0.0, clock_s - self._clock_s) / FADE_S)
        self._clock_s = max(clock_s, self._clock_s)
        for find in self._finds:
            find.weight *= share
        self._drop()

    def _drop(self) -> None:
        self._finds = [find for find in self._finds if find.weight >= (GONE if find.sure else 0.5)]

    def _see_through(self, place: Point, towards_rad: float, range_in: float) -> None:
        for find in self._finds:
            dx, dy = find.x_in - place[0], find.y_in - place[1]
            beside = abs(angle_difference(towards_rad, atan2(dy, dx)))
            if not find.felt and beside < THROUGH_RAD and hypot(dx, dy) < range_in - THROUGH_IN:
                find.weight *= SEEN_THROUGH
        self._drop()

    def _nearest_of_map(self, place: Point, towards_rad: Floats) -> Floats:
        """How near (n,) anything of the map is in cones about directions (n,): along fans of rays, and its corners."""
        if not len(self._walls):
            return np.full(len(towards_rad), np.inf)
        angles = towards_rad[:, None] + _FAN_RAD
        ways = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        axes = np.broadcast_to(np.array(place), ways.shape)
        nearest: Floats = cast_rays(axes, ways, self._walls)[0].min(axis=1)
        off = self._corners - np.array(place)
        beside = np.arctan2(off[:, 1], off[:, 0]) - towards_rad[:, None]
        far = np.where(np.cos(beside) >= np.cos(_FAN_RAD[-1]), np.hypot(off[:, 0], off[:, 1]), np.inf)
        return np.fmin(nearest, np.asarray(far.min(axis=1), dtype=np.float64))

    def _add(self, x_in: float, y_in: float, towards_rad: float) -> None:
        near = [find for find in self._finds if hypot(find.x_in - x_in, find.y_in - y_in) < JOIN_IN and not find.felt]
        if not near:
            self._finds.append(Obstacle(x_in, y_in, towards_rad, 1.0))
            return
        find = min(near, key=lambda find: hypot(find.x_in - x_in, find.y_in - y_in))
        share = 1.0 / (find.weight + 1.0)
        find.x_in += share * (x_in - find.x_in)
        find.y_in += share * (y_in - find.y_in)
        find.towards_rad += share * angle_difference(find.towards_rad, towards_rad)
        find.weight = min(MOST, find.weight + 1.0)
        find.sure = find.sure or find.weight >= SURE


MOST_SPARED: Final = 6


def filter_unmapped(
    unmapped: ObstacleTracker, estimate: Estimate, state: RobotState, angles_rad: Sequence[float]
) -> SensorInput:
    """The state for the filter whose last estimate is given; the sonars stand at `angles_rad` on the turret."""
    readings = state.sonars_in
    if estimate.health.status is not HealthStatus.LOST:
        x, y, heading = (float(value) for value in estimate.pose)
        looking, std = heading + state.turret_rad - state.steering_rad, _std_in(estimate)
        near = unmapped.too_near((x, y), looking + np.asarray(angles_rad), np.array(readings, dtype=np.float64), std)
        if sum(near) <= MOST_SPARED:
            readings = tuple(int(NEAREST_IN) if hidden else told for hidden, told in zip(near, readings, strict=True))
    return with_readings(state, readings)


def update_obstacles(
    unmapped: ObstacleTracker, estimate: Estimate, state: RobotState, angles_rad: Sequence[float]
) -> None:
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
