"""Handlers of commands on the world: obstacles, robot poses, predictions, and motion_check. One function per command.

An obstacle is identified by its corners in tenths, starting at any corner and in either direction. A command that would
place an obstacle on a robot or a robot on an obstacle is ERROR 2.

motion_check: where a line or an arc first meets a wall. The path is the line or arc itself, without the robot's body.
The normal is the wall's on the side from which the path comes. On a wall p + t (q - p), 0 <= t <= 1, the circle of an
arc |p + t (q - p) - c| = r gives a quadratic equation in t.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, copysign, cos, hypot, pi, remainder, sin, tau
from typing import Final, NamedTuple

import numpy as np

from nclient.errors import StartError
from nclient.protocol.layouts import MOTION_LINE
from nclient.protocol.replies import Reply
from nclient.protocol.types import SLOTS, heading_tenths, rad_from_tenths, tenths
from nserver_emu.server import session
from nserver_emu.server.server_state import STATE_SENSORS, ServerState, add_laser, is_on, state_slots
from nserver_emu.server.session import BAD_VALUES, REFUSED, ConnectionContext, DeferredReply, done, error_reply
from nserver_emu.simulation.multi_robot import discs_of
from nserver_emu.simulation.noise import IDEAL, Purpose, RngFactory
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.sensors import LASER_RANGE_IN as LASER_RANGE_IN
from nserver_emu.simulation.visibility import RobotPositions
from worlds.geometry import FloatArray, area, crossing, inside, lengths, near_walls, nearest_points
from worlds.raycast_arrays import cast_rays
from worlds.robots import Body
from worlds.world import Polygon, StartPose, World

# A path that misses a wall by at most this meets it: coordinates up to 1e5 in have rounding errors of 1e-11.
TOUCH_IN: Final = 1e-9
# Sine of the angle below which a path is parallel to a wall, so that it comes from neither of its sides.
MIN_SLANT: Final = 1e-9


class Hit(NamedTuple):
    """The first intersection of a path, and the direction of the wall's normal in (-pi, pi]."""

    x_in: float
    y_in: float
    normal_rad: float


class Arc(NamedTuple):
    """An arc from one polar angle to another, counter-clockwise if the second is larger."""

    centre_x_in: float
    centre_y_in: float
    radius_in: float
    from_rad: float
    to_rad: float


def line_hit(start: tuple[float, float], end: tuple[float, float], walls: FloatArray) -> Hit | None:
    """Return the first intersection of a line with walls of shape (m, 4), None if there is none."""
    if not len(walls):
        return None
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = hypot(along_x, along_y)
    direction = (along_x / length, along_y / length) if length else (1.0, 0.0)
    if not length:
        _, distances = nearest_points(start, walls)
        row = int(distances.argmin())
        distance = float(distances[row])
    else:
        ranges, rows = cast_rays(start, direction, walls)
        distance, row = float(ranges), int(rows)
    if distance > length + TOUCH_IN:
        return None
    reach = min(distance, length)
    normal = _normal(walls[row].tolist(), direction, (-direction[0], -direction[1]))
    return Hit(start[0] + reach * direction[0], start[1] + reach * direction[1], normal)


def arc_hit(arc: Arc, walls: FloatArray) -> Hit | None:
    """Return the first intersection of an arc with walls of shape (m, 4), None if there is none."""
    # Of all intersections of the circle within the arc, the one with the smallest swept angle.
    first: tuple[float, float, int] | None = None
    turn = copysign(1.0, arc.to_rad - arc.from_rad)
    sweep = abs(arc.to_rad - arc.from_rad)
    slack = TOUCH_IN / max(arc.radius_in, TOUCH_IN)
    for row, wall in enumerate(walls.tolist()):
        for angle in _circle_angles(arc, wall):
            swept = turn * (angle - arc.from_rad) % tau
            swept = 0.0 if tau - swept <= slack else swept
            if swept <= sweep + slack and (first is None or swept < first[0]):
                first = (swept, angle, row)
    if first is None:
        return None
    _, angle, row = first
    outward = (cos(angle), sin(angle))
    # The path runs along the tangent there.
    direction = (-turn * outward[1], turn * outward[0])
    normal = _normal(walls[row].tolist(), direction, (-outward[0], -outward[1]))
    x, y = arc.centre_x_in + arc.radius_in * outward[0], arc.centre_y_in + arc.radius_in * outward[1]
    return Hit(x, y, normal)


