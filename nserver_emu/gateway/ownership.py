"""Who may move a real robot: one connection at a time, and the others watch. No wire, no clock, no thread.

    questions, ct, ws, st    anybody, at any time
    motions                  the owner; where there is none, whoever moves the robot first becomes it
    all other changes        the owner; anybody while there is none

Rules: the owner gives the robot up by leaving, or by letting it go with lp. A robot to be read only is moved by nobody;
stopped by anybody all the same.
"""

from __future__ import annotations

from typing import Final

from nclient.protocol.commands import Call
from nserver_emu.server.conversation.session import Visit
from nserver_emu.server.stage.holds import MOTIONS, moves

_CHANGES: Final = MOTIONS | {
    "lp", "sp", "ac", "dp", "da", "place_robot", "tk", "special_request", "arm_ws",
    "conf_ir", "conf_sn", "conf_cp", "conf_ls", "conf_tm", "conf_sg", "conf_ser",
}  # fmt: skip


def changes(call: Call) -> bool:
    """Whether this call changes the robot. st does not count, nor does an mv that leaves all axes: programs ping so."""
    if call.name == "mv":
        return any(call.args[::2])
    return call.name in _CHANGES


class Ownership:
    """Whose one robot is. `owner` is None while it is nobody's."""

    def __init__(self, *, read_only: bool = False) -> None:
        self.read_only = read_only
        self.owner: Visit | None = None

    def allows(self, call: Call, visit: Visit) -> bool:
        """Whether this connection may say that now; a motion that may makes it the owner, lp makes nobody it."""
        if not changes(call):
            return True
        if self.read_only or not self.is_free_for(visit):
            return False
        if call.name == "lp":
            self.owner = None
        elif moves(call):
            self.owner = visit
        return True

    def is_free_for(self, visit: Visit) -> bool:
        """Whether nobody else owns the robot."""
        return self.owner is None or self.owner is visit
