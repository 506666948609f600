"""Commands to the server itself: who talks to which robot, whether it runs on, how its time goes. A function a command.

Rules: what the setup does not allow is ERROR 5. There is no real robot behind a simulation: real_robot is ERROR 4.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from nclient.protocol.replies import Reply
from nserver_emu.server.ground import done
from nserver_emu.server.pace import FASTEST, SLOWEST
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, REFUSED, Visit, error_reply
from nserver_emu.server.stage import Stage
from nserver_emu.simulation.simulation import Simulation
from worlds.world import StartPose

MOST_ROBOTS: Final = 100
"""Robots that clients can make; the next is refused."""

HIGHEST_ID: Final = 0x7FFF
LONGEST_STEP_MS: Final = 60_000
"""A longer step would keep the other clients waiting."""

PAUSE, RESUME, SPEED, STEP = 1, 2, 3, 4
_RINGS, _GAP_IN = 12, 1.0
_INT32_MAX = 0x7FFFFFFF


def connect_robot(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Tie the connection to a robot; port 0, and no change, where there is none of that number."""
    robot_id = args[0]
    known = robot_id in stage.simulation.robots
    visit.robot_id = robot_id if known else visit.robot_id
    if known:
        stage.drivers.adopt(visit, robot_id, stage.simulation.robots[robot_id])
    return Reply("simple", values=(stage.port if known else 0,))


def create_robot(stage: Stage, visit: Visit, args: tuple[int, ...]) -> Reply:
    """Make a robot of that number, like the first one and beside the others; one that is there is connected to.

    Port 0 where it cannot be: no id, too many robots, or nowhere room for it.
    """
    simulation, robot_id = stage.simulation, args[0]
    if robot_id not in simulation.robots and 1 <= robot_id <= HIGHEST_ID and len(simulation.robots) < MOST_ROBOTS:
        first = simulation.robots[min(simulation.robots)]
        place = free_place(simulation, first.model.body.radius_in)
        if place is not None:
            simulation.add_robot(robot_id, place, first.model, first.setup)
    return connect_robot(stage, visit, args)


def disconnect_robot(stage: Stage, visit: Visit, _args: tuple[int, ...]) -> Reply:
    """The client is going; the session closes without an answer."""
    stage.leave(visit)
    return done()


def simulated_robot(_stage: Stage, _visit: Visit, _args: tuple[int, ...]) -> Reply:
    """Commands go to the simulation, as they always do here."""
    return done()


def real_robot(_stage: Stage, _visit: Visit, _args: tuple[int, ...]) -> Reply:
    """There is no real robot here."""
    return error_reply(NOT_AVAILABLE)


def quit_server(stage: Stage, _visit: Visit, _args: tuple[int, ...]) -> Reply:
    """End the server, where the setup allows it; this answer still comes."""
    if not stage.allowed.quit:
        return error_reply(REFUSED)
    stage.quitting = True
    return done()


def sim_control(stage: Stage, _visit: Visit, args: tuple[int, ...]) -> Reply:
    """Pause, resume, set the speed or step; the answer tells the time as it is then."""
    verb, value = args
    pace = stage.pace
    if not stage.allowed.control or (verb == SPEED and pace.lockstep_s is not None):
        return error_reply(REFUSED)
    if verb == STEP and 0 <= value <= LONGEST_STEP_MS:
        stage.pass_time(value / 1000)
    elif verb == SPEED and (value == 0 or SLOWEST <= value / 10 <= FASTEST):
        pace.factor = value / 10 or None
    elif verb in (PAUSE, RESUME):
        pace.paused = verb == PAUSE
    else:
        return error_reply(BAD_VALUES)
    speed = 0 if pace.factor is None or pace.lockstep_s is not None else round(10 * pace.factor)
    return Reply("control", values=(1, stage.clock_ms & _INT32_MAX, speed, int(pace.paused)))


def free_place(simulation: Simulation, radius_in: float) -> StartPose | None:
    """A start of the world, or a place around one, where a robot of this radius touches nothing and nobody."""
    discs = [robot.disc for robot in simulation.robots.values()]
    for place in _places(simulation, 2.0 * radius_in + _GAP_IN):
        apart = all(math.hypot(place.x_in - x, place.y_in - y) > radius_in + other for x, y, other in discs)
        if apart and simulation.world.clearance(place.x_in, place.y_in) > radius_in:
            return place
    return None


def _places(simulation: Simulation, spacing_in: float) -> Iterator[StartPose]:
    """The starts, then rings of places around each."""
    yield from simulation.world.starts
    for ring in range(1, _RINGS + 1):
        for start in simulation.world.starts:
            for number in range(6 * ring):
                angle = math.tau * number / (6 * ring)
                x = start.x_in + ring * spacing_in * math.cos(angle)
                y = start.y_in + ring * spacing_in * math.sin(angle)
                yield StartPose(x, y, start.steering_rad, start.turret_rad)
