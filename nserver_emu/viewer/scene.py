"""Whose laser mode the map follows: each client of a robot has its own, and the layer shows what any of them is told.

    on      as at power-on, while a robot has no client; else while one of its clients has an odd mode (conf_ls)
    off     every client of it has an even one, 0 say: nothing is drawn

Rules: pages that drive are no clients, for they have no say in it. How many columns count, and lines instead of points,
are one client's own: what is drawn are the points of all columns.

What the page shows, as plain data, and what of it changed since a picture that a viewer has. Pure.

    always      frame, since, time_s, speed (None: as fast as it can), paused, lockstep_s
                robots    {id: {"state": State[0..44], "actual": [x, y, steer, turret], "encoder": the same, "front":
                          the direction of bumper 0,
                          "held": {"by": who stopped it for good, "ignored": how often it was told to move since} or
                          null}}
    if changed  bodies    {id: {"model", "radius_in", "ring_in", "bumpers": count, "differential", "sees",
                          "noise": {"sensors": name in force, "motion": the same}, "noises": the names there are}}
                world     {"name", "title", "walls": [[x1, y1, x2, y2] ...], the edges of the rooms first,
                          "rooms", "obstacles": [{"name", "corners"} ...], "starts": [[x, y, steer, turret in
                          degrees] ...], "paths": {name: [[x, y] ...]}}
                graphics  [[number, figure, numbers, colour, xor] ...], or what changed of them:
                drawn     {"gone": [number ...], "come": [[number, figure, numbers, colour, xor] ...]}
                traces    {id: {"actual": {"gone", "points"}, "encoder": the same}}    points x, y, x, y ...; null, null
                          before a point that the robot did not drive to
                beams     {id: [[sonar, x, y, direction] ...]}    whence and whither each sonar cried of which State has
                          the reading; [sonar] of one that has not since the robot was put down elsewhere
                lasers    {id: [x, y, x, y ...]}    in the map, as seen then; none of a robot whose laser is off
                laser_modes    {id: [[client, mode] ...]}    whose modes those follow (laser_modes.py)
                said      [[time_s, id, text] ...]

Inches and radians, rounded to what a screen shows; State is in the wire's tenths. Keys of JSON are texts, so are ids.
Rules: looking changes nothing in the simulation. Pictures are numbered from 1; who has picture 0 has nothing. What
grows is told as far as it was when the picture was taken, however late that is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from nserver_emu.server.context import ServerState
from nserver_emu.server.graphics import Shape, Trace
from nserver_emu.server.handlers.runtime_settings import noise_choices, noise_of
from nserver_emu.server.state_encoder import StateSnapshot, is_on
from nserver_emu.simulation.acoustics import Cry
from nserver_emu.simulation.laser import points
from nserver_emu.simulation.noise import RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import Pose
from worlds.robots import SONARS
from worlds.world import Polygon, World

if TYPE_CHECKING:
    from nserver_emu.server.connection import ConnectionHandler

MOST_NAMED: Final = 20
VIEWER: Final = "viewer"
Modes = Mapping[int, list[tuple[str, int]]]
"""By robot its clients, each with its mode: those that have it on first."""


def laser_modes(talkers: Iterable[ConnectionHandler], robots: Collection[int]) -> Modes:
    """Of these robots."""
    found: dict[int, list[tuple[str, int]]] = {number: [] for number in robots}
    for talker in talkers:
        context = talker.session.context
        if talker.is_connected and talker.line != VIEWER and context.robot_id in found:
            found[context.robot_id].append((talker.session.name, context.wire_state.laser_mode))
    return {number: sorted(clients, key=_on_first)[:MOST_NAMED] for number, clients in found.items()}


def is_shown(clients: list[tuple[str, int]]) -> bool:
    """Whether the laser of a robot with these clients is on for anybody."""
    return not clients or any(is_on(mode) for _, mode in clients)


def _on_first(client: tuple[str, int]) -> tuple[bool, Any]:
    name, mode = client
    return not is_on(mode), name


REMEMBERED: Final = 64
"""Pictures since which it is known what changed; who has an older one gets everything."""
LASER_EVERY: Final = 4
"""The laser is looked through at every so many pictures: its 482 rays cost more than all else."""
MOST_NEW: Final = 25
"""Points of a track that a picture adds: 12 in of way in a twentieth of a second, faster than any robot."""
NOTHING_YET: Final = (0, 0)
SILENT: Final = (None,) * SONARS
DIGITS: Final = 3
ANGLE_DIGITS: Final = 5
Plain = dict[str, Any]


class Mark(NamedTuple):
    """How far everything that grows or changes was at a picture."""

    number: int
    bodies: tuple[tuple[int, RobotSetup], ...] | None
    world: World | None
    graphics: int
    lasers: int
    laser_modes: Modes | None
    said: object
    traces: dict[int, tuple[int, int]]
    cries: dict[int, tuple[Cry | None, ...]]


NOTHING: Final = Mark(0, None, None, -1, -1, None, "not even silence", {}, {})
"""What who has no picture was told: it is like no picture's, so all is new."""


