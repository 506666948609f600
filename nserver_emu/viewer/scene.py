"""The scene that the page draws, as plain data, and its changes since a picture that a viewer has.

    always      frame, since, time_s, speed (null: as fast as possible), paused, lockstep_s
                robots    {id: {"state": State[0..44], "actual": [x, y, steer, turret], "encoder": the same, "front":
                          the direction of bumper 0, "sonars": readings in inches of a ring that State has no room for,
                          "held": {"by": viewer that stopped it, "ignored": number of motions refused since} or null}}
                walkers   [[x, y] ...], in the order of those of the world; if it has any
    if changed  bodies    {id: {"model", "radius_in", "ring_in", "bumpers": count, "differential", "sees",
                          "sonars": {"angles", "shifts": [[forwards, left] ...] or [], "half_cone", "max_in",
                          "no_echo_in"}: the ring (worlds/rings.py),
                          "noise": {"sensors": name in force, "motion": the same}, "noises": the available names}}
                world     {"name", "title", "walls": [[x1, y1, x2, y2] ...], the outlines of rooms first,
                          "rooms", "obstacles": [{"name", "corners"} ...], "starts": [[x, y, steer, turret in
                          degrees] ...], "paths": {name: [[x, y] ...]}, "doors": [{"name", "ends", "open"} ...],
                          "walkers": [{"name", "points", "speed", "radius", "closed"} ...]; the last two if it has any}
                graphics  [[number, figure, numbers, colour, xor] ...], or its changes:
                drawn     {"gone": [number ...], "come": [[number, figure, numbers, colour, xor] ...]}
                traces    {id: {"actual": {"gone", "points"}, "encoder": the same}}    points x, y, x, y ...; null, null
                          before a point to which the robot did not drive
                beams     {id: [[sonar, x, y, direction] ...]}    position and direction of each sonar at the ping whose
                          reading State has; [sonar] where it has not pinged since the robot was placed
                lasers    {id: [x, y, x, y ...]}    points in the map; none of a robot whose laser is off
                laser_modes    {id: [[client, mode] ...]}    the modes that decide whether the laser is shown
                said      [[time_s, id, text] ...]    texts for the speech synthesizer

Units are inches and radians, rounded to what a screen shows; State is in tenths. Keys of JSON objects are strings, so
are ids. Pictures are numbered from 1; number 0 stands for a viewer without a picture. Taking a picture changes nothing
in the simulation.

The laser of a robot is shown while it has no client, or while one of its clients has an odd laser mode (conf_ls). Pages
are not clients. The points of all columns are shown, whichever a client has selected.

Broadcasting to the open pages: which messages each viewer gets next. No sockets, no clock.

    history.take() ──> next_for(viewer)   the newest picture, as the difference to the one that this viewer has
    notify(text)   ──> next_for(viewer)   other messages, in order

A slow viewer gets the newest picture and never a backlog: at most MAX_UNDRAWN pictures are sent that it has not drawn.
Of other messages MAX_MESSAGES wait; then the oldest are dropped, and the viewer is informed how many. Viewers that have
the same picture share the encoded difference. A new viewer starts with the next picture, since the newest may be old:
pictures are taken only while a page is open.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from nserver_emu.server.connection import ConnectionHandler
from nserver_emu.server.graphics import Shape, Trace
from nserver_emu.server.handlers.runtime_settings import noise_choices, noise_of
from nserver_emu.server.server_state import ServerState, StateSnapshot, is_on
from nserver_emu.simulation.acoustics import Ping, Polaroid
from nserver_emu.simulation.noise import RobotSetup
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import Pose
from nserver_emu.simulation.sensors import points
from nserver_emu.viewer.messages import encode_message
from worlds.world import Point, Polygon, World

# Clients per robot that are listed with their laser modes.
MAX_NAMED: Final = 20
VIEWER: Final = "viewer"
Modes = Mapping[int, list[tuple[str, int]]]
"""Clients of each robot with their laser modes: those with the laser on first."""


def laser_modes(connections: Iterable[ConnectionHandler], robots: Collection[int]) -> Modes:
    """Return the laser modes of the clients of these robots."""
    found: dict[int, list[tuple[str, int]]] = {number: [] for number in robots}
    for connection in connections:
        context = connection.session.context
        if connection.is_connected and connection.line != VIEWER and context.robot_id in found:
            found[context.robot_id].append((connection.session.name, context.wire_state.laser_mode))
    # Those with the laser on first, each by name.
    return {number: sorted(clients, key=lambda client: (not is_on(client[1]), client[0]))[:MAX_NAMED]
            for number, clients in found.items()}


def is_shown(clients: list[tuple[str, int]]) -> bool:
    """Return True if the laser of a robot with these clients is shown."""
    return not clients or any(is_on(mode) for _, mode in clients)


MAX_REVISIONS: Final = 64
"""Pictures whose changes are known; a viewer with an older one gets everything."""
LASER_INTERVAL: Final = 4
"""Pictures between two measurements of the laser, whose 482 rays cost more than everything else."""
MAX_NEW_POINTS: Final = 25
"""Points that a picture adds to a trace: 12 in of path in a twentieth of a second, faster than any robot."""
# Counts of both traces of a robot that the viewer does not know yet.
NO_POINTS: Final = (0, 0)
# Decimal places of lengths and times, and of angles: finer than a pixel at any zoom of the page.
DIGITS: Final = 3
ANGLE_DIGITS: Final = 5
Plain = dict[str, Any]


class Revision(NamedTuple):
    """State of everything that grows or changes at the time of a picture."""

    number: int
    robots: tuple[tuple[int, RobotSetup], ...] | None
    world: World | None
    graphics: int
    lasers: int
    laser_modes: Modes | None
    speech: object
    traces: dict[int, tuple[int, int]]
    pings: dict[int, tuple[Ping | None, ...]]


NOTHING: Final = Revision(0, None, None, -1, -1, None, "no text yet", {}, {})
"""Revision of a viewer without a picture: it equals no picture's, so that everything counts as changed."""


