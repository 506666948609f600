"""Where a line or an arc first meets a wall: the geometry of motion_check. Pure; inches and radians in and out.

The path is the line or arc itself, without the robot's body: a program that wants room asks for a path beside its own.
The normal is the wall's, on the side from which the path comes: it points into the free room.

    on a wall p + t (q - p), 0 <= t <= 1, an arc's circle |p + t (q - p) - c| = r is a quadratic in t

Commands that change or ask the world: obstacles, where robots stand, what would be met. A function a command.

Rules: an obstacle is known by its corners in tenths, from whichever corner and whichever way round they are named.
Nothing is put where a robot stands, and no robot where something stands: ERROR 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, copysign, cos, hypot, pi, remainder, sin, tau
from typing import Final, NamedTuple

import numpy as np

from nclient.errors import StartError
from nclient.protocol.replies import Reply
from nclient.protocol.requests import MOTION_LINE
from nclient.protocol.types import heading_tenths, rad_from_tenths, tenths
from nserver_emu.server.context import ClickedPose, ServerState
from nserver_emu.server.session import BAD_VALUES, REFUSED, ConnectionContext, DeferredReply, error_reply
from nserver_emu.server.state_encoder import state_slots, with_laser
from nserver_emu.simulation.multi_robot import discs_of
from nserver_emu.simulation.noise import IDEAL
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.visibility import RobotPositions
from worlds.geometry import FloatArray, area, crossing, inside, lengths, nearest_points
from worlds.raycast import cast_rays
from worlds.world import Polygon, StartPose

TOUCH_IN: Final = 1e-9
"""A path that misses a wall by no more meets it: coordinates up to 1e5 in are rounded at 1e-11."""

SLANT: Final = 1e-9
"""A path steeper to a wall than this comes from one of its sides; one that is not runs along it or touches it."""


class Hit(NamedTuple):
    """The first meeting: where, and the direction of the wall's normal in (-pi, pi]."""

    x_in: float
    y_in: float
    normal_rad: float


class Arc(NamedTuple):
    """Part of a circle, from one polar angle to another: counter-clockwise where the second is the larger one."""

    centre_x_in: float
    centre_y_in: float
    radius_in: float
    from_rad: float
    to_rad: float


def line_hit(start: tuple[float, float], end: tuple[float, float], walls: FloatArray) -> Hit | None:
    """Where the way from `start` to `end` first meets one of the walls (m, 4); None: nowhere."""
    if not len(walls):
        return None
    along_x, along_y = end[0] - start[0], end[1] - start[1]
    length = hypot(along_x, along_y)
    way = (along_x / length, along_y / length) if length else (1.0, 0.0)
    if not length:
        _, distances = nearest_points(start, walls)
        row = int(distances.argmin())
        met = float(distances[row])
    else:
        ranges, rows = cast_rays(start, way, walls)
        met, row = float(ranges), int(rows)
    if met > length + TOUCH_IN:
        return None
    reach = min(met, length)
    normal = _normal(walls[row].tolist(), way, (-way[0], -way[1]))
    return Hit(start[0] + reach * way[0], start[1] + reach * way[1], normal)


def arc_hit(arc: Arc, walls: FloatArray) -> Hit | None:
    """Where the arc first meets one of the walls (m, 4); None: nowhere."""
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
    way = (-turn * outward[1], turn * outward[0])
    normal = _normal(walls[row].tolist(), way, (-outward[0], -outward[1]))
    x, y = arc.centre_x_in + arc.radius_in * outward[0], arc.centre_y_in + arc.radius_in * outward[1]
    return Hit(x, y, normal)


def _circle_angles(arc: Arc, wall: list[float]) -> list[float]:
    """The polar angles at which the arc's whole circle meets a wall: none, one or two; of a wall on it, its ends'."""
    x1, y1 = wall[0] - arc.centre_x_in, wall[1] - arc.centre_y_in
    along_x, along_y = wall[2] - wall[0], wall[3] - wall[1]
    length = hypot(along_x, along_y)
    unit_x, unit_y = along_x / length, along_y / length
    foot = -(x1 * unit_x + y1 * unit_y)
    aside = x1 * unit_y - y1 * unit_x
    if abs(aside) > arc.radius_in + TOUCH_IN:
        return []
    half = float(np.sqrt(max((arc.radius_in - aside) * (arc.radius_in + aside), 0.0)))
    places = [place for place in (foot - half, foot + half) if -TOUCH_IN <= place <= length + TOUCH_IN]
    return [atan2(y1 + place * unit_y, x1 + place * unit_x) for place in places]


