"""The handlers of all commands, and the emulator that has them.

    modules    motion.py | sensors.py | world.py (obstacles, poses) | graphics.py (window, speech, arm) | server.py

A handler is a function(server, context, args) with the name of its command; it returns a Reply, a DeferredReply, or
None for the state. To add a command: a row in `nclient/protocol/commands.py`, and its function. A command without a
handler gets ERROR 4.
"""

from __future__ import annotations

from nclient.protocol.commands import BY_NAME
from nserver_emu.server.handlers import graphics, motion, sensors, server, world
from nserver_emu.server.server_state import Handler, ServerState

HANDLERS: dict[str, Handler] = {
    name: handler
    for module in (motion, sensors, world, graphics, server)
    for name, handler in vars(module).items()
    if name in BY_NAME
} | graphics.REFRESHERS


class Emulator(ServerState):
    """A simulation behind the protocol."""

    handlers = HANDLERS
    preparations = {"predict_sensors": world.prepare_prediction}  # noqa: RUF012
