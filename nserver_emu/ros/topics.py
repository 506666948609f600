"""Topics of robots, for rosbridge and for ROS 2 by DDS, and their messages from a robot's state.

    /robotN/odom          nav_msgs/Odometry          odom -> base_link
    /robotN/sonar         sensor_msgs/LaserScan      from the axis, the frame turret, counter-clockwise from ahead;
                                                     only if the sonars are on a circle at equal angles
    /robotN/sonar/K       sensor_msgs/Range          sonar K, in its own frame
    /robotN/bumpers       std_msgs/UInt32            bits of State[33]
    /robotN/battery       sensor_msgs/BatteryState   of the motors
    /robotN/pose          geometry_msgs/PoseWithCovarianceStamped    the published estimate, in the frame map
    /robotN/cmd_vel       geometry_msgs/Twist        from programs: m/s and rad/s
    /tf                   tf2_msgs/TFMessage         frames that move
    /tf_static            tf2_msgs/TFMessage         the sonars' frames
    /map                  nav_msgs/OccupancyGrid     the world

Frames of robot N begin with `robotN/`. Messages have the form of nclient/recording/ros_messages.py.

Readings of a daemon's robots as ROS messages, for rosbridge and for ROS 2 by DDS.

Simulated robots are read without a request, so that watching does not feed a program's motion timeout; a real one is
asked by gs, one question at a time.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.protocol.replies import Reply
from nclient.protocol.types import M_PER_IN, MOTOR_RANGE_V, SCOUT_WHEEL_IN_PER_DEG, SONAR_SLOTS, volts
from nclient.recording import ros_messages
from nclient.recording.ros_messages import BATTERY, ODOMETRY, SCAN, TF, TRANSFORMS, Message, Pose2
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.server_state import state_slots
from nserver_emu.simulation.robot import battery_v
from nserver_emu.viewer.clients import Answer, ErrorBoundary, ViewerClients
from nserver_emu.viewer.messages import STALE_S
from worlds.cells import Cell, OccupancyGrid, cells_of_world
from worlds.rings import Ring
from worlds.robots import N150
from worlds.world import World

_TENTH_M: Final = M_PER_IN / 10
_TENTH_RAD: Final = math.radians(0.1)
# Places in the State vector (docs/protocol.md).
_SONARS, _BUMPER, _X = 17, 33, 34
_MAX_TENTHS: Final = 32767
"""Largest number that a robot's serial line carries."""
_ROUNDING_RAD: Final = 1e-6


class Reading(NamedTuple):
    """State[0..44] of a robot, and its motors' battery in volts if known; `time_ns` is Unix time.

    `readings_in` are those of a ring that State has no room for.
    """

    robot: int
    state: Sequence[int]
    is_differential: bool
    time_ns: int
    volts: float | None = None
    ring: Ring = N150.ring
    readings_in: Sequence[float] = ()

    @property
    def pose(self) -> Pose2:
        """Return x, y in metres and heading in radians, by odometry."""
        x, y, steer = self.state[_X : _X + 3]
        return x * _TENTH_M, y * _TENTH_M, math.remainder(steer * _TENTH_RAD, math.tau)

    @property
    def sonars(self) -> Sequence[float]:
        """Return the sonars in inches, at most sixteen where they are those of State."""
        return self.readings_in or self.state[_SONARS : _SONARS + min(SONAR_SLOTS, self.ring.count)]

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


def topic_types(rings: Mapping[int, Ring]) -> dict[str, str]:
    """Return the types of all topics that are published, by name; `rings` are those of the robots."""
    types = {TF: TRANSFORMS, ros_messages.TF_STATIC: TRANSFORMS, ros_messages.MAP: ros_messages.GRID}
    for robot, ring in rings.items():
        base = f"/robot{robot}"
        types |= {f"{base}/odom": ODOMETRY, f"{base}/bumpers": ros_messages.NUMBER}
        types |= {f"{base}/battery": BATTERY, f"{base}/pose": ros_messages.ESTIMATE}
        types |= {f"{base}/sonar": SCAN} if is_scan(ring) else {}
        types |= {f"{base}/sonar/{k}": ros_messages.RANGE for k in range(ring.count)}
    return types


