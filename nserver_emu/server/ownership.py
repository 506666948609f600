"""Emergency stop of robots, and ownership of their axes.

Emergency stop: a stopped robot ignores motion commands until an operator releases it, in the viewer or with
`nserver ctl release`.

    motion command (vm, pr, pa, mv, zr, lp)    executed as st: the reply is the state, with velocities 0
    arm motion, user packet                    ERROR 5
    any other command                          executed as usual

It applies to all clients, like the emergency button on a robot. It is no part of a snapshot, but of a recording,
because it changes replies. Clients get no notification, so the log reports the first ignored motion command.

Axis ownership: the connection that last commanded an axis owns it while it moves. When the connection closes, its axes
stop; axes that other connections set in motion continue.
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
ALL_AXES: Final = (0, 1, 2)
# Commands to a stopped robot: executed as st, and refused. A user packet may move anything, so it is refused too.
_EXECUTED_AS_STOP: Final = (MOTIONS - ARM_MOTIONS) | {"lp"}
_REFUSED: Final = ARM_MOTIONS | {"special_request"}
# Modes of mv that move an axis or release it; 4 and 5 only set its limits.
_MV_MOTIONS: Final = (1, 2, 3)


def moves(call: Call) -> bool:
    """Return True if a call moves the robot; an mv does so if one of its modes moves or releases an axis."""
    if call.name == "mv":
        return any(mode in _MV_MOTIONS for mode in call.args[::2])
    return call.name in MOTIONS


@dataclass(slots=True)
class RobotHold:
    """The emergency stop of one robot."""

    # The operator who stopped it.
    by: str
    # Number of motion commands ignored since.
    ignored: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"by": self.by, "ignored": self.ignored}


class EStop:
    """The robots under emergency stop."""

    def __init__(self) -> None:
        self._holds: dict[int, RobotHold] = {}

    def engage(self, robot_id: int, by: str) -> None:
        """Stop a robot; a robot that is stopped already keeps its first operator."""
        self._holds.setdefault(robot_id, RobotHold(by))

    def release(self, robot_id: int) -> None:
        """Release a robot, stopped or not."""
        self._holds.pop(robot_id, None)

    def get(self, robot_id: int | None) -> RobotHold | None:
        """Return the emergency stop of a robot, None if it is not stopped."""
        return None if robot_id is None else self._holds.get(robot_id)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return all stopped robots as plain data."""
        return {str(robot_id): hold.as_dict() for robot_id, hold in self._holds.items()}

    def effective_call(self, call: Call, robot_id: int | None) -> Call | None:
        """Return the call to execute instead: the same, st for a motion of a stopped robot, None to refuse it."""
        hold = self._holds.get(robot_id) if self._holds and robot_id is not None else None
        if hold is None or call.name not in _EXECUTED_AS_STOP | _REFUSED:
            return call
        if call.name == "mv" and not moves(call):
            return call
        # A motion with all arguments 0 is a stop itself and not reported as ignored.
        is_motion = any(call.args) or not call.args
        hold.ignored += is_motion
        if is_motion and hold.ignored == 1:
            log.warning("robot %s: motion command %s ignored: emergency stop by %s; release in the viewer or with "
                        "nserver ctl release (further ones are counted)", robot_id, call.name, hold.by)  # fmt: skip
        return STOP if call.name in _EXECUTED_AS_STOP else None


class AxisOwnership:
    """The owner of each moving axis and arm, by robot."""

    def __init__(self) -> None:
        # Owner of each of the three axes; None for an axis without commands.
        self._owners: dict[int, list[ConnectionContext | None]] = {}
        self._arm_owners: dict[int, ConnectionContext] = {}
        # Robots of a restored simulation that no connection has claimed yet.
        self._unowned: set[int] = set()

    def claim(self, context: ConnectionContext, robot_id: int, axes: Iterable[int]) -> None:
        """Make a connection the owner of these axes."""
        owners = self._owners.setdefault(robot_id, [None] * len(ALL_AXES))
        for axis in axes:
            owners[axis] = context

    def claim_arm(self, context: ConnectionContext, robot_id: int) -> None:
        """Make a connection the owner of a robot's arm."""
        self._arm_owners[robot_id] = context

    def release_arms(self, context: ConnectionContext) -> list[int]:
        """End the ownership of arms by a closed connection; return the robots."""
        robot_ids = [robot_id for robot_id, owner in self._arm_owners.items() if owner is context]
        for robot_id in robot_ids:
            del self._arm_owners[robot_id]
        return robot_ids

    def release_all(self, robot_ids: Iterable[int]) -> None:
        """Remove all owners: these robots come from a snapshot, and their connections do not exist any more."""
        self._owners.clear()
        self._arm_owners.clear()
        self._unowned = set(robot_ids)

    def claim_unowned(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> None:
        """Give the axes that still move after a restore to the first connection to their robot."""
        if robot_id not in self._unowned:
            return
        self._unowned.discard(robot_id)
        self._arm_owners.setdefault(robot_id, context)
        owners = self._owners.get(robot_id, [None] * len(ALL_AXES))
        self.claim(context, robot_id, [axis for axis in ALL_AXES if robot.moving[axis] and owners[axis] is None])

    def may_feed_watchdog(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> bool:
        """Return True if a request of this connection restarts the robot's command timeout (conf_tm).

        It does if the connection owns a moving axis or the arm, or if there is no owner.
        """
        axis_owners = self._owners.get(robot_id, ())
        owners = [owner for owner, moves in zip(axis_owners, robot.moving, strict=False) if moves and owner is not None]
        if robot_id in self._arm_owners:
            owners.append(self._arm_owners[robot_id])
        return not owners or any(owner is context for owner in owners)

    def has_motion(self, context: ConnectionContext, robots: Mapping[int, SimulatedRobot]) -> bool:
        """Return True if closing this connection would stop an axis, or could stop an arm."""
        moving = (
            owner is context and moves
            for robot_id, owners in self._owners.items()
            for owner, moves in zip(owners, robots[robot_id].moving, strict=True)
        )
        return any(owner is context for owner in self._arm_owners.values()) or any(moving)

    def on_disconnect(self, context: ConnectionContext, robots: Mapping[int, SimulatedRobot]) -> None:
        """Stop the axes that a closed connection owns."""
        for robot_id, owners in self._owners.items():
            robot = robots[robot_id]
            for axis in (axis for axis in ALL_AXES if owners[axis] is context):
                owners[axis] = None
                if robot.moving[axis]:
                    robot.command_axis(axis, Command.VELOCITY, 0.0)