class Album:
    """The newest picture of a stage, and what it takes to come to it from an earlier one."""

    def __init__(self, server: ServerState) -> None:
        self._server = server
        self._marks: deque[Mark] = deque(maxlen=REMEMBERED)
        self._lasers: dict[str, list[float]] = {}
        self._lasers_taken = 0
        self._modes: Modes = {}
        self._now: Plain = {}
        self.number = 0

    def take(self, *, lasers: Collection[int | None] | None = (), modes: Modes | None = None) -> None:
        """Take a new picture; `lasers`: of which robots somebody looks at what the laser sees; None: of all. `modes`:
        those of their clients."""
        self._modes = modes or {}
        if (lasers is None or lasers) and (self.number + 1) % LASER_EVERY == 0:
            seen = {
                str(number): _seen(robot)
                for number, robot in self._server.simulation.robots.items()
                if robot.model.sees and (lasers is None or number in lasers) and is_shown(self._modes.get(number, []))
            }
            self._lasers_taken += bool(seen or self._lasers)
            self._lasers = seen
        now, mark = _now(self._server), self._mark()
        self.number, self._now = mark.number, now
        self._marks.append(mark)

    def since(self, number: int) -> Plain:
        """The newest picture for who has that one: what is always there, and what changed."""
        old, new = self._mark_of(number), self._marks[-1]
        told: Plain = {"frame": new.number, "since": old.number} | self._now
        if new.bodies != old.bodies:
            told["bodies"] = {str(n): body(robot) for n, robot in self._server.simulation.robots.items()}
        if new.world and new.world is not old.world:
            told["world"] = ground(new.world)
        told |= self._drawn(old.graphics, new.graphics)
        if new.lasers != old.lasers:
            told["lasers"] = self._lasers
        if new.laser_modes != old.laser_modes:
            told["laser_modes"] = {str(n): clients for n, clients in self._modes.items()}
        if new.said is not old.said:
            told["said"] = [list(utterance) for utterance in self._server.transcript.utterances]
        grown = {"traces": self._grown(old.traces, new.traces), "beams": _cried(old.cries, new.cries)}
        return told | {name: more for name, more in grown.items() if more}

    def _mark_of(self, number: int) -> Mark:
        """How far all was at that picture, NOTHING where that is not known any more, or never was."""
        age = self.number - number
        return self._marks[-1 - age] if number > 0 and 0 <= age < len(self._marks) else NOTHING

    def _drawn(self, before: int, now: int) -> Plain:
        graphics = self._server.graphics
        if before == now:
            return {}
        changes = graphics.changes(before, now) if before >= 0 else None
        if changes is None:
            return {"graphics": [_shape(number, shape) for number, shape in graphics.numbered if number <= now]}
        gone, come = changes
        return {"drawn": {"gone": gone, "come": [_shape(*numbered) for numbered in come]}}

    def _mark(self) -> Mark:
        server = self._server
        said = server.transcript.utterances
        ways = server.traces
        counts = {n: (trace.count, ways.encoder[n].count) for n, trace in ways.actual.items()}
        simulation = server.simulation
        return Mark(
            self.number + 1, tuple((n, robot.setup) for n, robot in simulation.robots.items()),
            simulation.world, server.graphics.drawn, self._lasers_taken, self._modes,
            said[-1] if said else None, counts,
            {n: robot.sonar.cries for n, robot in simulation.robots.items()},
        )  # fmt: skip

    def _grown(self, old: dict[int, tuple[int, int]], new: dict[int, tuple[int, int]]) -> Plain:
        ways = self._server.traces
        return {
            str(n): {
                "actual": _newer(ways.actual[n], had[0], has[0]), "encoder": _newer(ways.encoder[n], had[1], has[1]),
            }
            for n, has in new.items()
            if (had := old.get(n, NOTHING_YET)) != has
        }


