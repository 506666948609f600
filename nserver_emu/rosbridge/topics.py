"""ROS messages of a robot's state, as JSON objects: metres, radians, the frames of REP-103 and REP-105.

    /robotN/odom          nav_msgs/Odometry          odom -> base_link
    /robotN/sonar         sensor_msgs/LaserScan      in the frame turret, counter-clockwise from ahead
    /robotN/sonar/K       sensor_msgs/Range          sonar K, in its own frame
    /robotN/bumpers       std_msgs/UInt32            bits of State[33]
    /robotN/battery       sensor_msgs/BatteryState   of the motors
    /robotN/pose          geometry_msgs/PoseWithCovarianceStamped    the published estimate, in the frame map
    /robotN/cmd_vel       geometry_msgs/Twist        from programs: m/s and rad/s
    /tf                   tf2_msgs/TFMessage
    /map                  nav_msgs/OccupancyGrid     the world

Frames of robot N begin with `robotN/`. JSON has no infinity: as in rosbridge, null stands for the +inf of REP-117, no
echo. A wall nearer than a sonar measures reads as its minimum.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.protocol.types import M_PER_IN, MAX_SONAR_IN, MIN_SONAR_IN, SCOUT_WHEEL_IN_PER_DEG, SONAR_SLOTS
from worlds.cells import Cell, OccupancyGrid

Message = dict[str, Any]
ODOMETRY, SCAN, RANGE = "nav_msgs/Odometry", "sensor_msgs/LaserScan", "sensor_msgs/Range"
NUMBER, BATTERY, ESTIMATE = "std_msgs/UInt32", "sensor_msgs/BatteryState", "geometry_msgs/PoseWithCovarianceStamped"
TWIST, TRANSFORMS, GRID = "geometry_msgs/Twist", "tf2_msgs/TFMessage", "nav_msgs/OccupancyGrid"
TF, MAP, MAP_FRAME = "/tf", "/map", "map"
_HALF_CONE_RAD: Final = math.radians(12.5)
_ULTRASOUND: Final = 0
_TENTH_M: Final = M_PER_IN / 10
_TENTH_RAD: Final = math.radians(0.1)
# Places in the State vector (docs/protocol.md).
_SONARS, _BUMPER, _X = 17, 33, 34
_MAX_TENTHS: Final = 32767
"""Largest number that a robot's serial line carries."""


class Reading(NamedTuple):
    """State[0..44] of a robot, and its motors' battery in volts if known; `stamp_s` is Unix time."""

    robot: int
    state: Sequence[int]
    is_differential: bool
    stamp_s: float
    volts: float | None = None

    @property
    def pose(self) -> tuple[float, float, float]:
        """Return x, y in metres and heading in radians, by odometry."""
        x, y, steer = self.state[_X : _X + 3]
        return x * _TENTH_M, y * _TENTH_M, math.remainder(steer * _TENTH_RAD, math.tau)

    @property
    def turret_rad(self) -> float:
        """Return the direction of the turret relative to the base."""
        return math.remainder((self.state[_X + 3] - self.state[_X + 2]) * _TENTH_RAD, math.tau)

    @property
    def velocity(self) -> tuple[float, float]:
        """Return the velocity ahead in m/s and of turning in rad/s."""
        first, second = self.state[_X + 4 : _X + 6]
        if self.is_differential:
            # Right and left wheel.
            turn_tenths = (first - second) / 2 / SCOUT_WHEEL_IN_PER_DEG
            return (first + second) / 2 * _TENTH_M, turn_tenths * _TENTH_RAD
        return first * _TENTH_M, second * _TENTH_RAD


def topic_types(robots: Sequence[int]) -> dict[str, str]:
    """Return the types of all topics that are published, by name."""
    types = {TF: TRANSFORMS, MAP: GRID}
    for robot in robots:
        base = f"/robot{robot}"
        types |= {f"{base}/odom": ODOMETRY, f"{base}/sonar": SCAN, f"{base}/bumpers": NUMBER}
        types |= {f"{base}/battery": BATTERY, f"{base}/pose": ESTIMATE}
        types |= {f"{base}/sonar/{k}": RANGE for k in range(SONAR_SLOTS)}
    return types