class SceneHistory:
    """The newest picture, and its changes since earlier ones."""

    def __init__(self, server_state: ServerState) -> None:
        self._server_state = server_state
        self._revisions: deque[Revision] = deque(maxlen=MAX_REVISIONS)
        self._lasers: dict[str, list[float]] = {}
        self._lasers_taken = 0
        self._modes: Modes = {}
        self._now: Plain = {}
        self.number = 0

    def take(self, *, lasers: Collection[int | None] | None = (), modes: Modes | None = None) -> None:
        """Take a new picture.

        Parameters
        ----------
        lasers : robots whose laser points a viewer watches; None: all.
        modes : laser modes of the robots' clients.
        """
        self._modes = modes or {}
        # 1. The laser, in every LASER_INTERVAL-th picture, if a page shows it.
        if (lasers is None or lasers) and (self.number + 1) % LASER_INTERVAL == 0:
            measured = {str(number): _laser_points(robot)
                        for number, robot in self._server_state.simulation.robots.items()
                        if robot.model.has_light_sensors and (lasers is None or number in lasers)
                        and is_shown(self._modes.get(number, []))}
            # The last points must be cleared once, so an empty measurement after a full one counts.
            self._lasers_taken += bool(measured or self._lasers)
            self._lasers = measured
        # 2. The fixed part, and the revision of everything else.
        now, revision = _now(self._server_state), self._revision()
        self.number, self._now = revision.number, now
        self._revisions.append(revision)

    def since(self, number: int) -> Plain:
        """Return the newest picture for a viewer that has picture `number`: the fixed part, and what changed."""
        # 1. Parts that are sent as a whole when they have changed.
        old, new = self._revision_of(number), self._revisions[-1]
        picture: Plain = {"frame": new.number, "since": old.number} | self._now
        if new.robots != old.robots:
            picture["bodies"] = {str(n): body_data(robot) for n, robot in self._server_state.simulation.robots.items()}
        if new.world and new.world is not old.world:
            picture["world"] = world_data(new.world)
        picture |= self._drawn(old.graphics, new.graphics)
        if new.lasers != old.lasers:
            picture["lasers"] = self._lasers
        if new.laser_modes != old.laser_modes:
            picture["laser_modes"] = {str(n): clients for n, clients in self._modes.items()}
        if new.speech is not old.speech:
            picture["said"] = [list(utterance) for utterance in self._server_state.transcript]
        # 2. Parts that are sent as differences, without empty ones.
        grown = {"traces": self._grown(old.traces, new.traces), "beams": _changed_beams(old.pings, new.pings)}
        return picture | {name: more for name, more in grown.items() if more}

    def _revision_of(self, number: int) -> Revision:
        """Return the revision of a picture; NOTHING where it is no longer known."""
        age = self.number - number
        return self._revisions[-1 - age] if number > 0 and 0 <= age < len(self._revisions) else NOTHING

    def _drawn(self, before: int, now: int) -> Plain:
        graphics = self._server_state.graphics
        # Differences if the changes since then are known, else all figures.
        if before == now:
            return {}
        changes = graphics.changes(before, now) if before >= 0 else None
        if changes is None:
            return {"graphics": [_shape(number, shape) for number, shape in graphics.numbered if number <= now]}
        gone, come = changes
        return {"drawn": {"gone": gone, "come": [_shape(*numbered) for numbered in come]}}

    def _revision(self) -> Revision:
        server_state = self._server_state
        speech = server_state.transcript
        traces = server_state.traces
        # Counts of all points ever added, which identify the state of a trace.
        counts = {n: (trace.count, traces.encoder[n].count) for n, trace in traces.actual.items()}
        simulation = server_state.simulation
        return Revision(self.number + 1, tuple((n, robot.setup) for n, robot in simulation.robots.items()),
                        simulation.world, server_state.graphics.drawn, self._lasers_taken, self._modes,
                        speech[-1] if speech else None, counts,
                        {n: robot.sonar.pings for n, robot in simulation.robots.items()})

    def _grown(self, old: dict[int, tuple[int, int]], new: dict[int, tuple[int, int]]) -> Plain:
        traces = self._server_state.traces
        return {str(n): {"actual": _newer(traces.actual[n], had[0], has[0]),
                         "encoder": _newer(traces.encoder[n], had[1], has[1])}
                for n, has in new.items() if (had := old.get(n, NO_POINTS)) != has}


