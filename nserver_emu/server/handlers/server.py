"""Commands to the server itself: who talks to which robot, whether it runs on, how its time goes. A function a command.

Rules: what the setup does not allow is ERROR 5. There is no real robot behind a simulation: real_robot is ERROR 4.
"""

from __future__ import annotations

import logging
from typing import Final

from nclient.protocol.replies import Reply
from nserver_emu.server.config import StartPoseAllocator
from nserver_emu.server.context import FASTEST, SLOWEST, ServerState
from nserver_emu.server.handlers.world import done
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, REFUSED, ConnectionContext, error_reply
from nserver_emu.simulation.simulation import Simulation

log = logging.getLogger(__name__)

MAX_ROBOTS: Final = 100
"""Robots that clients can make; the next is refused."""

HIGHEST_ID: Final = 0x7FFF
LONGEST_STEP_MS: Final = 60_000
"""A longer step would keep the other clients waiting."""

PAUSE, RESUME, SPEED, STEP = 1, 2, 3, 4
_INT32_MAX = 0x7FFFFFFF


def connect_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Tie the connection to a robot; port 0, and no change, where there is none of that number."""
    robot_id = args[0]
    known = robot_id in server.simulation.robots
    context.robot_id = robot_id if known else context.robot_id
    if known:
        server.axis_ownership.claim_unowned(context, robot_id, server.simulation.robots[robot_id])
    return Reply("simple", values=(server.port if known else 0,))


def create_robot(server: ServerState, context: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Make a robot of that number, like the first one and beside the others; one that is there is connected to.

    Port 0 where it cannot be: no id, too many robots, or nowhere room for it.
    """
    robot_id = args[0]
    if robot_id not in server.simulation.robots and (reason := _make(server.simulation, robot_id)):
        log.info("robot %s is not made: %s", robot_id, reason)
    return connect_robot(server, context, args)


def _make(simulation: Simulation, robot_id: int) -> str:
    """Make a robot of that number; why it cannot be, or ""."""
    if not 1 <= robot_id <= HIGHEST_ID:
        return f"a robot's number is 1 to {HIGHEST_ID}"
    if len(simulation.robots) >= MAX_ROBOTS:
        return f"there are {len(simulation.robots)} robots already, the most there can be"
    first = simulation.robots[min(simulation.robots)]
    place = StartPoseAllocator(simulation).next(first.model.body.radius_in)
    if place is None:
        return f"no room around the starts of {simulation.world.name}, beside {len(simulation.robots)} robots"
    simulation.add_robot(robot_id, place, first.model, first.setup)
    return ""


def disconnect_robot(server: ServerState, context: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """The client is going; the session closes without an answer."""
    server.on_disconnect(context)
    return done()


def simulated_robot(_stage: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """Commands go to the simulation, as they always do here."""
    return done()


def real_robot(_stage: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """There is no real robot here."""
    return error_reply(NOT_AVAILABLE)


def quit_server(server: ServerState, _visit: ConnectionContext, _args: tuple[int, ...]) -> Reply:
    """End the server, where the setup allows it; this answer still comes."""
    if not server.allowed.quit:
        return error_reply(REFUSED)
    server.quitting = True
    return done()


def sim_control(server: ServerState, _visit: ConnectionContext, args: tuple[int, ...]) -> Reply:
    """Pause, resume, set the speed or step; the answer tells the time as it is then."""
    verb, value = args
    pace = server.clock
    if not server.allowed.control or (verb == SPEED and pace.lockstep_s is not None):
        return error_reply(REFUSED)
    if verb == STEP and 0 <= value <= LONGEST_STEP_MS:
        server.pass_time(value / 1000)
    elif verb == SPEED and (value == 0 or SLOWEST <= value / 10 <= FASTEST):
        pace.factor = value / 10 or None
    elif verb in (PAUSE, RESUME):
        pace.paused = verb == PAUSE
    else:
        return error_reply(BAD_VALUES)
    speed = 0 if pace.factor is None or pace.lockstep_s is not None else round(10 * pace.factor)
    return Reply("control", values=(1, server.clock_ms & _INT32_MAX, speed, int(pace.paused)))
