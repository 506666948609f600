"""The handlers of all commands, and the emulator that has them.

    modules    robot.py (motions, sensors) | world.py (obstacles, poses) | graphics.py (window, speech, arm) | this one

A handler is a function(server, context, args) with the name of its command; it returns a Reply, a DeferredReply, or
None for the state. To add a command: a row in `nclient/protocol/commands.py`, and its function. A command without a
handler gets ERROR 4.

Handlers of commands to the server itself: connecting, ending the server, simulated time. One function per command.

A command that the server does not permit is ERROR 5. There is no real robot behind a simulation: real_robot is ERROR 4.
"""

from __future__ import annotations

import logging
from typing import Final

from nclient.protocol.commands import BY_NAME
from nclient.protocol.replies import Reply
from nserver_emu.server.config import StartPoseAllocator
from nserver_emu.server.handlers import graphics, robot, world
from nserver_emu.server.server_state import MAX_TIME_FACTOR, MIN_TIME_FACTOR, Handler, ServerState
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, REFUSED, ConnectionContext, done, error_reply
from nserver_emu.simulation.simulation import Simulation

log = logging.getLogger(__name__)

# Robots in one world that clients can add to with create_robot.
MAX_ROBOTS: Final = 100
MAX_ROBOT_ID: Final = 0x7FFF
# A longer step of sim_control would block other clients.
MAX_STEP_MS: Final = 60_000
# Verbs of sim_control.
PAUSE, RESUME, SPEED, STEP = 1, 2, 3, 4
_INT32_MAX = 0x7FFFFFFF


def connect_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Connect to a robot; the reply is port 0, and nothing changes, if there is no robot of that number."""
    robot_id = args[0]
    exists = robot_id in server.simulation.robots
    if exists:
        context.robot_id = robot_id
        server.axis_ownership.claim_unowned(context, robot_id, server.simulation.robots[robot_id])
    return Reply("simple", values=(server.port if exists else 0,))


def create_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Create a robot like the first one and connect to it; an existing number is connected to.

    The reply is port 0 if it cannot be created: invalid number, too many robots, no free start pose.
    """
    robot_id = args[0]
    if robot_id not in server.simulation.robots and (reason := _create(server.simulation, robot_id)):
        log.info("robot %s not created: %s", robot_id, reason)
    return connect_robot(server, context, args)


def _create(simulation: Simulation, robot_id: int) -> str:
    """Create a robot; return the reason if it cannot be created, else an empty string."""
    if not 1 <= robot_id <= MAX_ROBOT_ID:
        return f"a robot's number is 1 to {MAX_ROBOT_ID}"
    if len(simulation.robots) >= MAX_ROBOTS:
        return f"there are {len(simulation.robots)} robots already, the maximum"
    first = simulation.robots[min(simulation.robots)]
    pose = StartPoseAllocator(simulation).next(first.model.body.radius_in)
    if pose is None:
        return f"no free space around the starts of {simulation.world.name} for one more than {len(simulation.robots)}"
    simulation.add_robot(robot_id, pose, first.model, first.setup)
    return ""


def disconnect_robot(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Stop the client's motions; the session then closes the connection without a reply."""
    server.on_disconnect(context)
    return done()


def simulated_robot(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Select the simulation, to which commands go anyway."""
    return done()


def real_robot(_server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Refuse: there is no real robot here."""
    return error_reply(NOT_AVAILABLE)


def quit_server(server: ServerState, _context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """End the server if permitted; the reply is still sent."""
    if not server.allowed.quit:
        return error_reply(REFUSED)
    server.quitting = True
    return done()


def sim_control(server: ServerState, _context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Pause, resume, set the speed (tenths, 0 unlimited) or step (ms); the reply has the resulting clock."""
    verb, value = args
    clock = server.clock
    if not server.allowed.control or (verb == SPEED and clock.lockstep_s is not None):
        return error_reply(REFUSED)
    if verb == STEP and 0 <= value <= MAX_STEP_MS:
        server.pass_time(value / 1000)
    elif verb == SPEED and (value == 0 or MIN_TIME_FACTOR <= value / 10 <= MAX_TIME_FACTOR):
        clock.factor = value / 10 or None
    elif verb in (PAUSE, RESUME):
        clock.paused = verb == PAUSE
    else:
        return error_reply(BAD_VALUES)
    speed = 0 if clock.factor is None or clock.lockstep_s is not None else round(10 * clock.factor)
    return Reply("control", values=(1, server.clock_ms & _INT32_MAX, speed, int(clock.paused)))


HANDLERS: dict[str, Handler] = {name: handler for functions in (*map(vars, (robot, world, graphics)), globals())
                                for name, handler in functions.items() if name in BY_NAME} | graphics.REFRESHERS


class Emulator(ServerState):
    """A simulation behind the protocol."""

    handlers = HANDLERS
    preparations = {"predict_sensors": world.prepare_prediction}  # noqa: RUF012