def _normal(wall: list[float], way: tuple[float, float], aside: tuple[float, float]) -> float:
    """The wall's normal that faces a path going `way`; the one towards `aside` where the path runs along the wall."""
    normal = atan2(wall[2] - wall[0], wall[1] - wall[3])
    facing = cos(normal) * way[0] + sin(normal) * way[1]
    if abs(facing) <= SLANT:
        facing = -(cos(normal) * aside[0] + sin(normal) * aside[1])
    turned = remainder(normal + (pi if facing > 0.0 else 0.0), tau)
    return turned if turned > -pi else pi


MOST_ROBOTS_TOLD: Final = 341
"""What a reply to get_rpx can carry: 1 + 3 x 341 of 1024 words."""

EDGE_IN: Final = 1e5
"""The map ends here in every direction: rays are exact so far, and all numbers fit into their words."""

TOUCH_IN_GROUND: Final = 1e-3
"""A robot may touch what it stands beside: an obstacle this little inside its rim does not stand in it."""

_PREDICTED = 44
_PATH_UNIT_IN = 10_000.0
"""Arguments of motion_check are thousandths of the C call's numbers, and those are tenths of an inch."""

_Corners = tuple[tuple[int, int], ...]


def add_obstacle(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Add a polygon of three corners or more that encloses some area and no robot."""
    world = server.simulation.world
    polygon = _polygon(_corners(args))
    if not sound(polygon) or stands_in_a_robot(server, polygon):
        return error_reply(BAD_VALUES)
    if len(world.obstacles) >= server.allowed.obstacles:
        return error_reply(REFUSED)
    server.simulation.change_world(world.with_obstacles((*world.obstacles, polygon)))
    return done()


def delete_obstacle(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Take away the polygon with these corners; the latest where there are several."""
    obstacles = list(server.simulation.world.obstacles)
    number = _number_of(obstacles, _corners(args))
    if number is None:
        return error_reply(BAD_VALUES)
    del obstacles[number]
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    return done()


def move_obstacle(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Shift the polygon with these corners; the answer is their number and where they are now."""
    *_, dx, dy = args
    corners = _corners(args[:-2])
    obstacles = list(server.simulation.world.obstacles)
    number = _number_of(obstacles, corners)
    if number is None:
        return error_reply(BAD_VALUES)
    moved = obstacles[number].moved(dx / 10, dy / 10)
    if not sound(moved) or stands_in_a_robot(server, moved):
        return error_reply(BAD_VALUES)
    obstacles[number] = moved
    server.simulation.change_world(server.simulation.world.with_obstacles(obstacles))
    return Reply("simple", values=(len(corners), *[at for x, y in corners for at in (x + dx, y + dy)]))


def new_world(server: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Take all obstacles away, the world file's as well; walls stay."""
    server.simulation.change_world(server.simulation.world.with_obstacles(()))
    return done()


def place_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Put the robot somewhere; a place where it would touch a wall or another robot is refused."""
    robot, place = server.robot_of(context), _start(args)
    if max(abs(place.x_in), abs(place.y_in)) > EDGE_IN:
        return error_reply(BAD_VALUES)
    try:
        server.simulation.require_free(place.x_in, place.y_in, robot.model.body.radius_in, context.robot_id)
    except StartError:
        return error_reply(BAD_VALUES)
    assert context.robot_id is not None
    server.simulation.place(context.robot_id, place.x_in, place.y_in, place.steering_rad, place.turret_rad)
    return done()


def get_rpx(server: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Where all actual robots are and which way they head, in the order of their ids."""
    robots = [robot.actual for _, robot in sorted(server.simulation.robots.items())][:MOST_ROBOTS_TOLD]
    numbers = [n for at in robots for n in (tenths(at.x_in), tenths(at.y_in), heading_tenths(at.steering_rad))]
    return Reply("simple", values=(len(robots), *numbers))


def get_robot_conf(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply | DeferredReply:
    """A pose clicked in the window; without one, where the actual robot is.

    In lockstep nobody is waited for: time would run as long as it takes.
    """
    robot = server.robot_of(context)

    def here() -> ClickedPose:
        at = robot.actual
        return tenths(at.x_in), tenths(at.y_in), heading_tenths(at.steering_rad), heading_tenths(at.turret_rad)

    if not server.pose_requests.open or server.clock.lockstep_s is not None:
        return Reply("configuration", values=here())
    assert context.robot_id is not None
    clicked = server.pose_requests.ask(context.robot_id, context, here)

    def later() -> Reply | None:
        pose = clicked()
        return None if pose is None else Reply("configuration", values=pose)

    return later


def predict_sensors(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """What the sensors would read at another place of the map, ideal ones without noise; no robot goes there."""
    simulation, robot = server.simulation, server.robot_of(context)
    others = {number: other for number, other in simulation.robots.items() if other is not robot}
    seen = RobotPositions(np.vstack((discs_of(others.values()), (0.0, 0.0, 0.0))))
    there = SimulatedRobot(
        robot.rng_factory, _start(args), simulation.world.walls, robot.model, IDEAL, positions=seen,
        self_index=len(others),
    )  # fmt: skip
    slots, laser = with_laser(there, context, state_slots(there, server.clock.speed_tenths))
    return Reply("prediction", values=tuple(slots[:_PREDICTED]), laser=laser)


def motion_check(server: ServerState, _visit: ConnectionContext, args: tuple[float, ...]) -> Reply:
    """Whether a line or an arc meets a wall or an obstacle; where, and which way the wall faces there."""
    kind, *numbers = args
    walls = server.simulation.world.walls
    if kind == MOTION_LINE:
        x1, y1, x2, y2 = (number / _PATH_UNIT_IN for number in numbers)
        hit = line_hit((x1, y1), (x2, y2), walls)
    else:
        radius, x, y = (number / _PATH_UNIT_IN for number in numbers[4:])
        if radius < 0.0:
            return error_reply(BAD_VALUES)
        hit = arc_hit(Arc(x, y, radius, numbers[2] / 1000, numbers[3] / 1000), walls)
    if hit is None:
        return Reply("simple", values=(0, 0, 0, 0))
    return Reply("simple", values=(1, round(hit.x_in * 1000), round(hit.y_in * 1000), round(hit.normal_rad * 1e6)))


def done() -> Reply:
    """The reply of a command that has nothing to say."""
    return Reply("simple", values=(0,))


def _corners(args: Sequence[int]) -> _Corners:
    return tuple(zip(args[1::2], args[2::2], strict=True))


def _start(args: Sequence[int]) -> StartPose:
    x, y, steering, turret = args
    return StartPose(x / 10, y / 10, rad_from_tenths(steering), rad_from_tenths(turret))


def _polygon(corners: _Corners) -> Polygon:
    return Polygon(tuple((x / 10, y / 10) for x, y in corners))


def sound(polygon: Polygon) -> bool:
    """Whether the corners go round some area of the map without crossing their own way."""
    edges = polygon.segments()
    return (
        len(edges) >= 3
        and float(abs(edges).max()) <= EDGE_IN
        and bool(lengths(edges).all())
        and crossing(edges) is None
        and abs(area(polygon.corners_in)) > 0.0
    )


def stands_in_a_robot(server: ServerState, polygon: Polygon) -> bool:
    """Whether an obstacle would stand where a robot does."""
    edges = polygon.segments()
    for robot in server.simulation.robots.values():
        *place, radius_in = robot.disc
        _, distances = nearest_points(place, edges)
        if distances.min() < radius_in - TOUCH_IN_GROUND or inside(place, edges).any():
            return True
    return False


def _number_of(obstacles: Sequence[Polygon], corners: _Corners) -> int | None:
    """The latest of the obstacles that has these corners."""
    wanted = _canonical(corners)
    for number in reversed(range(len(obstacles))):
        there = tuple((tenths(x), tenths(y)) for x, y in obstacles[number].corners_in)
        if len(there) == len(corners) and _canonical(there) == wanted:
            return number
    return None


def _canonical(corners: _Corners) -> _Corners:
    """The same outline, named from one corner and one way round, whatever they were."""
    ways = (corners, corners[::-1])
    return min(way[first:] + way[:first] for way in ways for first in range(len(way)))