def is_scan(ring: Ring) -> bool:
    """Return True if a LaserScan can hold the readings: beams at equal angles that begin on a circle."""
    steps = [math.remainder(later - earlier, math.tau) for earlier, later in pairwise(ring.angles_rad)]
    return not ring.shifts_in and all(abs(math.remainder(step - steps[0], math.tau)) < _ROUNDING_RAD for step in steps)


def command_types(robots: Iterable[int]) -> dict[str, str]:
    """Return the types of all topics that programs may publish, by name."""
    return {f"/robot{robot}/cmd_vel": ros_messages.TWIST for robot in robots}


def messages_of(reading: Reading) -> Iterator[tuple[str, Message]]:
    """Yield the topics of a robot's state, except frames."""
    base, frame, time_ns = f"/robot{reading.robot}", frame_of(reading.robot), reading.time_ns
    yield f"{base}/odom", ros_messages.odometry(time_ns, frame, reading.pose, *reading.velocity)
    ring = reading.ring
    limits_m = ring.min_range_in * M_PER_IN, ring.max_range_in * M_PER_IN
    readings_m = (math.inf if one == ring.no_echo_in or one >= ring.max_range_in else one * M_PER_IN
                  for one in reading.sonars)
    ranges = [ros_messages.range_m(one, limits_m[0]) for one in readings_m]
    if is_scan(ring):
        angles_rad = ring.angles_rad[: len(ranges)]
        yield f"{base}/sonar", ros_messages.scan(
            time_ns, frame, ranges, angles_rad, ring.radius_in * M_PER_IN, limits_m
        )
    cone_rad = ros_messages.CONE_RAD if ring.half_cone_rad is None else 2.0 * ring.half_cone_rad
    for k, range_m in enumerate(ranges):
        yield f"{base}/sonar/{k}", ros_messages.sonar_range(time_ns, frame, k, range_m, limits_m, cone_rad)
    yield f"{base}/bumpers", {"data": reading.state[_BUMPER]}
    if reading.volts is not None:
        yield f"{base}/battery", ros_messages.battery(time_ns, f"{frame}/base_link", reading.volts, "motors")


def frame_of(robot: int) -> str:
    """Return the name that the frames of a robot begin with."""
    return f"robot{robot}"


def frames(reading: Reading, map_to_odom: Pose2 | None) -> Message:
    """Return the frames of a robot that move: map to odom if it is localized, odom to base_link to turret."""
    frame, time_ns = frame_of(reading.robot), reading.time_ns
    found = ros_messages.moving_frames(time_ns, frame, reading.pose, reading.turret_rad)
    if map_to_odom is not None:
        found.insert(0, ros_messages.transform(time_ns, ros_messages.MAP_FRAME, f"{frame}/odom", map_to_odom))
    return {"transforms": found}


def static_frames(rings: Mapping[int, Ring], time_ns: int) -> Message:
    """Return the frames of all sonars of all robots."""
    return {"transforms": [frame for robot, ring in rings.items()
                           for frame in ros_messages.sonar_frames(time_ns, frame_of(robot), _mounts(ring))]}


def _mounts(ring: Ring) -> list[Pose2]:
    places = map(ring.mount_in, range(ring.count))
    return [(x * M_PER_IN, y * M_PER_IN, angle) for (x, y), angle in zip(places, ring.angles_rad, strict=True)]


def estimate_message(estimate: Mapping[str, Any], time_ns: int) -> Message:
    """Return a published estimate, which is in inches and radians, as PoseWithCovarianceStamped."""
    x, y, heading = estimate["pose"]
    # 1. Covariance of x, y, heading: rows and columns 0, 1 and 5 of the six of a pose.
    covariance, units, places = [0.0] * 36, (M_PER_IN, M_PER_IN, 1.0), (0, 1, 5)
    for row in range(3):
        for column in range(3):
            value = estimate["cov"][3 * row + column] * units[row] * units[column]
            covariance[6 * places[row] + places[column]] = value
    # 2. The pose in the frame of the map.
    at = ros_messages.pose(x * M_PER_IN, y * M_PER_IN, heading)
    header = ros_messages.header(time_ns, ros_messages.MAP_FRAME)
    return {"header": header, "pose": {"pose": at, "covariance": covariance}}