def command_types(robots: Sequence[int]) -> dict[str, str]:
    """Return the types of all topics that programs may publish, by name."""
    return {f"/robot{robot}/cmd_vel": TWIST for robot in robots}


def messages_of(reading: Reading) -> Iterator[tuple[str, Message]]:
    """Yield the topics of a robot's state, except /tf."""
    base, frame = f"/robot{reading.robot}", f"robot{reading.robot}"
    (x, y, heading), (speed, turn) = reading.pose, reading.velocity
    no_covariance = [0.0] * 36
    yield f"{base}/odom", {
        "header": header(reading.stamp_s, f"{frame}/odom"), "child_frame_id": f"{frame}/base_link",
        "pose": {"pose": pose(x, y, heading), "covariance": no_covariance},
        "twist": {"twist": {"linear": vector(speed), "angular": vector(z=turn)}, "covariance": no_covariance},
    }
    ranges = [None if value >= MAX_SONAR_IN else value * M_PER_IN for value in sonars(reading)]
    step = math.tau / SONAR_SLOTS
    yield f"{base}/sonar", {
        "header": header(reading.stamp_s, f"{frame}/turret"), "angle_min": 0.0, "angle_max": math.tau - step,
        "angle_increment": step, "time_increment": 0.0, "scan_time": 0.0, "range_min": MIN_SONAR_IN * M_PER_IN,
        "range_max": MAX_SONAR_IN * M_PER_IN, "ranges": ranges, "intensities": [],
    }
    for k, range_m in enumerate(ranges):
        yield f"{base}/sonar/{k}", {
            "header": header(reading.stamp_s, f"{frame}/sonar_{k}"), "radiation_type": _ULTRASOUND,
            "field_of_view": 2 * _HALF_CONE_RAD, "min_range": MIN_SONAR_IN * M_PER_IN,
            "max_range": MAX_SONAR_IN * M_PER_IN, "range": range_m,
        }
    yield f"{base}/bumpers", {"data": reading.state[_BUMPER]}
    if reading.volts is not None:
        yield f"{base}/battery", {
            "header": header(reading.stamp_s, f"{frame}/base_link"), "voltage": reading.volts, "present": True,
            "location": "motors", "percentage": None, "current": None, "charge": None,
        }


def sonars(reading: Reading) -> Sequence[int]:
    """Return the sixteen sonars of State in inches."""
    return reading.state[_SONARS : _SONARS + SONAR_SLOTS]


def transforms(reading: Reading, ring_radius_m: float, map_to_odom: tuple[float, float, float] | None) -> list[Message]:
    """Return the frames of a robot: map to odom if it is localized, odom to base_link to turret to each sonar."""
    frame, (x, y, heading) = f"robot{reading.robot}", reading.pose
    found = [] if map_to_odom is None else [_transform(reading.stamp_s, MAP_FRAME, f"{frame}/odom", *map_to_odom)]
    found.append(_transform(reading.stamp_s, f"{frame}/odom", f"{frame}/base_link", x, y, heading))
    found.append(_transform(reading.stamp_s, f"{frame}/base_link", f"{frame}/turret", 0.0, 0.0, reading.turret_rad))
    for k in range(SONAR_SLOTS):
        angle = math.tau * k / SONAR_SLOTS
        place = ring_radius_m * math.cos(angle), ring_radius_m * math.sin(angle)
        found.append(_transform(reading.stamp_s, f"{frame}/turret", f"{frame}/sonar_{k}", *place, angle))
    return found


def estimate_message(estimate: Mapping[str, Any], stamp_s: float) -> Message:
    """Return a published estimate, which is in inches and radians, as PoseWithCovarianceStamped."""
    x, y, heading = estimate["pose"]
    # 1. Covariance of x, y, heading: rows and columns 0, 1 and 5 of the six of a pose.
    covariance, units, places = [0.0] * 36, (M_PER_IN, M_PER_IN, 1.0), (0, 1, 5)
    for row in range(3):
        for column in range(3):
            value = estimate["cov"][3 * row + column] * units[row] * units[column]
            covariance[6 * places[row] + places[column]] = value
    # 2. The pose in the frame of the map.
    at = pose(x * M_PER_IN, y * M_PER_IN, heading)
    return {"header": header(stamp_s, MAP_FRAME), "pose": {"pose": at, "covariance": covariance}}


