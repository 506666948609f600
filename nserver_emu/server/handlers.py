"""What each command does to a simulation: a function a command, wire units in, a Reply out.

    HANDLERS    C name -> function(emulator, visit, args) -> Reply, or a Later that gives one
    Emulator    the simulation as a server sees it; its `answer` is what a Session is handed

Rules: tenths become inches and radians here, and nowhere deeper. A command without a handler answers ERROR 4, never
silence, never a wrong success. Values out of range are clamped by the robot, as old clients do send them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

from nclient.errors import StartError
from nclient.protocol.commands import Call
from nclient.protocol.mask import BUMPER_SLOT, Position
from nclient.protocol.replies import Reply
from nclient.protocol.units import clamped_word, rad_from_tenths, wrapped_word
from nserver_emu.server.session import Later, Visit, error_reply
from nserver_emu.server.state_reply import (
    bumper_stamp,
    clock_ms,
    pose_tenths,
    sonar_stamps,
    state_reply,
    state_slots,
    velocity_tenths,
)
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation

NOT_AVAILABLE, BAD_VALUES = 4, 2
AS_FAST_AS_IT_CAN = 9999
"""What State[0] shows where the simulated time runs as fast as it can."""
ALL_AXES = (0, 1, 2)
_MV_LEAVE, _MV_HIGHEST = 0, 5
_MV_MOTIONS = (1, 2, 3)
"""The modes of mv that move an axis or let it go; 4 and 5 only set its limits."""
_INT32_MAX = 0x7FFFFFFF


class Emulator:
    """A simulation behind the protocol. `port` is what CONNECT answers, `speed_tenths` what State[0] shows."""

    def __init__(self, simulation: Simulation, *, port: int = 1, speed_tenths: int = 10) -> None:
        self.simulation = simulation
        self.port = port
        self.speed_tenths = speed_tenths
        self._drivers: dict[int, list[Visit | None]] = {}
        self._looked: dict[int, tuple[float, list[int]]] = {}

    def answer(self, call: Call, visit: Visit) -> Reply | Later:
        """The reply to a call, or a promise of it; ERROR 4 where there is nothing that could answer."""
        if visit.robot_id is not None:
            self.robot_of(visit).feed()
        if call.name not in QUESTIONS:
            self._looked.clear()
        handler = HANDLERS.get(call.name)
        return handler(self, visit, call.args) if handler else error_reply(NOT_AVAILABLE)

    def leave(self, visit: Visit) -> None:
        """A connection is gone: a robot with an axis that obeys its last motion command stops."""
        self._looked.clear()
        for robot_id in [robot_id for robot_id, drivers in self._drivers.items() if visit in drivers]:
            del self._drivers[robot_id]
            self.simulation.robots[robot_id].stop()

    def robot_of(self, visit: Visit) -> SimulatedRobot:
        """The robot that this connection talks to."""
        assert visit.robot_id is not None
        return self.simulation.robots[visit.robot_id]

    def drive(self, visit: Visit, axes: Iterable[int] = ALL_AXES) -> SimulatedRobot:
        """The robot, these axes of it from now on obeying this connection."""
        assert visit.robot_id is not None
        drivers = self._drivers.setdefault(visit.robot_id, [None] * len(ALL_AXES))
        for axis in axes:
            drivers[axis] = visit
        return self.robot_of(visit)

    def state(self, visit: Visit) -> Reply:
        """The state reply that most commands answer with.

        Between two steps a robot changes by commands only, so many who ask cost one look at it.
        """
        assert visit.robot_id is not None
        robot, now_s = self.simulation.robots[visit.robot_id], self.simulation.time_s
        looked_s, slots = self._looked.get(visit.robot_id, (None, []))
        if looked_s != now_s:
            slots = state_slots(robot, self.speed_tenths)
            self._looked[visit.robot_id] = (now_s, slots)
        return state_reply(robot, visit, now_s, slots)

    @property
    def clock_ms(self) -> int:
        """Simulated milliseconds since the start."""
        return clock_ms(self.simulation.time_s)


Handler = Callable[[Emulator, Visit, tuple[Any, ...]], "Reply | Later"]


def connect_robot(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Tie the connection to a robot; port 0, and no change, where there is none of that number."""
    robot_id = args[0]
    known = robot_id in emulator.simulation.robots
    visit.robot_id = robot_id if known else visit.robot_id
    return Reply("simple", values=(emulator.port if known else 0,))


