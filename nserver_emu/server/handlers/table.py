"""The table of command handlers, and the emulator that dispatches calls to it.

    HANDLERS   command name -> function(server, context, args) -> Reply or DeferredReply
    modules    motion.py | sensors.py | world.py (obstacles, poses) | graphics.py (window, speech, arm) | server.py

To add a command: a row in `nclient/protocol/commands.py`, and a function with the command's name, listed in HANDLERS. A
command without a handler gets ERROR 4.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.context import ServerState
from nserver_emu.server.handlers import graphics, motion, sensors, server, world
from nserver_emu.server.session import NOT_AVAILABLE, REFUSED, ConnectionContext, DeferredReply, error_reply

Handler = Callable[[ServerState, ConnectionContext, tuple[Any, ...]], "Reply | DeferredReply"]


class Emulator(ServerState):
    """A simulation behind the protocol: sessions call `answer`."""

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Execute a call and return its reply, ERROR 4 if there is no handler."""
        # 1. In lockstep, time advances before the call, so that the reply shows the result.
        if self.clock.step_per_request_s and call.name not in TIMELESS:
            self.pass_time(self.clock.step_per_request_s)
        # 2. Any command but those restarts the command timeout of the robot.
        if context.robot_id is not None and call.name not in TIMELESS:
            self.feed_watchdog(context)
        if call.name not in QUERIES:
            self.invalidate_state_cache()
        # 3. Under emergency stop, motions become st or are refused.
        effective = self.estop.effective_call(call, context.robot_id)
        answer = error_reply(REFUSED) if effective is None else self._execute(effective, context)
        # 4. These replies contain State slots: they count as sent for slots that the mask excludes.
        if call.name in STATE_QUERIES and isinstance(answer, Reply):
            context.update_last_sent(answer.slots)
        return answer if isinstance(answer, Reply) else self.defer(context, answer)

    def _execute(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        handler = HANDLERS.get(call.name)
        return handler(self, context, call.args) if handler else error_reply(NOT_AVAILABLE)


# Commands that do not change the robot.
QUERIES = frozenset({"gs", "ct", "get_sn", "get_rc", "get_rv", "get_ra", "get_bp", "get_rpx", "sim_truth",
    "get_ir", "get_cp", "get_ls", "get_sg"})  # fmt: skip

# Queries whose replies contain State slots.
STATE_QUERIES = frozenset({"get_ir", "get_sn", "get_rc", "get_rv", "get_cp", "get_bp"})

# Commands that take no time in lockstep and do not restart the command timeout: observers must not keep a robot moving.
TIMELESS = frozenset({"connect_robot", "create_robot", "disconnect_robot", "sim_truth", "sim_control"})

HANDLERS: dict[str, Handler] = {
    handler.__name__: handler
    for handler in (
        server.connect_robot, server.create_robot, server.disconnect_robot, server.real_robot,
        server.simulated_robot, server.quit_server, server.sim_control,
        motion.vm, motion.pr, motion.pa, motion.mv, motion.sp, motion.ac, motion.st, motion.lp, motion.ws, motion.zr,
        motion.dp, motion.da, motion.conf_tm,
        sensors.ct, sensors.gs, sensors.conf_sn, sensors.conf_ser, sensors.get_sn, sensors.get_rc,
        sensors.get_rv, sensors.get_ra, sensors.get_bp, sensors.sim_truth,
        sensors.conf_ir, sensors.get_ir, sensors.conf_cp, sensors.get_cp, sensors.conf_ls, sensors.get_ls,
        sensors.conf_sg, sensors.get_sg,
        world.place_robot, world.add_obstacle, world.delete_obstacle, world.move_obstacle, world.new_world,
        world.get_rpx, world.get_robot_conf, world.predict_sensors, world.motion_check,
        graphics.draw_robot, graphics.draw_line, graphics.draw_arc,
        graphics.tk, graphics.special_request, graphics.arm_mv, graphics.arm_zr, graphics.arm_ws,
    )
}  # fmt: skip
HANDLERS.update(graphics.REFRESHERS)