def body_data(robot: SimulatedRobot) -> Plain:
    """Return the data from which a robot is drawn."""
    shape = robot.model.body
    return {
        "model": robot.model.name, "family": robot.model.family, "radius_in": shape.radius_in,
        "ring_in": shape.sonar_ring_radius_in, "bumpers": len(shape.bumper_angles_rad),
        "differential": robot.model.track_in is not None, "sees": robot.model.has_light_sensors,
        "sonars": ring_data(robot),
        "noise": noise_of(robot), "noises": noise_choices(robot),
    }  # fmt: skip


def ring_data(robot: SimulatedRobot) -> Plain:
    """Return the ring of a robot, with the cone that is in force; of exact rays that of a Polaroid transducer."""
    ring, sonar = robot.model.body.ring, robot.setup.sonar
    half_cone_rad = ring.half_cone_rad or Polaroid().cone_rad / 2.0
    return {
        "angles": [round(angle, ANGLE_DIGITS) for angle in ring.angles_rad],
        "shifts": [[round(number, DIGITS) for number in shift] for shift in ring.shifts_in],
        "half_cone": round(sonar.cone_rad / 2.0 if isinstance(sonar, Polaroid) else half_cone_rad, ANGLE_DIGITS),
        # Rounded as the readings are: the page compares them.
        "max_in": round(ring.max_range_in, DIGITS), "no_echo_in": round(ring.no_echo_in, DIGITS),
    }  # fmt: skip


def _sonars(robot: SimulatedRobot) -> Plain:
    """Return the readings that State has no room for."""
    if robot.model.body.ring.fits_state:
        return {}
    return {"sonars": [round(reading, DIGITS) for reading in robot.sonar.readings_in]}


def world_data(world: World) -> Plain:
    """Return the data from which a world is drawn."""
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
    } | {name: rows for name, rows in _optional_parts(world).items() if rows}  # fmt: skip


def _optional_parts(world: World) -> Plain:
    return {
        "wall_names": {str(row): name for row, name in world.wall_names.items()},
        "doors": [
            {"name": door.name, "ends": _rounded(door.ends_in), "open": door.is_open} for door in world.doors
        ],
        "walkers": [
            {"name": walker.name, "points": _rounded(walker.points_in), "speed": round(walker.speed_in_s, DIGITS),
             "radius": round(walker.radius_in, DIGITS), "closed": walker.is_closed}
            for walker in world.walkers
        ],
    }  # fmt: skip


