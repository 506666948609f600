"""The one table of what the emulator does at each command, and the answer it gives a Session.

    HANDLERS    C name -> function(stage, visit, args) -> Reply, or a Later that gives one
    rooms       motion.py | questions.py | ground.py (the world) | window.py | packets.py | hosting.py (the server)

Rules: a command without a handler answers ERROR 4, never silence, never a wrong success. A handler's function has the
command's name. No handler lives here.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.context import ServerState
from nserver_emu.server.handlers import (
    graphics,
    motion,
    sensors,
    server,
    world,
)
from nserver_emu.server.session import NOT_AVAILABLE, REFUSED, ConnectionContext, DeferredReply, error_reply

Handler = Callable[[ServerState, ConnectionContext, tuple[Any, ...]], "Reply | DeferredReply"]


class Emulator(ServerState):
    """A simulation behind the protocol: its `answer` is what a Session is handed."""

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """The reply to a call, or a promise of it; ERROR 4 where there is nothing that could answer.

        In lockstep the simulated time moves first, so that the answer shows where it led.
        """
        if self.clock.asked_s and call.name not in TIMELESS:
            self.pass_time(self.clock.asked_s)
        if context.robot_id is not None and call.name not in TIMELESS:
            self.feed(context)
        if call.name not in QUESTIONS:
            self.invalidate_state_cache()
        meant = self.estop.effective_call(call, context.robot_id)
        answer = error_reply(REFUSED) if meant is None else self._done(meant, context)
        if call.name in SHOWN and isinstance(answer, Reply):
            context.keep(answer.slots)
        return answer if isinstance(answer, Reply) else self.promise(context, answer)

    def _done(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        handler = HANDLERS.get(call.name)
        return handler(self, context, call.args) if handler else error_reply(NOT_AVAILABLE)


QUESTIONS = frozenset({"gs", "ct", "get_sn", "get_rc", "get_rv", "get_ra", "get_bp", "get_rpx", "sim_truth",
    "get_ir", "get_cp", "get_ls", "get_sg"})  # fmt: skip
"""Commands that change nothing about a robot."""

SHOWN = frozenset({"get_ir", "get_sn", "get_rc", "get_rv", "get_cp", "get_bp"})
"""Questions whose answers put State's own numbers: they count as sent, for what the mask leaves out."""

TIMELESS = frozenset({"connect_robot", "create_robot", "disconnect_robot", "sim_truth", "sim_control"})
"""Commands that take no time where time moves with each exchange, and feed no time-out: who watches drives nothing."""

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
"""Every command the emulator has something to say to."""
HANDLERS.update(graphics.REFRESHERS)
