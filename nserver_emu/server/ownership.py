"""Robots that somebody stopped for good: held, they stand until they are released, whatever a client says.

    what moves a robot    is taken for st: the answer is the state, as ever, and the velocities are 0
    what moves its arm    ERROR 5, as is a user packet, which may move anything
    all else              as ever: questions, settings, place_robot

Rules: as with the emergency button on a robot's head, it makes no difference who pressed it: he is held as well. It
belongs to the people who watch, not to the simulation: no snapshot has it. A recording does, for it changes answers.
No program is told, so the log says when the first motion came to nothing. Otherwise pure.

Who drives which axis of which robot, so that an axis stops when the one who set it going leaves.

Rules: a driver counts as long as the axis still moves by his command; who comes later takes the axis over. Nobody's
leaving touches what others have set going. Connections are told apart by what they are, not by number.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Final

from nclient.protocol.commands import Call
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation.axis import Command
from nserver_emu.simulation.robot import SimulatedRobot

log = logging.getLogger(__name__)

ARM_MOTIONS: Final = frozenset({"arm_zr", "arm_mv"})
MOTIONS: Final = frozenset({"vm", "pr", "pa", "mv", "zr"}) | ARM_MOTIONS
STOP: Final = Call("st", ())
_STOPPED: Final = (MOTIONS - ARM_MOTIONS) | {"lp"}
_REFUSED: Final = ARM_MOTIONS | {"special_request"}
_MV_MOTIONS: Final = (1, 2, 3)


def moves(call: Call) -> bool:
    """Whether this call moves the robot; an mv does where one of its modes moves an axis or lets it go."""
    if call.name == "mv":
        return any(mode in _MV_MOTIONS for mode in call.args[::2])
    return call.name in MOTIONS


@dataclass(slots=True)
class RobotHold:
    """One robot is held. `by`: who stopped it; `ignored`: how often it was told to move since."""

    by: str
    ignored: int = 0

    def told(self) -> dict[str, Any]:
        """The same as plain data."""
        return {"by": self.by, "ignored": self.ignored}


class EStop:
    """See the head of this file."""

    def __init__(self) -> None:
        self._holds: dict[int, RobotHold] = {}

    def put(self, robot_id: int, by: str) -> None:
        """A robot is held from now on; who stopped it first is told of."""
        self._holds.setdefault(robot_id, RobotHold(by))

    def release(self, robot_id: int) -> None:
        """It is held no more, if it was."""
        self._holds.pop(robot_id, None)

    def of(self, robot_id: int | None) -> RobotHold | None:
        """How a robot is held; None where it is not."""
        return None if robot_id is None else self._holds.get(robot_id)

    def told(self) -> dict[str, dict[str, Any]]:
        """Every robot that is held, as plain data."""
        return {str(robot_id): hold.told() for robot_id, hold in self._holds.items()}

    def effective_call(self, call: Call, robot_id: int | None) -> Call | None:
        """What is done in place of a call to this robot: the call itself, st, or None for a refusal."""
        hold = self.of(robot_id)
        if hold is None or call.name not in _STOPPED | _REFUSED:
            return call
        if call.name == "mv" and not moves(call):
            return call
        told_to_move = any(call.args) or not call.args
        hold.ignored += told_to_move
        if told_to_move and hold.ignored == 1:
            log.warning("robot %s is told to move (%s) and stands: it is held by %s until somebody releases it, at the "
                        "page or by nserver ctl release (further ones are counted)", robot_id, call.name, hold.by)
        return STOP if call.name in _STOPPED else None


ALL_AXES: Final = (0, 1, 2)


class AxisOwnership:
    """See the head of this file."""

    def __init__(self) -> None:
        self._drivers: dict[int, list[ConnectionContext | None]] = {}
        self._of_arm: dict[int, ConnectionContext] = {}
        self._orphans: set[int] = set()

    def take(self, context: ConnectionContext, robot_id: int, axes: Iterable[int]) -> None:
        """These axes of a robot obey this connection from now on."""
        drivers = self._drivers.setdefault(robot_id, [None] * len(ALL_AXES))
        for axis in axes:
            drivers[axis] = context

    def claim_arm(self, context: ConnectionContext, robot_id: int) -> None:
        """The arm of a robot obeys this connection from now on."""
        self._of_arm[robot_id] = context

    def release_arms(self, context: ConnectionContext) -> list[int]:
        """This connection is gone: the robots whose arms obeyed it."""
        robot_ids = [robot_id for robot_id, driver in self._of_arm.items() if driver is context]
        for robot_id in robot_ids:
            del self._of_arm[robot_id]
        return robot_ids

    def release_all(self, robot_ids: Iterable[int]) -> None:
        """These robots come from elsewhere, and whoever set them going is not here: nobody drives them."""
        self._drivers.clear()
        self._of_arm.clear()
        self._orphans = set(robot_ids)

    def claim_unowned(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> None:
        """The first to connect to such a robot answers for what still moves on its own."""
        if robot_id not in self._orphans:
            return
        self._orphans.discard(robot_id)
        self._of_arm.setdefault(robot_id, context)
        drivers = self._drivers.get(robot_id, [None] * len(ALL_AXES))
        self.take(context, robot_id, [axis for axis in ALL_AXES if robot.moving[axis] and drivers[axis] is None])

    def may_feed_watchdog(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> bool:
        """Whether the time-out of a robot begins anew at what this connection asks: it drives it, or nobody does."""
        drivers = self._drivers.get(robot_id, ())
        driving = [driver for driver, moves in zip(drivers, robot.moving, strict=False) if moves and driver is not None]
        if robot_id in self._of_arm:
            driving.append(self._of_arm[robot_id])
        return not driving or any(driver is context for driver in driving)

    def on_disconnect(self, context: ConnectionContext, robots: Mapping[int, SimulatedRobot]) -> None:
        """This connection is gone: what still moves because of it brakes and holds."""
        for robot_id, drivers in self._drivers.items():
            robot = robots[robot_id]
            for axis in (axis for axis in ALL_AXES if drivers[axis] is context):
                drivers[axis] = None
                if robot.moving[axis]:
                    robot.command_axis(axis, Command.VELOCITY, 0.0)