def _outline(polygon: Polygon) -> Plain:
    return {"name": polygon.name, "corners": _rounded(polygon.corners_in)}


def _rounded(points: Iterable[Point]) -> list[list[float]]:
    return [[round(x, DIGITS), round(y, DIGITS)] for x, y in points]


def _now(server_state: ServerState) -> Plain:
    pace, walkers = server_state.clock, server_state.simulation.walkers
    return {
        "time_s": round(server_state.simulation.time_s, DIGITS), "speed": pace.factor, "paused": pace.paused,
        "lockstep_s": pace.lockstep_s,
        "robots": {
            str(number): {
                "state": list(StateSnapshot(robot, pace.speed_tenths).slots()), "actual": _pose(robot.actual),
                "encoder": _pose(robot.encoder), "front": round(robot.front_rad, ANGLE_DIGITS),
                "held": None if (hold := server_state.estop.get(number)) is None else hold.as_dict(),
                **_sonars(robot),
            }
            for number, robot in server_state.simulation.robots.items()
        },
    } | ({"walkers": _rounded(walker.disc[:2] for walker in walkers)} if walkers else {})  # fmt: skip


def _pose(pose: Pose) -> list[float]:
    return [round(pose.x_in, DIGITS), round(pose.y_in, DIGITS), round(pose.steering_rad, ANGLE_DIGITS),
            round(pose.turret_rad, ANGLE_DIGITS)]


def _changed_beams(old: dict[int, tuple[Ping | None, ...]], new: dict[int, tuple[Ping | None, ...]]) -> Plain:
    """Return the sonars whose latest ping has another position or direction than before."""
    changed: Plain = {}
    for n, pings in new.items():
        pairs = zip(old.get(n, (None,) * len(pings)), pings, strict=True)
        if beams := [[sonar, *_beam(ping)] for sonar, (before, ping) in enumerate(pairs)
                     if ping is not before and _axis(ping) != _axis(before)]:
            changed[str(n)] = beams
    return changed


def _axis(ping: Ping | None) -> tuple[float, ...] | None:
    return None if ping is None else (ping.x_in, ping.y_in, ping.direction_rad)


def _beam(ping: Ping | None) -> list[float]:
    if ping is None:
        return []
    return [round(ping.x_in, DIGITS), round(ping.y_in, DIGITS), round(ping.direction_rad, ANGLE_DIGITS)]


def _laser_points(robot: SimulatedRobot) -> list[float]:
    """Return laser points in map coordinates: the robot moves on before the laser measures again."""
    # Rotate by the turret, on which the laser is mounted, then translate.
    x, y, _, turret_rad = robot.actual
    c, s = math.cos(turret_rad), math.sin(turret_rad)
    measured = points(robot.scan_laser(), robot.model.body) @ np.array([[c, s], [-s, c]]) + (x, y)
    return [round(number, 1) for point in measured.tolist() for number in point]


def _shape(number: int, shape: Shape) -> list[Any]:
    return [number, shape.figure.value, list(shape.numbers), shape.colour, shape.xor]