def body(robot: SimulatedRobot) -> Plain:
    """What a robot looks like."""
    shape = robot.model.body
    return {
        "model": robot.model.name, "family": robot.model.family, "radius_in": shape.radius_in,
        "ring_in": shape.sonar_ring_radius_in, "bumpers": len(shape.bumper_angles_rad),
        "differential": robot.model.track_in is not None, "sees": robot.model.sees,
        "noise": noise_of(robot), "noises": noise_choices(robot),
    }  # fmt: skip


def ground(world: World) -> Plain:
    """What stands in a world."""
    return {
        "name": world.name, "title": world.title,
        "walls": [[round(number, DIGITS) for number in row] for row in world.fixed_walls.tolist()],
        "rooms": [_outline(room) for room in world.rooms],
        "obstacles": [_outline(thing) for thing in world.obstacles],
        "starts": [
            [start.x_in, start.y_in, math.degrees(start.steering_rad), math.degrees(start.turret_rad)]
            for start in world.starts
        ],
        "paths": {name: [list(point) for point in path.points_in] for name, path in world.paths.items()},
    }  # fmt: skip


def _outline(polygon: Polygon) -> Plain:
    return {
        "name": polygon.name, "corners": [[round(x, DIGITS), round(y, DIGITS)] for x, y in polygon.corners_in]
    }  # fmt: skip


def _now(server: ServerState) -> Plain:
    pace = server.clock
    return {
        "time_s": round(server.simulation.time_s, DIGITS), "speed": pace.factor, "paused": pace.paused,
        "lockstep_s": pace.lockstep_s,
        "robots": {
            str(number): {
                "state": list(StateSnapshot(robot, pace.speed_tenths).slots()), "actual": _pose(robot.actual),
                "encoder": _pose(robot.encoder), "front": round(robot.front_rad, ANGLE_DIGITS),
                "held": None if (hold := server.estop.get(number)) is None else hold.as_dict(),
            }
            for number, robot in server.simulation.robots.items()
        },
    }  # fmt: skip


def _pose(pose: Pose) -> list[float]:
    return [
        round(pose.x_in, DIGITS), round(pose.y_in, DIGITS),
        round(pose.steering_rad, ANGLE_DIGITS), round(pose.turret_rad, ANGLE_DIGITS),
    ]  # fmt: skip


def _cried(old: dict[int, tuple[Cry | None, ...]], new: dict[int, tuple[Cry | None, ...]]) -> Plain:
    """What sonars cried elsewhere than before, or another way."""
    changed = {
        str(n): [
            [sonar, *_beam(cry)]
            for sonar, (before, cry) in enumerate(zip(old.get(n, SILENT), cries, strict=True))
            if cry is not before and _axis(cry) != _axis(before)
        ]
        for n, cries in new.items()
    }
    return {n: beams for n, beams in changed.items() if beams}


def _axis(cry: Cry | None) -> tuple[float, ...] | None:
    return None if cry is None else (cry.x_in, cry.y_in, cry.direction_rad)


def _beam(cry: Cry | None) -> list[float]:
    if cry is None:
        return []
    return [round(cry.x_in, DIGITS), round(cry.y_in, DIGITS), round(cry.direction_rad, ANGLE_DIGITS)]


def _seen(robot: SimulatedRobot) -> list[float]:
    """In the map: the robot moves on until the laser is looked through again."""
    x, y, _, turret_rad = robot.actual
    c, s = math.cos(turret_rad), math.sin(turret_rad)
    seen = points(robot.look_with_laser(), robot.model.body) @ np.array([[c, s], [-s, c]]) + (x, y)
    return [round(number, 1) for point in seen.tolist() for number in point]


def _shape(number: int, shape: Shape) -> list[Any]:
    return [number, shape.figure.value, list(shape.numbers), shape.colour, shape.xor]


def _newer(trace: Trace, had: int, has: int) -> Plain:
    """What a track grew by from so many points to so many, whatever it grew by since; a viewer that follows a
    simulation at a hundred times real time gets every so many of them."""
    new = range(max(had + 1, trace.first), has + 1)
    every = -(-len(new) // MOST_NEW) if had and len(new) > MOST_NEW else 1
    jumps = [number for number in trace.jumps if number in new and (had or number > new.start)]
    shown = sorted({*new[::every], *jumps})
    told: list[float | None] = []
    for number, (x, y) in zip(shown, trace.at(shown), strict=True):
        told += (None, None, round(x, 2), round(y, 2)) if number in jumps else (round(x, 2), round(y, 2))
    return {"gone": has, "points": told}
