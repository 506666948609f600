"""Obstacles that the map does not contain, found by sonar readings that are repeatedly too short.

    too short    a reading shorter than anything of the map within the sonar's cone allows. Echoes over a second wall
                 are longer than the direct one, so they never are too short. The reading joins an obstacle within
                 JOIN_IN, or starts a new one.
    through      a reading from beyond an obstacle whose beam passes through it: the obstacle loses weight
    confirmed    an obstacle with CONFIRM_WEIGHT recent readings; it remains until its weight is below REMOVE_WEIGHT

Random errors (cross-talk, noise) rarely coincide, and the next cycle of the ring measures through them. Weights decay
with time, because things are moved. An obstacle detected by a bumper is confirmed at once and not removed by sonar
readings, which may miss it. An estimate that is lost adds nothing.

The estimate's filter must not use these readings: they belong to no wall of the map (`filter_unmapped`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, exp, hypot, remainder, sin, tau
from typing import Final

import numpy as np

from localization.filters.belief import Floats
from localization.live.estimate import Estimate
from localization.live.sensor_input import SensorInput, sonar_readings, with_readings
from nclient.state import RobotState
from worlds.raycast_arrays import cast_rays

JOIN_IN: Final = 5.0
"""Readings within this distance belong to one obstacle."""
CONFIRM_WEIGHT, REMOVE_WEIGHT, MAX_WEIGHT = 2.5, 1.0, 6.0
REMOVE_TENTATIVE_WEIGHT: Final = 0.5
DECAY_S: Final = 20.0
"""Time constant of the weights: without new readings two thirds are lost in this time."""
THROUGH_FACTOR: Final = 0.7
"""Factor on the weight for each reading through an obstacle."""
THROUGH_RAD, THROUGH_IN = 0.1, 4.0
"""How near its axis a beam must pass, and how far beyond a reading must lie, to count as through."""
MIN_RANGE_IN, MAX_RANGE_IN = 6.0, 60.0
"""Readings considered: shorter ones are in the sonar's dead zone, longer ones do not matter yet."""
MAX_STD_IN: Final = 1.5
"""With a larger position uncertainty no readings are added."""
HALF_WIDTH_IN: Final = 5.0
"""Half length of the segment that represents an obstacle: half the distance of two beams at 24 in."""
MAX_FILTERED: Final = 6
"""If more readings of one state are too short, the estimate is wrong and must receive them all."""
_CONE_RAD: Final = np.radians(np.linspace(-16.0, 16.0, 17))
"""Directions within a sonar's cone."""
_TOLERANCE_IN, _TOLERANCE_FRACTION = 3.0, 0.03
Point = tuple[float, float]
Mask = np.typing.NDArray[np.bool_]


@dataclass(slots=True)
class Obstacle:
    """One obstacle: position (in), direction of the beams that found it, weight in readings."""

    x_in: float
    y_in: float
    direction_rad: float
    weight: float
    from_bumper: bool = False
    is_confirmed: bool = False


