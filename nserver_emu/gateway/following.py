"""The simulation in the shadow of a real robot: it does what the robot did, and is compared with it.

    what the robot carried out ──> the same calls to the simulation ──> its State beside the robot's ──> Shadow

Rules: no clock and no thread; whoever calls decides when. The simulation's encoders begin where the robot's are; where
the simulated robot stands in the map is where it was started.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.terms import tcp_terms
from nclient.protocol.units import rad_from_tenths
from nserver_emu.gateway.robot_state import Link, whole_state
from nserver_emu.gateway.shadow import Shadow
from nserver_emu.server.session import Answer, Visit
from nserver_emu.server.state_reply import state_slots
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

_POSE = slice(34, 38)
_SPEED = 0


class Follower:
    """`simulate` answers a call as a simulation does, for `robot`; `link` is how the real one is reached."""

    def __init__(self, simulate: Answer, robot: Callable[[], SimulatedRobot], robot_id: int, link: Link) -> None:
        self.shadow = Shadow(link.model)
        self._simulate = simulate
        self._robot = robot
        self._link = link
        self._visit = Visit(tcp_terms(link.model), robot_id)
        self._aligned = False

    def follow(self, calls: Iterable[Call], state: Reply | None) -> None:
        """Do what the robot did; `state` is what it said then, if it said anything."""
        for call in calls:
            answer = self._simulate(call, self._visit)
            if isinstance(answer, Reply) and answer.kind == "error":
                log.warning("shadow: the simulation refused %s%s: error %d", call.name, call.args, answer.values[0])
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
