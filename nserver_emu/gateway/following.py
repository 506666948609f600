"""The simulation in the shadow of a real robot: it does what the robot did, and is compared with it.

    what the robot carried out ──> the same calls to the simulation ──> its State beside the robot's ──> Shadow

To the calls it is a backend as the robot is, so that what is put around the one (speed caps) goes around the other.
Rules: no clock and no thread; whoever calls decides when. The simulation's encoders begin where the robot's are; where
the simulated robot stands in the map is where it was started.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from nclient.backends.backend import Backend
from nclient.errors import RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.models import Model
from nclient.protocol.replies import Reply
from nclient.protocol.terms import tcp_terms
from nclient.protocol.units import rad_from_tenths
from nserver_emu.gateway.robot_state import Link, whole_state
from nserver_emu.gateway.shadow import Shadow
from nserver_emu.server.conversation.session import Answer, Visit
from nserver_emu.server.stage.state_reply import state_slots
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

_POSE = slice(34, 38)
_SPEED = 0


class Simulated:
    """A simulated robot as a backend. An answer that only time can bring is none: nobody waits for it."""

    greeting: Reply | None = None
    port = 1
    closed = False
    link = None

    def __init__(self, simulate: Answer, robot_id: int, model: Model) -> None:
        self.terms = tcp_terms(model)
        self._simulate = simulate
        self._visit = Visit(self.terms, robot_id)

    def execute(self, call: Call) -> Reply:
        """What the simulation answers. Raises RobotRefused."""
        answer = self._simulate(call, self._visit)
        if not isinstance(answer, Reply):
            return Reply("none")
        if answer.kind == "error":
            raise RobotRefused(call.name, answer.values[0])
        return answer

    def close(self) -> None:
        """Nothing is to be let go."""


class Follower:
    """`simulated`: the robot that follows, as a backend and as it is; `link` is how the real one is reached."""

    def __init__(self, simulated: Backend, robot: Callable[[], SimulatedRobot], link: Link) -> None:
        self.shadow = Shadow(link.model)
        self._simulated = simulated
        self._robot = robot
        self._link = link
        self._aligned = False

    def follow(self, calls: Iterable[Call], state: Reply | None) -> None:
        """Do what the robot did; `state` is what it said then, if it said anything."""
        for call in calls:
            try:
                self._simulated.execute(call)
            except RobotRefused as error:
                log.warning("shadow: %s%s in the simulation: %s", call.name, call.args, error)
        if state is None:
            return
        real = whole_state(state, self._link)
        if not self._aligned:
            self._align(real)
        self.shadow.compare(real, state_slots(self._robot(), _SPEED))

    def _align(self, real: list[int]) -> None:
        x, y, steering, turret = real[_POSE]
        self._robot().define_position(x / 10, y / 10)
        self._robot().define_angles(rad_from_tenths(steering), rad_from_tenths(turret))
        self._aligned = True