def _circle_angles(arc: Arc, wall: list[float]) -> list[float]:
    """Return the polar angles of the intersections of an arc's whole circle with a wall, at most two."""
    # 1. Foot of the perpendicular from the centre: position along the wall, and distance from it.
    x1, y1 = wall[0] - arc.centre_x_in, wall[1] - arc.centre_y_in
    along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
    length = hypot(along_x, along_y)
    unit_x, unit_y = along_x / length, along_y / length
    foot = -(x1 * unit_x + y1 * unit_y)
    distance = x1 * unit_y - y1 * unit_x
    if abs(distance) > arc.radius_in + TOUCH_IN:
        return []
    # 2. Half the chord, then the ends of the chord that lie on the wall.
    half = float(np.sqrt(max((arc.radius_in - distance) * (arc.radius_in + distance), 0.0)))
    places = [place for place in (foot - half, foot + half) if -TOUCH_IN <= place <= length + TOUCH_IN]
    return [atan2(y1 + place * unit_y, x1 + place * unit_x) for place in places]


def _normal(wall: list[float], direction: tuple[float, float], side: tuple[float, float]) -> float:
    """Return the angle of the wall's normal that faces a path; towards `side` if the path is parallel to the wall."""
    normal = atan2(wall[2] - wall[0], wall[1] - wall[3])
    facing = cos(normal) * direction[0] + sin(normal) * direction[1]
    if abs(facing) <= MIN_SLANT:
        facing = -(cos(normal) * side[0] + sin(normal) * side[1])
    turned = remainder(normal + (pi if facing > 0.0 else 0.0), tau)
    return turned if turned > -pi else pi


# Robots in a reply to get_rpx: 1 + 3 x 341 = 1024 words, the maximum of a reply.
MAX_ROBOTS_IN_REPLY: Final = 341
# Half the size of the map: rays are exact so far, and all numbers fit into their words.
MAX_COORDINATE_IN: Final = 1e5
# Corners that are equal in tenths differ by less.
TENTH_IN: Final = 0.1
# A robot may touch an obstacle: overlap up to this does not count.
MAX_OVERLAP_IN: Final = 1e-3
# Arguments of motion_check are thousandths of the C call's numbers, which are tenths of an inch.
_PATH_UNITS_PER_INCH = 10_000.0

_Corners = tuple[tuple[int, int], ...]