def disconnect_robot(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The client is going; the session closes without an answer."""
    del args
    emulator.leave(visit)
    return Reply("simple", values=(0,))


def vm(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Velocities until another motion command or the time-out."""
    emulator.drive(visit).set_velocities(*_axes(args))
    return emulator.state(visit)


def pr(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Each axis its distance, all at once."""
    emulator.drive(visit).move_relative(*_axes(args))
    return emulator.state(visit)


def mv(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Each axis in a mode of its own; a mode that clients refuse is refused here too, before anything moves."""
    modes, values = args[::2], _axes(args[1::2])
    if any(not _MV_LEAVE <= mode <= _MV_HIGHEST for mode in modes):
        return error_reply(BAD_VALUES)
    robot = emulator.drive(visit, [axis for axis, mode in enumerate(modes) if mode in _MV_MOTIONS])
    for axis, (mode, value) in enumerate(zip(modes, values, strict=True)):
        robot.command_axis(axis, mode, value)
    return emulator.state(visit)


def sp(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The speeds of pr."""
    emulator.robot_of(visit).set_speeds(*_axes(args))
    return emulator.state(visit)


def ac(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The accelerations; without effect in an ideal setup, as the original's documentation says."""
    emulator.robot_of(visit).set_accelerations(*_axes(args))
    return emulator.state(visit)


def st(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Stop and hold."""
    del args
    emulator.drive(visit).stop()
    return emulator.state(visit)


def lp(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Let the motors go limp."""
    del args
    emulator.drive(visit).limp()
    return emulator.state(visit)


def ws(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Later:
    """The state, when the named axes are still or the timeout (simulated seconds) is over."""
    robot = emulator.robot_of(visit)
    axes = [axis for axis, flag in enumerate(args[:3]) if flag]
    deadline_s = emulator.simulation.time_s + max(0, args[3])
    return lambda: (
        emulator.state(visit) if robot.still(axes) or emulator.simulation.time_s >= deadline_s else None
    )


def zr(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Later:
    """Turn to the bumper's zero; the state, when that is done or another motion command took over."""
    del args
    robot = emulator.drive(visit)
    robot.zero()
    return lambda: None if robot.zeroing else emulator.state(visit)


def dp(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the position."""
    emulator.robot_of(visit).define_position(args[0] / 10, args[1] / 10)
    return emulator.state(visit)


def da(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """What the encoders say of the angles."""
    emulator.robot_of(visit).define_angles(rad_from_tenths(args[0]), rad_from_tenths(args[1]))
    return emulator.state(visit)


def place_robot(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Put the robot somewhere; a place where it would touch a wall is refused."""
    robot, (x, y, steering, turret) = emulator.robot_of(visit), args
    try:
        emulator.simulation.world.require_free(x / 10, y / 10, robot.model.body.radius_in)
    except StartError:
        return error_reply(BAD_VALUES)
    robot.place(x / 10, y / 10, rad_from_tenths(steering), rad_from_tenths(turret))
    return _done()


def conf_tm(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Stop the motion when no command comes for so many simulated seconds; 0 never."""
    emulator.robot_of(visit).set_timeout(max(0, args[0]))
    return emulator.state(visit)


def conf_sn(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The sonars' firing rate and order; the ring starts anew."""
    rate, *order = args
    if not 0 <= rate <= 255 or not all(0 <= number < 16 or number == 255 for number in _until_end(order)):
        return error_reply(BAD_VALUES)
    emulator.robot_of(visit).configure_sonars(rate, tuple(order))
    return emulator.state(visit)


def ct(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The session has noted the mask; the reply shows it at work."""
    del args
    return emulator.state(visit)


def gs(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The state."""
    del args
    return emulator.state(visit)


def get_sn(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """All sixteen sonars, mask or not."""
    del args
    robot = emulator.robot_of(visit)
    slots = dict(enumerate(robot.sonar.readings_in, start=17))
    stamps = sonar_stamps(robot) if visit.terms.mask.position & Position.SONAR else {}
    visit.keep(slots)
    return Reply("sonar", slots, stamps=stamps, clock=emulator.clock_ms)


def get_rc(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Position and angles."""
    del args
    slots = dict(enumerate(pose_tenths(emulator.robot_of(visit)), start=34))
    visit.keep(slots)
    return Reply("configuration", slots)


def get_rv(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The three velocities."""
    del args
    slots = dict(enumerate(velocity_tenths(emulator.robot_of(visit)), start=38))
    visit.keep(slots)
    return Reply("velocity", slots)


def get_bp(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """The bumpers."""
    del args
    robot = emulator.robot_of(visit)
    asked = visit.terms.mask.position & Position.BUMPER
    stamps = {"bumper": bumper_stamp(robot, emulator.simulation.time_s)} if asked else {}
    visit.keep({BUMPER_SLOT: robot.bumpers})
    return Reply("bumper", {BUMPER_SLOT: robot.bumpers}, stamps=stamps, clock=emulator.clock_ms)


def sim_truth(emulator: Emulator, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Where the actual robot is; the filter never sees it."""
    del args
    pose = emulator.robot_of(visit).actual
    values = (
        1,
        wrapped_word(emulator.clock_ms),
        clamped_word(round(pose.x_in * 1000)),
        clamped_word(round(pose.y_in * 1000)),
        round(math.degrees(pose.steering_rad) * 1000),
        round(math.degrees(pose.turret_rad) * 1000),
        emulator.simulation.seed & _INT32_MAX,
        visit.robot_id or 0,
    )
    return Reply("truth", values=values)


QUESTIONS = frozenset({"gs", "ct", "get_sn", "get_rc", "get_rv", "get_bp", "sim_truth"})
"""Commands that change nothing about a robot."""

HANDLERS: dict[str, Handler] = {
    handler.__name__: handler
    for handler in (
        connect_robot, disconnect_robot,
        vm, pr, mv, sp, ac, st, lp, ws, zr, dp, da, place_robot, conf_tm, conf_sn, ct,
        gs, get_sn, get_rc, get_rv, get_bp, sim_truth,
    )
}  # fmt: skip
"""Every command the emulator has something to say to."""


def _axes(args: tuple[int, ...]) -> tuple[float, float, float]:
    return args[0] / 10, rad_from_tenths(args[1]), rad_from_tenths(args[2])


def _until_end(order: list[int]) -> list[int]:
    return order[: order.index(255)] if 255 in order else order


def _done() -> Reply:
    return Reply("simple", values=(0,))