def map_to_odom(estimate: Mapping[str, Any]) -> Pose2:
    """Return the transform from map to odom of an estimate and the odometry that belongs to it (REP-105)."""
    x, y, heading = estimate["pose"]
    odom_x, odom_y, odom_heading = estimate["odometry"]
    turn = math.remainder(heading - odom_heading, math.tau)
    cos, sin = math.cos(turn), math.sin(turn)
    return (x - cos * odom_x + sin * odom_y) * M_PER_IN, (y - sin * odom_x - cos * odom_y) * M_PER_IN, turn


def grid_message(grid: OccupancyGrid, time_ns: int) -> Message:
    """Return a world as OccupancyGrid: 100 occupied, 0 free, -1 unknown, rows along y."""
    values = np.full(len(Cell), -1)
    values[Cell.OCCUPIED], values[Cell.FREE] = 100, 0
    width, height = grid.cells.shape
    data = values[grid.cells.T.reshape(-1)].tolist()
    x, y = grid.origin_in
    info = {"map_load_time": ros_messages.stamp(time_ns), "resolution": grid.size_in * M_PER_IN, "width": width,
            "height": height, "origin": ros_messages.pose(x * M_PER_IN, y * M_PER_IN, grid.turn_rad)}  # fmt: skip
    return {"header": ros_messages.header(time_ns, ros_messages.MAP_FRAME), "info": info, "data": data}


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


@dataclass(slots=True)
class Estimates:
    """The last published estimate of each robot, with the time when it came; `listeners` get each new one."""

    listeners: list[Callable[[int, dict[str, Any]], None]] = field(default_factory=list)
    _latest: dict[int, tuple[float, dict[str, Any]]] = field(default_factory=dict)

    def add(self, robot: int, estimate: dict[str, Any]) -> None:
        """Add an estimate; the pose of a robot that is lost is undefined: it has neither a pose nor a frame map."""
        self._latest.pop(robot, None)
        if estimate["trust"] != "LOST":
            self._latest[robot] = loop_time(), estimate
            for listener in self.listeners:
                listener(robot, estimate)

    def map_to_odom(self, robot: int) -> Pose2 | None:
        """Return the transform from map to odom; None if the robot is not localized."""
        come_s, estimate = self._latest.get(robot, (-math.inf, None))
        return map_to_odom(estimate) if estimate is not None and loop_time() - come_s < STALE_S else None


def loop_time() -> float:
    """Return the clock of the running event loop, seconds."""
    return asyncio.get_running_loop().time()


PERIOD_S: Final = 0.05
"""Interval at which robots are read: twenty times a second, as for the page."""
MAP_CELL_IN: Final = 2.0
"""Cells of /map: 5 cm."""
MAX_MAP_CELLS: Final = 1_000_000
"""50 x 50 m of such cells; larger worlds get larger cells, since all robots wait while the map is made."""
MAX_DRIFT: Final = 1e-3
"""Largest drift of a robot's clock against that of this machine: ten times that of a poor quartz."""
MAX_DELAY_S: Final = 1.0
"""A longer delay than this means that the robot's clock was set, or stands still."""
MAX_ESTIMATE_AGE_S: Final = 60.0
"""An estimate with an older or later time is not by this robot's clock."""

Publish = Callable[[str, Message], None]
"""Called with a topic and its message."""


@dataclass(slots=True)
class RobotClock:
    """Unix times of a robot's clock.

    The offset between both clocks is the smallest that was seen, since a delay of the line makes it larger. It may
    grow by the drift, so that the times follow a robot's clock that is slow.
    """

    _offset_s: float = math.inf
    _seen_s: float = -math.inf

    def time_ns(self, clock_s: float, now_s: float) -> int:
        """Return the Unix time of a reading at `clock_s` that arrived at the Unix time `now_s`."""
        offset_s = now_s - clock_s
        expected_s = self._offset_s + MAX_DRIFT * (now_s - self._seen_s)
        # A clock that was set gets a new offset.
        self._offset_s = offset_s if offset_s > expected_s + MAX_DELAY_S else min(offset_s, expected_s)
        self._seen_s = now_s
        return round((clock_s + self._offset_s) * 1e9)

    def past_time_ns(self, clock_s: float, now_s: float) -> int:
        """Return the Unix time of an earlier reading; `now_s` if it cannot be by this clock."""
        time_s = clock_s + self._offset_s
        return round((time_s if now_s - MAX_ESTIMATE_AGE_S < time_s <= now_s else now_s) * 1e9)