def add_obstacle(server: ServerState, _context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Add a polygon of three corners or more that encloses some area and no robot."""
    world = server.simulation.world
    polygon = Polygon(tuple((x / 10, y / 10) for x, y in _corners(args)))
    if not is_valid_polygon(polygon) or overlaps_robot(server, polygon):
        return error_reply(BAD_VALUES)
    if len(world.obstacles) >= server.allowed.obstacles:
        return error_reply(REFUSED)
    server.simulation.change_world(world.with_obstacles((*world.obstacles, polygon)))
    return done()


def delete_obstacle(server: ServerState, _context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Remove the obstacle with these corners, the last one if there are several."""
    obstacles = list(server.simulation.world.obstacles)
    number = _number_of(server.simulation.world, _corners(args))
    if number is None:
        return error_reply(BAD_VALUES)
    del obstacles[number]
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    return done()


def move_obstacle(server: ServerState, _context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Shift the obstacle with these corners; the reply is their number and new positions."""
    *_, dx, dy = args
    corners = _corners(args[:-2])
    obstacles = list(server.simulation.world.obstacles)
    number = _number_of(server.simulation.world, corners)
    if number is None:
        return error_reply(BAD_VALUES)
    moved = obstacles[number].moved(dx / 10, dy / 10)
    if not is_valid_polygon(moved) or overlaps_robot(server, moved):
        return error_reply(BAD_VALUES)
    obstacles[number] = moved
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    return Reply("simple", values=(len(corners), *[at for x, y in corners for at in (x + dx, y + dy)]))


def new_world(server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Remove all obstacles, those of the world file too; walls stay."""
    server.simulation.change_world(server.simulation.world.with_obstacles(()))
    return done()


def place_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Place the robot; a pose where it would touch a wall or another robot is refused."""
    robot, place = server.robot_of(context), _start(args)
    if max(abs(place.x_in), abs(place.y_in)) > MAX_COORDINATE_IN:
        return error_reply(BAD_VALUES)
    try:
        server.simulation.require_free(place.x_in, place.y_in, robot.model.body.radius_in, context.robot_id)
    except StartError:
        return error_reply(BAD_VALUES)
    server.simulation.place(context.robot, place.x_in, place.y_in, place.steering_rad, place.turret_rad)
    return done()


def get_rpx(server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Return actual position and heading of all robots, ordered by number."""
    robots = [robot.actual for _, robot in sorted(server.simulation.robots.items())][:MAX_ROBOTS_IN_REPLY]
    numbers = [n for at in robots for n in (tenths(at.x_in), tenths(at.y_in), heading_tenths(at.steering_rad))]
    return Reply("simple", values=(len(robots), *numbers))


def get_robot_conf(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply | DeferredReply:
    """Return a pose clicked in the viewer, the actual pose of the robot if no viewer is open.

    In lockstep the reply is not deferred: simulated time would run until a click.
    """
    robot = server.robot_of(context)

    def here() -> session.ClickedPose:
        at = robot.actual
        return tenths(at.x_in), tenths(at.y_in), heading_tenths(at.steering_rad), heading_tenths(at.turret_rad)

    if not server.pose_requests.open or server.clock.lockstep_s is not None:
        return Reply("configuration", values=here())
    poll_pose = server.pose_requests.add(context.robot, context, here)

    def poll() -> Reply | None:
        pose = poll_pose()
        return None if pose is None else Reply("configuration", values=pose)

    return poll


class _NoDraws(RngFactory):
    """Random streams of a robot without noise, which draws nothing: one for all, since making them takes longest."""

    def stream(self, purpose: Purpose) -> np.random.Generator:
        """Return a stream that must not be used."""
        del purpose
        return _UNUSED_RNG


_UNUSED_RNG: Final = np.random.default_rng(0)


class Prediction(NamedTuple):
    """A robot without noise at another pose, what it was made from, and its sensors, one in each step."""

    args: tuple[int, ...]
    walls: FloatArray
    others: FloatArray
    robot: SimulatedRobot
    steps: Iterator[None]


def predict_sensors(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Return the noise-free readings of the sensors at another pose; the robot does not move."""
    there = _predict(server, context, args).robot
    context.prediction = None
    slots, laser = add_laser(there, context, state_slots(there, server.clock.speed_tenths))
    # All slots but the error.
    return Reply("prediction", values=tuple(slots[:SLOTS]), laser=laser)


def prepare_prediction(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Iterator[None]:
    """Read the sensors of a prediction, one in each step; what changes before the reply makes it begin anew."""
    context.prediction = prediction = _predict(server, context, args)
    return prediction.steps


def _predict(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Prediction:
    """Return the prediction that was prepared, or a new one if anything differs."""
    simulation, robot, before = server.simulation, server.robot_of(context), context.prediction
    walls, others = simulation.world.walls, discs_of(each for each in simulation.bodies if each is not robot)
    if (
        isinstance(before, Prediction) and before.args == args and before.walls is walls
        and before.robot.model is robot.model and np.array_equal(before.others, others)
    ):  # fmt: skip
        return before
    start = _start(args)
    near = near_walls(start.x_in, start.y_in, _sensor_reach_in(robot.model.body), walls)
    there = SimulatedRobot(_NoDraws(*robot.rng_factory), start, near, robot.model, IDEAL,
                           positions=RobotPositions(np.vstack((others, (0.0, 0.0, 0.0)))), self_index=len(others))
    has_laser = there.model.has_light_sensors and is_on(context.wire_state.laser_mode)
    return Prediction(args, walls, others, there, _sensor_steps(there, has_laser))


def _sensor_reach_in(body: Body) -> float:
    """Return the distance from a robot's axis beyond which no wall changes the reading of a sensor without noise."""
    ring = body.ring
    farthest_mount_in = max(hypot(*ring.mount_in(sonar)) for sonar in range(ring.count))
    sonars_in = ring.radius_in + farthest_mount_in + IDEAL.sonar.reach_in(ring.max_range_in)
    return max(sonars_in, body.radius_in + LASER_RANGE_IN, body.radius_in + IDEAL.infrared.reach_in)


def _sensor_steps(robot: SimulatedRobot, has_laser: bool) -> Iterator[None]:
    """Compute the readings of a robot that stands, which keeps them."""
    for sensor in STATE_SENSORS:
        yield
        sensor.values(robot)
    yield
    if has_laser:
        robot.scan_laser()


def motion_check(server: ServerState, _context: ConnectionContext, args: tuple[float, ...]) -> Reply:
    """Return if a line or an arc meets a wall or obstacle, where, and the normal of the wall there."""
    kind, *numbers = args
    walls = server.simulation.world.walls
    if kind == MOTION_LINE:
        x1, y1, x2, y2 = (number / _PATH_UNITS_PER_INCH for number in numbers)
        hit = line_hit((x1, y1), (x2, y2), walls)
    else:
        radius, x, y = (number / _PATH_UNITS_PER_INCH for number in numbers[4:])
        if radius < 0.0:
            return error_reply(BAD_VALUES)
        hit = arc_hit(Arc(x, y, radius, numbers[2] / 1000, numbers[3] / 1000), walls)
    if hit is None:
        return Reply("simple", values=(0, 0, 0, 0))
    return Reply("simple", values=(1, round(hit.x_in * 1000), round(hit.y_in * 1000), round(hit.normal_rad * 1e6)))


def _corners(args: Sequence[int]) -> _Corners:
    return tuple(zip(args[1::2], args[2::2], strict=True))


def _start(args: Sequence[int]) -> StartPose:
    x, y, steering, turret = args
    return StartPose(x / 10, y / 10, rad_from_tenths(steering), rad_from_tenths(turret))


def is_valid_polygon(polygon: Polygon) -> bool:
    """Return True if the corners enclose an area of the map and no sides cross."""
    edges = polygon.segments()
    return (len(edges) >= 3 and float(abs(edges).max()) <= MAX_COORDINATE_IN and bool(lengths(edges).all())
            and crossing(edges) is None and abs(area(polygon.corners_in)) > 0.0)


def overlaps_robot(server: ServerState, polygon: Polygon) -> bool:
    """Return True if an obstacle overlaps a robot."""
    edges, discs = polygon.segments(), discs_of(server.simulation.robots.values())
    _, distances = nearest_points(discs[:, :2], edges)
    is_near = distances.min(axis=1) < discs[:, 2] - MAX_OVERLAP_IN
    return bool((is_near | inside(discs[:, :2], edges)[:, 0]).any())


def _number_of(world: World, corners: _Corners) -> int | None:
    """Return the index of the last obstacle with these corners, None if there is none."""
    outline, (x, y) = _canonical(corners), corners[0]
    for number in reversed(world.obstacles_with_corner(x / 10, y / 10, TENTH_IN)):
        there = tuple((tenths(x), tenths(y)) for x, y in world.obstacles[number].corners_in)
        if len(there) == len(corners) and _canonical(there) == outline:
            return number
    return None


def _canonical(corners: _Corners) -> _Corners:
    """Return the same outline with a unique first corner and direction."""
    directions = (corners, corners[::-1])
    return min(order[first:] + order[:first] for order in directions for first in range(len(order)))