def map_to_odom(estimate: Mapping[str, Any]) -> tuple[float, float, float]:
    """Return the transform from map to odom of an estimate and the odometry that belongs to it (REP-105)."""
    x, y, heading = estimate["pose"]
    odom_x, odom_y, odom_heading = estimate["odometry"]
    turn = math.remainder(heading - odom_heading, math.tau)
    cos, sin = math.cos(turn), math.sin(turn)
    return (x - cos * odom_x + sin * odom_y) * M_PER_IN, (y - sin * odom_x - cos * odom_y) * M_PER_IN, turn


def grid_message(grid: OccupancyGrid, stamp_s: float) -> Message:
    """Return a world as OccupancyGrid: 100 occupied, 0 free, -1 unknown, rows along y."""
    values = np.full(len(Cell), -1)
    values[Cell.OCCUPIED], values[Cell.FREE] = 100, 0
    width, height = grid.cells.shape
    data = values[grid.cells.T.reshape(-1)].tolist()
    x, y = grid.origin_in
    info = {"map_load_time": stamp(stamp_s), "resolution": grid.size_in * M_PER_IN, "width": width, "height": height,
            "origin": pose(x * M_PER_IN, y * M_PER_IN, grid.turn_rad)}  # fmt: skip
    return {"header": header(stamp_s, MAP_FRAME), "info": info, "data": data}


def velocities(twist: Any, is_differential: bool) -> list[int]:
    """Return the arguments of vm for a Twist: translation, steering and turret, or a Scout's right and left wheel.

    The turret turns with the base, as the frames of a robot without a turret do.

    Raises
    ------
    ValueError
        If linear.x or angular.z is no finite number; parts that are left out are 0.
    """
    speed_tenths = _limited(_component(twist, "linear", "x") / _TENTH_M)
    turn_tenths = _limited(_component(twist, "angular", "z") / _TENTH_RAD)
    if is_differential:
        difference = turn_tenths * SCOUT_WHEEL_IN_PER_DEG
        numbers = (speed_tenths + difference, speed_tenths - difference, 0.0)
    else:
        numbers = (speed_tenths, turn_tenths, turn_tenths)
    return [round(_limited(number)) for number in numbers]


def _limited(tenths: float) -> float:
    return max(-_MAX_TENTHS, min(_MAX_TENTHS, tenths))


def _component(twist: Any, part: str, axis: str) -> float:
    vector = twist.get(part, {}) if isinstance(twist, dict) else None
    value = vector.get(axis, 0.0) if isinstance(vector, dict) else None
    try:
        # A whole number of JSON may have any number of digits.
        number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"a Twist has numbers linear.x and angular.z; {part}.{axis} is {value!r:.40}")
    return number


def stamp(time_s: float) -> Message:
    """Return a time of ROS."""
    return {"secs": int(time_s), "nsecs": int(time_s % 1 * 1e9)}


def header(time_s: float, frame: str) -> Message:
    """Return a header of ROS."""
    return {"stamp": stamp(time_s), "frame_id": frame}


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Message:
    """Return a Vector3 or Point."""
    return {"x": x, "y": y, "z": z}


def pose(x: float, y: float, angle_rad: float) -> Message:
    """Return a Pose in the plane."""
    return {"position": vector(x, y), "orientation": _rotation(angle_rad)}


def _rotation(angle_rad: float) -> Message:
    return vector() | {"z": math.sin(angle_rad / 2), "w": math.cos(angle_rad / 2)}


def _transform(time_s: float, parent: str, child: str, x: float, y: float, angle_rad: float) -> Message:
    moved = {"translation": vector(x, y), "rotation": _rotation(angle_rad)}
    return {"header": header(time_s, parent), "child_frame_id": child, "transform": moved}