class ObstacleTracker:
    """Obstacles of a robot in a map.

    Parameters
    ----------
    walls : (m, 4) array
        Walls of the map, inches.
    ring_in : float
        Distance of the sonars from the robot's axis, inches.
    """

    def __init__(self, walls: Floats, ring_in: float) -> None:
        self._walls, self._ring_in = np.asarray(walls, dtype=np.float64).reshape(-1, 4), ring_in
        self._corners = np.unique(self._walls.reshape(-1, 2), axis=0)
        self._obstacles: list[Obstacle] = []
        self._clock_s = 0.0

    @property
    def confirmed(self) -> Floats:
        """Confirmed obstacles as segments (k, 4)."""
        return self._segments([obstacle for obstacle in self._obstacles if obstacle.is_confirmed])

    @property
    def tentative(self) -> Floats:
        """Obstacles without enough readings yet, as segments (k, 4)."""
        return self._segments([obstacle for obstacle in self._obstacles if not obstacle.is_confirmed])

    @staticmethod
    def _segments(obstacles: list[Obstacle]) -> Floats:
        rows = []
        for obstacle in obstacles:
            # Across the beam, HALF_WIDTH_IN to either side.
            dx, dy = -HALF_WIDTH_IN * sin(obstacle.direction_rad), HALF_WIDTH_IN * cos(obstacle.direction_rad)
            rows.append((obstacle.x_in - dx, obstacle.y_in - dy, obstacle.x_in + dx, obstacle.y_in + dy))
        return np.array(rows, dtype=np.float64).reshape(-1, 4)

    def clear(self) -> None:
        """Remove all obstacles, because the estimate that located them was wrong."""
        self._obstacles.clear()

    def find_unmapped(self, position: Point, directions_rad: Floats, readings_in: Floats, std_in: float) -> Mask:
        """Return True (n,) for readings shorter than anything of the map allows.

        Parameters
        ----------
        position : (x, y)
            Estimated position of the robot, inches.
        directions_rad, readings_in : (n,) array
            Directions of the sonars in the map, and their readings.
        std_in : float
            Standard deviation of the position along its worst direction.
        """
        near: Mask = (readings_in >= MIN_RANGE_IN) & (readings_in <= MAX_RANGE_IN)
        if std_in > MAX_STD_IN or not near.any():
            return np.zeros(len(near), dtype=np.bool_)
        ranges = readings_in[near] + self._ring_in
        tolerance = _TOLERANCE_IN + _TOLERANCE_FRACTION * ranges + 3.0 * std_in
        near[near] = ranges < self._map_ranges(position, directions_rad[near]) - tolerance
        return near

    def add_reading(self, clock_s: float, position: Point, direction_rad: float, reading_in: float,
                    std_in: float) -> None:
        """Process one reading of a sonar that looks in this direction of the map."""
        self._decay(clock_s)
        if reading_in < MIN_RANGE_IN or std_in > MAX_STD_IN:
            return
        range_in = reading_in + self._ring_in
        self._weaken_passed(position, direction_rad, range_in)
        if self.find_unmapped(position, np.array([direction_rad]), np.array([reading_in]), std_in)[0]:
            self._add(position[0] + range_in * cos(direction_rad), position[1] + range_in * sin(direction_rad),
                      direction_rad)

    def add_contact(self, clock_s: float, position: Point, direction_rad: float, body_in: float) -> None:
        """Add an obstacle detected by a bumper of a robot of radius `body_in` that drove in this direction."""
        self._decay(clock_s)
        x, y = position[0] + body_in * cos(direction_rad), position[1] + body_in * sin(direction_rad)
        self._obstacles.append(Obstacle(x, y, direction_rad, MAX_WEIGHT, from_bumper=True, is_confirmed=True))

    def _decay(self, clock_s: float) -> None:
        factor = exp(-max(0.0, clock_s - self._clock_s) / DECAY_S)
        self._clock_s = max(clock_s, self._clock_s)
        for obstacle in self._obstacles:
            obstacle.weight *= factor
        self._remove_weak()

    def _remove_weak(self) -> None:
        self._obstacles = [
            obstacle
            for obstacle in self._obstacles
            if obstacle.weight >= (REMOVE_WEIGHT if obstacle.is_confirmed else REMOVE_TENTATIVE_WEIGHT)
        ]

    def _weaken_passed(self, position: Point, direction_rad: float, range_in: float) -> None:
        """Reduce the weight of obstacles that a beam of this range passed through."""
        for obstacle in self._obstacles:
            dx, dy = obstacle.x_in - position[0], obstacle.y_in - position[1]
            off_axis = abs(remainder(atan2(dy, dx) - direction_rad, tau))
            if not obstacle.from_bumper and off_axis < THROUGH_RAD and hypot(dx, dy) < range_in - THROUGH_IN:
                obstacle.weight *= THROUGH_FACTOR
        self._remove_weak()

    def _map_ranges(self, position: Point, directions_rad: Floats) -> Floats:
        """Return the shortest range (n,) to anything of the map within cones about directions (n,)."""
        if not len(self._walls):
            return np.full(len(directions_rad), np.inf)
        # 1. Cast a fan of rays in each cone.
        angles = directions_rad[:, None] + _CONE_RAD
        rays = np.stack((np.cos(angles), np.sin(angles)), axis=-1)
        origins = np.broadcast_to(np.array(position), rays.shape)
        nearest: Floats = cast_rays(origins, rays, self._walls)[0].min(axis=1)
        # 2. Add the corners, which lie between rays.
        offset = self._corners - np.array(position)
        off_axis = np.arctan2(offset[:, 1], offset[:, 0]) - directions_rad[:, None]
        corners = np.where(np.cos(off_axis) >= np.cos(_CONE_RAD[-1]), np.hypot(offset[:, 0], offset[:, 1]), np.inf)
        return np.fmin(nearest, np.asarray(corners.min(axis=1), dtype=np.float64))

    def _add(self, x_in: float, y_in: float, direction_rad: float) -> None:
        """Merge a point into the nearest obstacle, or start a new one."""

        def distance(obstacle: Obstacle) -> float:
            return hypot(obstacle.x_in - x_in, obstacle.y_in - y_in)

        near = [obstacle for obstacle in self._obstacles if distance(obstacle) < JOIN_IN and not obstacle.from_bumper]
        if not near:
            self._obstacles.append(Obstacle(x_in, y_in, direction_rad, 1.0))
            return
        obstacle = min(near, key=distance)
        # Weighted mean of position and direction.
        gain = 1.0 / (obstacle.weight + 1.0)
        obstacle.x_in += gain * (x_in - obstacle.x_in)
        obstacle.y_in += gain * (y_in - obstacle.y_in)
        obstacle.direction_rad += gain * remainder(direction_rad - obstacle.direction_rad, tau)
        obstacle.weight = min(MAX_WEIGHT, obstacle.weight + 1.0)
        obstacle.is_confirmed = obstacle.is_confirmed or obstacle.weight >= CONFIRM_WEIGHT


