"""What a robot's server is asked that is not the robot's own doing: world, drawings, other robots, simulated time.

    RobotLink    a backend, a lock an exchange, what is held after it; everything that talks goes through `execute`
    RobotWorld   the verbs of the server; Robot adds those of the robot

Rules: a method a command, thin: units in, a Call, units out; the C name in the docstring. Every method may raise
ConnectionLost, ReplyTimeout and RobotRefused, and WireError for what no message can hold.
"""

from __future__ import annotations

import contextlib
import math
import os
import threading
from collections.abc import Iterable
from typing import Any, Literal, NamedTuple

from nclient.backends.base import Backend, LinkStatistics
from nclient.errors import RobotRefused, WireError
from nclient.protocol.client_state import ClientState
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.requests import MOTION_ARC, MOTION_LINE
from nclient.protocol.types import Model, rad_from_tenths, tenths_from_rad, unwrap_word
from nclient.state import Pose, RobotState, Truth, snapshot
from nclient.units import Points, points_tenths, tenths_of

_VERBS = {"pause": 1, "resume": 2, "speed": 3, "step": 4}
_TENTHS_OF_A_FACTOR, _MS = 10, 1000
_NOT_HELD = frozenset({"get_ra"})
"""The C library puts accelerations where the velocities were; here they are given back and held nowhere."""


class Arc(NamedTuple):
    """A path to check: from a place, between two angles, round a centre."""

    x_in: float
    y_in: float
    from_rad: float
    to_rad: float
    radius_in: float
    centre_x_in: float
    centre_y_in: float


class Collision(NamedTuple):
    """Where a path meets something, and the direction that points away from it."""

    x_in: float
    y_in: float
    normal_rad: float


class RobotPlace(NamedTuple):
    """Where one of the robots is."""

    x_in: float
    y_in: float
    heading_rad: float


class Prediction(NamedTuple):
    """What the sensors would read at another pose: infrareds 0..15, sonars in inches, the laser vector in 1/10 inch."""

    infrareds: tuple[int, ...]
    sonars_in: tuple[int, ...]
    laser: tuple[int, ...]


class SimulatedTime(NamedTuple):
    """The clock of a simulation: seconds, how fast it runs (0 as fast as it can), whether it is paused."""

    time_s: float
    factor: float
    paused: bool


class RobotLink:
    """A conversation with a robot and what it has told. One exchange at a time, whatever the thread."""

    def __init__(self, backend: Backend) -> None:
        self._backend = backend
        self._held = ClientState()
        self._lock = threading.RLock()
        if backend.greeting is not None:
            self._held.apply_reply(backend.greeting)
        self._state = snapshot(self._held, backend.wire_state.model)

    @property
    def model(self) -> Model:
        """The robot's model, as the address or the other end said."""
        return self._backend.wire_state.model

    @property
    def closed(self) -> bool:
        """Whether the conversation is over; every method then raises ConnectionLost."""
        return self._backend.closed

    @property
    def link(self) -> LinkStatistics | None:
        """What the link has been through (print it for a summary); None of an Nserver, but with reconnect=."""
        return self._backend.link

    @property
    def state(self) -> RobotState:
        """What is known after the last exchange; asks nobody and waits for nobody."""
        return self._state

    def execute(self, call: Call) -> Reply:
        """One command in wire units, for those who know the table (nclient.protocol.commands); its reply."""
        with self._lock:
            try:
                reply = self._backend.execute(call)
            except RobotRefused as refusal:
                if refusal.code is not None:
                    self._absorb(Reply("error", values=(refusal.code,)))
                raise
            if call.name not in _NOT_HELD:
                self._absorb(reply)
            return reply

    def _absorb(self, reply: Reply) -> None:
        self._held.apply_reply(reply)
        self._state = snapshot(self._held, self._backend.wire_state.model)

    def _ask(self, name: str, *args: Any) -> RobotState:
        """A command by its C name; what is known after it."""
        with self._lock:
            self.execute(Call(name, args))
            return self._state

    def _values(self, name: str, *args: Any, at_least: int = 0) -> tuple[int, ...]:
        """A command by its C name; the numbers of its reply."""
        values = self.execute(Call(name, args)).values
        if len(values) < at_least:
            raise WireError(f"{name}: {at_least} numbers wanted in the answer, {len(values)} there")
        return values