class RobotReader:
    """Reads a daemon's robots and passes their messages to `publish`."""

    def __init__(self, daemon: Daemon, name: str, error_boundary: ErrorBoundary, publish: Publish,
                 estimates: Estimates) -> None:
        self._daemon = daemon
        self._publish = publish
        self._estimates = estimates
        self._clocks = {robot: RobotClock() for robot in daemon.emulator.simulation.robots}
        # A real robot is asked for its state on connections of the reader's own.
        self._clients = ViewerClients(daemon, name, error_boundary, answer_with_reply)
        self._asked: set[int] = set()
        estimates.listeners.append(self._publish_estimate)

    def close(self) -> None:
        """Close the connections to the robots. May be called twice."""
        with suppress(ValueError):
            self._estimates.listeners.remove(self._publish_estimate)
        self._clients.close()

    def read(self, robot: int) -> None:
        """Publish the state of a robot, now or when it answers."""
        daemon = self._daemon
        if daemon.handler is daemon.emulator:
            simulation = daemon.emulator.simulation
            simulated = simulation.robots[robot]
            slots = state_slots(simulated, daemon.emulator.clock.speed_tenths)
            readings_in = () if simulated.model.body.ring.fits_state else simulated.sonar.readings_in
            self._publish_reading(robot, slots, battery_v(simulation.time_s), simulation.time_s, readings_in)
        elif robot not in self._asked:
            # One question at a time: a slow line is not asked faster than it answers.
            self._asked.add(robot)
            self._clients.call(robot, "gs", [], lambda answer: self._answered(robot, answer))

    def static_frames(self) -> Message:
        """Return the frames of the sonars of all robots."""
        return static_frames(rings_of(self._daemon), time.time_ns())

    def _answered(self, robot: int, answer: Answer) -> None:
        self._asked.discard(robot)
        reply = answer.get("reply")
        if answer["ok"] and reply is not None and reply.slots:
            raw = reply.volts[1] if reply.volts else None
            slots = [reply.slots.get(slot, 0) for slot in range(45)]
            motors_v = None if raw is None else volts(raw, MOTOR_RANGE_V)
            self._publish_reading(robot, slots, motors_v, (reply.clock or 0) / 1000)

    def _publish_reading(self, robot: int, slots: list[int], motors_v: float | None, clock_s: float,
                         readings_in: Sequence[float] = ()) -> None:
        model = self._daemon.emulator.simulation.robots[robot].model
        time_ns = self._clocks[robot].time_ns(clock_s, time.time())
        ring = model.body.ring
        reading = Reading(robot, slots, model.track_in is not None, time_ns, motors_v, ring, readings_in)
        for topic, message in messages_of(reading):
            self._publish(topic, message)
        self._publish(TF, frames(reading, self._estimates.map_to_odom(robot)))

    def _publish_estimate(self, robot: int, estimate: dict[str, Any]) -> None:
        time_ns = self._clocks[robot].past_time_ns(estimate["clock_s"], time.time())
        self._publish(f"/robot{robot}/pose", estimate_message(estimate, time_ns))


def rings_of(daemon: Daemon) -> dict[int, Ring]:
    """Return the sonars of all robots."""
    return {number: robot.model.body.ring for number, robot in daemon.emulator.simulation.robots.items()}


def map_message(world: World) -> Message:
    """Return /map. Raises ImportError without the extra `maps`, ValueError if the world has no walls."""
    if not len(world.walls):
        raise ValueError(f"the world {world.name} has no walls")
    return grid_message(cells_of_world(world, map_cell_in(world)), time.time_ns())


def map_cell_in(world: World) -> float:
    """Return the size of the cells of /map: MAP_CELL_IN, twice that for a large world, and so on."""
    wide, high = np.ptp(world.walls.reshape(-1, 2), axis=0).tolist()
    size = MAP_CELL_IN
    while wide * high > MAX_MAP_CELLS * size**2:
        size *= 2.0
    return size


def answer_with_reply(name: str, reply: Reply) -> Answer:
    """Return the answer to a call with its whole reply."""
    del name
    return {"ok": reply.kind != "error", "values": list(reply.values), "reply": reply}
