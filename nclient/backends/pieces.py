"""ws in pieces: a wait longer than one may be silent, asked again and again until the axes are still.

Rules: the answer is the last piece's, as if the whole had been asked at once; a piece lasts whole seconds.
"""

from __future__ import annotations

from collections.abc import Callable

from nclient.protocol.commands import Call
from nclient.protocol.replies import MOTOR_SLOT, Reply

_ARGUMENTS = 4


def is_wait(call: Call) -> bool:
    """Whether it is a ws that can be cut."""
    return call.name == "ws" and len(call.args) == _ARGUMENTS


def in_pieces(call: Call, longest_s: int, say: Callable[[Call], Reply]) -> Reply:
    """The answer to a ws, said in pieces of at most so many seconds: the axes named are still, or its time is over."""
    *flags, left = call.args
    while True:
        piece = max(0, min(left, longest_s))
        left -= piece
        reply = say(Call("ws", (*flags, piece)))
        motors = reply.slots.get(MOTOR_SLOT, 0)
        if left <= 0 or not any(flag and motors >> axis & 1 for axis, flag in enumerate(flags)):
            return reply