def filter_unmapped(obstacles: ObstacleTracker, estimate: Estimate, state: RobotState, angles_rad: Sequence[float],
                    shortest_in: float = int(MIN_RANGE_IN)) -> SensorInput:  # fmt: skip
    """Return the state for the filter, with readings from unmapped obstacles replaced by the shortest range.

    The filter ignores readings at the shortest range. If more than MAX_FILTERED readings are too short the estimate
    is probably wrong, and the filter receives them all.

    Parameters
    ----------
    obstacles : ObstacleTracker
    estimate : Estimate
        The filter's last estimate.
    state : RobotState
        The new state.
    angles_rad : sequence of float
        Angles of the sonars on the turret.
    shortest_in : float
        The shortest range of the ring.

    References
    ----------
    The novelty filter of Fox, Burgard, Thrun, Cremers: Position estimation for mobile robots in dynamic
    environments (1998).
    """
    readings = sonar_readings(state)[: len(angles_rad)]
    if not estimate.health.is_lost:
        x, y, heading = (float(value) for value in estimate.pose)
        directions = heading + state.turret_rad - state.steering_rad + np.asarray(angles_rad)
        near = obstacles.find_unmapped((x, y), directions, np.array(readings, dtype=np.float64),
                                       position_std_in(estimate))
        if sum(near) <= MAX_FILTERED:
            readings = tuple(
                shortest_in if is_unmapped else reading
                for is_unmapped, reading in zip(near, readings, strict=True)
            )
    return with_readings(state, readings)


def update_obstacles(obstacles: ObstacleTracker, estimate: Estimate, state: RobotState,
                     angles_rad: Sequence[float]) -> None:
    """Add an estimate's echoes to the obstacles.

    Each echo was measured up to 0.2 s before the estimate: the motion since then is subtracted, at the velocities of
    the state.
    """
    if estimate.health.is_lost:
        obstacles.clear()
        return
    x, y, heading = (float(value) for value in estimate.pose)
    offset, std, readings = state.turret_rad - state.steering_rad, position_std_in(estimate), sonar_readings(state)
    for echo in estimate.echoes:
        # 1. Pose at the time of the echo, on the chord of the arc driven since.
        age_s = estimate.clock_s - echo.instant_s
        then = heading - age_s * state.steering_rad_s
        middle, distance = 0.5 * (heading + then), age_s * state.translation_in_s
        position = (x - distance * cos(middle), y - distance * sin(middle))
        # 2. The reading from there.
        reading = float(readings[echo.sonar])
        obstacles.add_reading(echo.instant_s, position, then + offset + angles_rad[echo.sonar], reading, std)


def position_std_in(estimate: Estimate) -> float:
    """Return the standard deviation of the position along its worst direction, inches."""
    return float(np.sqrt(np.linalg.eigvalsh(estimate.belief.cov[:2, :2])[-1]))