def _newer(trace: Trace, had: int, has: int) -> Plain:
    """Return the points that a trace gained between two counts.

    A viewer of a simulation at many times real time gets a subset of the points, evenly spread.
    """
    # 1. Numbers of the points since then, as far as the trace still has them.
    new = range(max(had + 1, trace.first), has + 1)
    # 2. Every n-th of them, rounded up; jumps are never left out, or a line would be drawn across.
    every = -(-len(new) // MAX_NEW_POINTS) if had and len(new) > MAX_NEW_POINTS else 1
    jumps = [number for number in trace.jumps if number in new and (had or number > new.start)]
    shown = sorted({*new[::every], *jumps})
    # 3. Pairs of coordinates; a pair of nulls interrupts the line before a jump.
    coordinates: list[float | None] = []
    for number, (x, y) in zip(shown, trace.at(shown), strict=True):
        coordinates += (None, None, round(x, 2), round(y, 2)) if number in jumps else (round(x, 2), round(y, 2))
    return {"gone": has, "points": coordinates}


MAX_UNDRAWN: Final = 10
"""Pictures in flight to a viewer: half a second of them."""
# Bound of the memory for a page that receives nothing until it is disconnected.
MAX_MESSAGES: Final = 1000


class Viewer:
    """One open page.

    Attributes
    ----------
    may_act : True if it may do more than watch.
    robot, person : the only robot on which a student may act, None for all, and the name of the person, if known.
    name : name in logs and for other viewers.
    joined_at : number of the newest picture when the page was opened.
    on_message : called when a message is waiting.
    latest : number of the latest picture sent; `drawn`: of the latest one drawn.
    traffic, laser : True if it wants traffic rows, laser points; `laser_robot`: of this robot, None for all.
    dropped : number of messages dropped since the last message about it.
    """

    def __init__(self, *, may_act: bool, name: str = "viewer", joined_at: int = 0) -> None:
        self.may_act = may_act
        self.robot: int | None = None
        self.person = ""
        self.name = name
        self.joined_at = joined_at
        self.on_message: Callable[[], object] = lambda: None
        self.latest = 0
        self.drawn = 0
        self.traffic = False
        self.laser = False
        self.laser_robot: int | None = None
        self.dropped = 0
        self._undrawn: deque[int] = deque()
        self._messages: deque[str] = deque()

    def notify(self, text: str) -> None:
        """Queue a message."""
        if len(self._messages) >= MAX_MESSAGES:
            self._messages.popleft()
            self.dropped += 1
        self._messages.append(text)
        self.on_message()

    def take_messages(self) -> Sequence[str]:
        """Return the queued messages, and remove them from the queue."""
        if not self._messages:
            return ()
        messages = list(self._messages)
        self._messages.clear()
        # The page learns that its list of messages has a gap.
        if self.dropped:
            messages.append(encode_message("missed", count=self.dropped))
            self.dropped = 0
        return messages

    @property
    def is_behind(self) -> bool:
        """True if so many pictures are in flight that the next has to wait."""
        return len(self._undrawn) >= MAX_UNDRAWN

    def mark_sent(self, frame: int) -> None:
        """Record that this picture was sent."""
        self.latest = frame
        self._undrawn.append(frame)

    def mark_drawn(self, frame: int) -> None:
        """Record that the page has drawn or skipped this picture, and so all before it."""
        self.drawn = max(self.drawn, frame)
        while self._undrawn and self._undrawn[0] <= frame:
            self._undrawn.popleft()


class Broadcaster:
    """The open pages, and the messages for each of them."""

    def __init__(self, history: SceneHistory) -> None:
        self.viewers: set[Viewer] = set()
        self._history = history
        self._differences: dict[int, str] = {}
        """Encoded differences to the newest picture, by the number of the older one."""
        self._viewer_count = 0

    def join(self, *, may_act: bool, person: str = "") -> Viewer:
        """Add a viewer; its name contains that of the person, if it is known, and is unique."""
        self._viewer_count += 1
        name = f"viewer {self._viewer_count}"
        viewer = Viewer(may_act=may_act, name=f"{person} ({name})" if person else name, joined_at=self._history.number)
        viewer.person = person
        self.viewers.add(viewer)
        return viewer

    def notify(self, text: str, *, traffic: bool = False) -> None:
        """Queue a message for all viewers, or for those that watch the traffic."""
        for viewer in self.viewers:
            if viewer.traffic or not traffic:
                viewer.notify(text)

    @property
    def watch_traffic(self) -> bool:
        """True if any viewer watches the traffic."""
        return any(viewer.traffic for viewer in self.viewers)

    def take(self, modes: Modes | None = None) -> None:
        """Take a new picture; `modes` are the laser modes of the robots' clients."""
        # Differences are to the newest picture, so all are outdated now.
        self._differences.clear()
        # None stands for all robots.
        watched = {viewer.laser_robot for viewer in self.viewers if viewer.laser}
        self._history.take(lasers=None if None in watched else watched, modes=modes)

    def next_for(self, viewer: Viewer) -> Iterator[str]:
        """Yield the next messages for a viewer, the picture last, so that a failing picture holds back no message."""
        yield from viewer.take_messages()
        if self._history.number > max(viewer.latest, viewer.joined_at) and not viewer.is_behind:
            text = self._difference_since(viewer.latest)
            viewer.mark_sent(self._history.number)
            yield text

    def _difference_since(self, number: int) -> str:
        if number not in self._differences:
            self._differences[number] = encode_message("picture", **self._history.since(number))
        return self._differences[number]
