"""Emergency stop: a stopped robot ignores motion commands until an operator releases it.

The viewer and `nserver ctl release` release it.

    motion command (vm, pr, pa, mv, zr, lp)    executed as st: the reply is the state, with velocities 0
    arm motion, user packet                    ERROR 5
    any other command                          executed as usual

It applies to all clients, like the emergency button on a robot. It is no part of a snapshot, but of a recording,
because it changes replies. Clients get no notification, so the log reports the first ignored motion command.
"""

import logging
from dataclasses import dataclass
from typing import Any, Final

from nclient.protocol.commands import Call

log = logging.getLogger(__name__)

ARM_MOTIONS: Final = frozenset({"arm_zr", "arm_mv"})
MOTIONS: Final = frozenset({"vm", "pr", "pa", "mv", "zr"}) | ARM_MOTIONS
STOP: Final = Call("st", ())
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
        # By robot.
        self.holds: dict[int, RobotHold] = {}

    def engage(self, robot_id: int, by: str) -> None:
        """Stop a robot; a robot that is stopped already keeps its first operator."""
        self.holds.setdefault(robot_id, RobotHold(by))

    def release(self, robot_id: int) -> None:
        """Release a robot, stopped or not."""
        self.holds.pop(robot_id, None)

    def get(self, robot_id: int | None) -> RobotHold | None:
        """Return the emergency stop of a robot, None if it is not stopped."""
        return None if robot_id is None else self.holds.get(robot_id)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return all stopped robots as plain data."""
        return {str(robot_id): hold.as_dict() for robot_id, hold in self.holds.items()}

    def effective_call(self, call: Call, robot_id: int | None) -> Call | None:
        """Return the call to execute instead: the same, st for a motion of a stopped robot, None to refuse it."""
        hold = self.holds.get(robot_id) if self.holds and robot_id is not None else None
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
