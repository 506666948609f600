"""Nserver's clients on real robots: an emulator, with a real side for some of its robots.

    call ──> real_robot, simulated_robot: which side of the connection's robot is driven, by all connected to it
         ──> world, window, server, robots without a real side: the simulation, as ever
         ──> everything else: the real side

Rules: no thread, no socket, no clock but the one handed in with the sides. A switch is refused (ERROR 5) while another
connection owns the robot; the side that is left stands still.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from functools import partial

from nclient.backends.backend import Backend
from nclient.errors import AddressError
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.gateway.following import Follower, Simulated
from nserver_emu.gateway.side import RealSide
from nserver_emu.gateway.translate import stays_here
from nserver_emu.server.conversation.session import REFUSED, Later, Visit, error_reply
from nserver_emu.server.handling.ground import done
from nserver_emu.server.handling.handlers import Emulator
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

Around = Callable[[Backend], Backend]
"""What is put around a backend."""
REAL, SIMULATED = "real_robot", "simulated_robot"


class Gateway:
    """`sides`: the real ones, by the numbers of their robots; `shadow`: whether the simulated ones follow them, with
    `around` put around them as backends.

    Raises AddressError where the simulated robot of a number is of another model than the real one.
    """

    def __init__(
        self, emulator: Emulator, sides: Mapping[int, RealSide], *, shadow: bool = False, around: Around = lambda it: it
    ) -> None:
        self.sides = sides
        self._emulator = emulator
        for robot_id, side in sides.items():
            simulated, link = partial(self._simulated, robot_id), side.robot.link
            if simulated().model.family != link.model.name:
                raise AddressError(f"robot {robot_id} is a {simulated().model.family} in the simulation and really a "
                                   f"{link.model.name}; model= in the address and --robot must say the same")
            if shadow:
                following = around(Simulated(emulator.answer, robot_id, link.model))
                side.follower = Follower(following, simulated, link)
                side.refresh()

    def answer(self, call: Call, visit: Visit) -> Reply | Later:
        """The reply to a call, or a promise of it: from the real robot, where the connection's robot is one."""
        side = None if visit.robot_id is None else self.sides.get(visit.robot_id)
        if side is None:
            return self._emulator.answer(call, visit)
        if call.name in (REAL, SIMULATED):
            return self._switch(side, visit, to_real=call.name == REAL)
        if not side.active or stays_here(call.name):
            return self._emulator.answer(call, visit)
        meant = self._emulator.holds.meant(call, visit.robot_id)
        return error_reply(REFUSED) if meant is None else side.answer(meant, visit)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot, the real one too where it is driven, and let nobody move it until it is released."""
        self._emulator.hold(robot_id, by)
        side = self.sides.get(robot_id)
        if side is not None and side.active:
            side.stop()

    def leave(self, visit: Visit) -> None:
        """A connection is gone: what it drove stops, on either side."""
        self._emulator.leave(visit)
        for side in self.sides.values():
            side.leave(visit)

    def tick(self) -> None:
        """Time has passed."""
        for side in self.sides.values():
            side.tick()

    def _switch(self, side: RealSide, visit: Visit, *, to_real: bool) -> Reply:
        assert visit.robot_id is not None
        if not side.ownership.is_free_for(visit):
            return error_reply(REFUSED)
        if side.active != to_real:
            log.warning("robot %d is the %s one from now on", visit.robot_id, "real" if to_real else "simulated")
            if to_real:
                self._simulated(visit.robot_id).stop()
                self._emulator.look_anew()
            else:
                side.let_go()
            side.active = to_real
        return done()

    def _simulated(self, robot_id: int) -> SimulatedRobot:
        return self._emulator.simulation.robots[robot_id]