class RobotWorld(RobotLink):
    """The verbs of an Nserver: what a real robot's own line does not have."""

    def connect_robot(self, robot_id: int) -> RobotState:
        """Go over to another robot of the same server, on this connection. C: connect_robot

        Raises RobotRefused when there is none of that number; our Nserver then keeps the robot there was.
        """
        with self._lock:
            self.execute(Call("connect_robot", (robot_id, os.getpid())))
            return self._ask("gs")

    def create_robot(self, robot_id: int) -> RobotState:
        """Make a robot of that number and go over to it. C: create_robot"""
        with self._lock:
            self.execute(Call("create_robot", (robot_id, os.getpid())))
            return self._ask("gs")

    def place(self, pose: Pose) -> None:
        """Put the robot somewhere, and what its encoders say with it. C: place_robot

        Raises RobotRefused where it would touch something.
        """
        self._values("place_robot", *_pose_tenths(pose))

    def read_robots(self) -> tuple[RobotPlace, ...]:
        """Where all robots are. C: get_rpx"""
        count, *numbers = self._values("get_rpx", at_least=1)
        if len(numbers) != 3 * count:
            raise WireError(f"get_rpx: {count} robots with {len(numbers)} numbers")
        triples = zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)
        return tuple(RobotPlace(x / 10, y / 10, rad_from_tenths(heading)) for x, y, heading in triples)

    def ask_pose(self) -> Pose:
        """A pose clicked in the server's window (or the actual one where there is no window). C: get_robot_conf"""
        x, y, steering, turret = self._values("get_robot_conf", at_least=4)
        return Pose(x / 10, y / 10, rad_from_tenths(steering), rad_from_tenths(turret))

    def add_obstacle(self, *, corners_in: Points | None = None, corners_m: Points | None = None) -> None:
        """Add a polygon of at most ten corners, counter-clockwise. C: add_obstacle"""
        self._values("add_obstacle", *_polygon(corners_in, corners_m))

    def delete_obstacle(self, *, corners_in: Points | None = None, corners_m: Points | None = None) -> None:
        """Take away the polygon with these corners. C: delete_obstacle"""
        self._values("delete_obstacle", *_polygon(corners_in, corners_m))

    def move_obstacle(
        self,
        *,
        corners_in: Points | None = None,
        shift_in: tuple[float, float] | None = None,
        corners_m: Points | None = None,
        shift_m: tuple[float, float] | None = None,
    ) -> tuple[tuple[float, float], ...]:
        """Shift the polygon with these corners; its corners afterwards, in inches. C: move_obstacle"""
        shift = points_tenths(None if shift_in is None else [shift_in], None if shift_m is None else [shift_m])
        _, *moved = self._values("move_obstacle", *_polygon(corners_in, corners_m), *shift, at_least=1)
        return tuple((x / 10, y / 10) for x, y in zip(moved[::2], moved[1::2], strict=True))

    def clear_world(self) -> None:
        """Take all obstacles away; marked walls stay. C: new_world"""
        self._values("new_world")

    def predict_sensors(self, pose: Pose) -> Prediction:
        """What the sensors would read at another pose. C: predict_sensors"""
        reply = self.execute(Call("predict_sensors", _pose_tenths(pose)))
        return Prediction(reply.values[1:17], reply.values[17:33], reply.laser or (0,))

    def check_motion(
        self, *, line_in: Points | None = None, line_m: Points | None = None, arc: Arc | None = None
    ) -> Collision | None:
        """Where a line (two points) or an arc first meets something; None where it does not. C: motion_check

        The C call's doubles are taken to be tenths of an inch, as all its lengths.
        """
        args: tuple[float, ...]
        if arc is None:
            args = (MOTION_LINE, *[1000 * number for number in points_tenths(line_in, line_m)])
        else:
            x, y, radius, *centre = [10000 * inches for inches in arc[:2] + arc[4:]]
            args = (MOTION_ARC, x, y, 1000 * arc.from_rad, 1000 * arc.to_rad, radius, *centre)
        hit, x_hit, y_hit, normal = self._values("motion_check", *args, at_least=4)
        return Collision(x_hit / 1000, y_hit / 1000, normal / 1e6) if hit else None

    def draw_robot(self, pose: Pose, mode: int = 1) -> None:
        """Draw a robot in the server's window. C: draw_robot

        `mode`: 1 black XOR, 2 the same with an arrow that stays, 3 black, above 3 colour mode - 3, XOR.
        """
        self._values("draw_robot", *_pose_tenths(pose), mode)

    def draw_line(self, *, points_in: Points | None = None, points_m: Points | None = None, mode: int = 1) -> None:
        """Draw a line between two points. C: draw_line

        `mode`: 1 black, 2 black XOR, above 2 colour mode - 2, XOR.
        """
        self._values("draw_line", *points_tenths(points_in, points_m), mode)

    def draw_arc(
        self,
        *,
        box_in: tuple[float, float, float, float] | None = None,
        box_m: tuple[float, float, float, float] | None = None,
        angles_rad: tuple[float, float] = (0.0, math.tau),
        mode: int = 1,
    ) -> None:
        """Draw an arc of the ellipse in a box (x0, y0, width, height) between two angles. C: draw_arc

        `mode` as in draw_line.
        """
        box = points_tenths(_halves(box_in), _halves(box_m))
        self._values("draw_arc", *box, *[tenths_from_rad(angle) for angle in angles_rad], mode)

    def redraw_all(self) -> None:
        """Redraw everything. C: refresh_all"""
        self._values("refresh_all")

    def redraw_all_traces(self) -> None:
        """Redraw both traces. C: refresh_all_traces"""
        self._values("refresh_all_traces")

    def redraw_actual_trace(self) -> None:
        """Redraw the trace of the actual robot. C: refresh_actual_trace"""
        self._values("refresh_actual_trace")

    def redraw_encoder_trace(self) -> None:
        """Redraw the trace of the encoder robot. C: refresh_encoder_trace"""
        self._values("refresh_encoder_trace")

    def redraw_all_sensors(self) -> None:
        """Redraw all sensors. C: refresh_all_sensors"""
        self._values("refresh_all_sensors")

    def redraw_bumper_sensor(self) -> None:
        """Redraw the bumpers. C: refresh_bumper_sensor"""
        self._values("refresh_bumper_sensor")

    def redraw_infrared_sensor(self) -> None:
        """Redraw the infrareds. C: refresh_infrared_sensor"""
        self._values("refresh_infrared_sensor")

    def redraw_sonar_sensor(self) -> None:
        """Redraw the sonars. C: refresh_sonar_sensor"""
        self._values("refresh_sonar_sensor")

    def redraw_laser_sensor(self) -> None:
        """Redraw the laser. C: refresh_laser_sensor"""
        self._values("refresh_laser_sensor")

    def redraw_client_graphics(self) -> None:
        """Redraw what clients have drawn. C: refresh_client_graphics"""
        self._values("refresh_client_graphics")

    def use_real_robot(self) -> None:
        """Pass the commands to the real robot from now on. C: real_robot"""
        self._values("real_robot")

    def use_simulated_robot(self) -> None:
        """Pass the commands to the simulation from now on. C: simulated_robot"""
        self._values("simulated_robot")

    def quit_server(self) -> None:
        """End the server. Raises RobotRefused unless its setup allows it. C: quit_server"""
        self._values("quit_server")

    def truth(self) -> Truth:
        """Where the actual robot is; only a simulation of ours knows. Wire name: sim_truth

        Raises RobotRefused (error 1 or 4) where the other end is none.
        """
        _, time_ms, x, y, heading, turret, seed, robot_id = self._values("sim_truth", at_least=8)
        angles = (math.radians(heading / 1000), math.radians(turret / 1000))
        return Truth(x / 1000, y / 1000, *angles, time_s=unwrap_word(time_ms) / 1000, seed=seed, robot_id=robot_id)

    def is_simulated(self) -> bool:
        """Whether the other end is a simulation of ours, which knows the truth. Asks with sim_truth.

        A server of the 1990s does not know that question: it refuses it, or leaves it unanswered and the connection
        is closed after the time-out.
        """
        with contextlib.suppress(RobotRefused):
            self.truth()
            return True
        return False

    def control_time(self, verb: Literal["pause", "resume", "speed", "step"], value: float = 0.0) -> SimulatedTime:
        """Pause, resume, step a simulation's time by `value` seconds, or set its speed. Wire name: sim_control

        speed: `value` times real time, 0 as fast as it can. Raises RobotRefused unless the server allows it,
        ValueError for another verb.
        """
        if verb not in _VERBS:
            raise ValueError(f"a verb is one of {', '.join(_VERBS)}, not {verb!r}")
        scale = {"speed": _TENTHS_OF_A_FACTOR, "step": _MS}.get(verb, 0)
        _, time_ms, speed, paused = self._values("sim_control", _VERBS[verb], round(value * scale), at_least=4)
        return SimulatedTime(time_ms / 1000, speed / 10, bool(paused))


def _pose_tenths(pose: Pose) -> tuple[int, int, int, int]:
    x, y = tenths_of(x_in=pose.x_in), tenths_of(y_in=pose.y_in)
    return x, y, tenths_of(steering_rad=pose.steering_rad), tenths_of(turret_rad=pose.turret_rad)


def _polygon(corners_in: Points | None, corners_m: Points | None) -> tuple[int, ...]:
    numbers = points_tenths(corners_in, corners_m)
    return len(numbers) // 2, *numbers


def _halves(box: Iterable[float] | None) -> Points | None:
    if box is None:
        return None
    x, y, width, height = box
    return [(x, y), (width, height)]
