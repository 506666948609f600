"""Emergency stop: a stopped robot ignores motion commands until an operator releases it.

The viewer and `nserver ctl release` release it.

    motion command (vm, pr, pa, mv, zr, lp)    executed as st; the reply is ERROR 7 (HELD)
    the same with all values 0                 executed as st: the reply is the state
    arm motion, user packet                    not executed, ERROR 7; the readings of a simulated ring are sent
    ws and zr that wait at the moment of Stop  ERROR 7
    any other command                          executed as usual; word 44 of a state over TCP is 7

A robot's own line has no such errors: motions are answered there by the state with velocities 0, the arm by NAK.

It applies to all clients, like the emergency button on a robot. It is no part of a snapshot, but of a recording,
because it changes replies. Programs that ignore errors do not show it, so the log reports the first ignored motion.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from nclient.errors import HELD
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.session import REFUSED, ConnectionContext, DeferredReply, error_reply
from nserver_emu.simulation.axis import AXIS_MOTIONS, Command

log = logging.getLogger(__name__)

ARM_MOTIONS: Final = frozenset({"arm_zr", "arm_mv"})
MOTIONS: Final = frozenset({"vm", "pr", "pa", "mv", "zr"}) | ARM_MOTIONS
STOP: Final = Call("st", ())
# Commands to a stopped robot: executed as st, and refused. A user packet may move anything, so it is refused too.
_EXECUTED_AS_STOP: Final = (MOTIONS - ARM_MOTIONS) | {"lp"}
_REFUSED: Final = ARM_MOTIONS | {"special_request"}
# Calls whose reply may come later, when the robot stands: Stop ends them.
_WAITS: Final = MOTIONS | {"ws", "arm_ws"}


def _asks_for_motion(call: Call) -> bool:
    """Return False for a motion command with all speeds and distances 0, which is a stop itself."""
    if call.name == "mv":
        pairs = zip(call.args[::2], call.args[1::2], strict=True)
        return any(mode == Command.LIMP or (mode in AXIS_MOTIONS and value) for mode, value in pairs)
    return any(call.args) or not call.args


def moves(call: Call) -> bool:
    """Return True if a call moves the robot; an mv does so if one of its modes moves or releases an axis."""
    if call.name == "mv":
        return any(mode in AXIS_MOTIONS for mode in call.args[::2])
    return call.name in MOTIONS


@dataclass(slots=True)
class RobotHold:
    """The emergency stop of one robot."""

    # The operator who stopped it.
    by: str
    # Number of motion commands ignored since.
    ignored: int = 0
    # True where clients are not informed: in a recording made before there was ERROR 7.
    is_silent: bool = False
    # All who stopped it since: a student may not release what the teacher has stopped, too.
    operators: set[str] = field(default_factory=set)

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"by": self.by, "ignored": self.ignored}


class EStop:
    """The robots under emergency stop."""

    def __init__(self) -> None:
        # By robot.
        self.holds: dict[int, RobotHold] = {}

    def engage(self, robot_id: int, by: str, *, is_silent: bool = False) -> None:
        """Stop a robot; a robot that is stopped already is reported with its first operator."""
        self.holds.setdefault(robot_id, RobotHold(by, is_silent=is_silent)).operators.add(by)

    def release(self, robot_id: int) -> None:
        """Release a robot, stopped or not."""
        self.holds.pop(robot_id, None)

    def get(self, robot_id: int | None) -> RobotHold | None:
        """Return the emergency stop of a robot, None if it is not stopped."""
        return None if robot_id is None else self.holds.get(robot_id)

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return all stopped robots as plain data."""
        return {str(robot_id): hold.as_dict() for robot_id, hold in self.holds.items()}

    def execute(self, call: Call, context: ConnectionContext,
                run: Callable[[Call, ConnectionContext], Reply | DeferredReply]) -> Reply | DeferredReply:
        """Execute a call as far as the hold of its robot allows, and return the reply that informs the client.

        Parameters
        ----------
        run : executes a call.
        """
        hold = self.get(context.robot_id)
        context.is_held = hold is not None and not hold.is_silent
        if hold is None:
            return run(call, context)
        # 1. A motion is executed as st even if its reply is an error: a real robot's line may have lost the first st.
        effective = self.effective_call(call, context.robot_id)
        answer = error_reply(REFUSED) if effective is None else run(effective, context)
        # 2. A robot's own line has no such error.
        is_refused = effective is not call and (effective is None or _asks_for_motion(call))
        if not is_refused or not context.is_held or context.wire_state.line:
            return answer
        # 3. The st of a real robot takes time: a program that repeats its motion must not fill the queue with them.
        return error_reply(HELD) if isinstance(answer, Reply) else lambda: answer() and error_reply(HELD)

    def until_held(self, poll: DeferredReply, call: Call, context: ConnectionContext) -> DeferredReply:
        """Return a deferred reply that becomes an error when the robot that it waits for is stopped."""
        if call.name not in _WAITS or context.wire_state.line or context.is_held:
            return poll

        def poll_or_refuse() -> Reply | None:
            hold = self.get(context.robot_id)
            return poll() if hold is None or hold.is_silent else error_reply(HELD)

        return poll_or_refuse

    def effective_call(self, call: Call, robot_id: int | None) -> Call | None:
        """Return the call to execute instead: the same, st for a motion of a stopped robot, None to refuse it."""
        hold = self.get(robot_id)
        if hold is None or call.name not in _EXECUTED_AS_STOP | _REFUSED:
            return call
        if call.name == "mv" and not moves(call):
            return call
        is_motion = _asks_for_motion(call)
        hold.ignored += is_motion
        if is_motion and hold.ignored == 1:
            log.warning("robot %s: motion command %s ignored: emergency stop by %s; release in the viewer or with "
                        "nserver ctl release (further ones are counted)", robot_id, call.name, hold.by)  # fmt: skip
        return STOP if call.name in _EXECUTED_AS_STOP else None
