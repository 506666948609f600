"""How far the numbers of a call may go on a robot's own line, where they have two bytes or one, and a sign or none.

Rules: read off the table's rows. Old programs send what they like, so the C mirror and the gateway bring it within
(PROTOCOL.md, section 3: out of range is clamped silently); everybody else is told which number, and how far it may go.
A call without such fields is left as it is; so is the time of ws, which goes in pieces.
"""

from __future__ import annotations

from functools import lru_cache

from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.line_fields import LINE_BYTE, LINE_SIGNED, LINE_UNSIGNED
from nclient.protocol.requests import HISTORY_BYTE, LASER_MODE_BYTE, Fields

BYTE_HIGHEST = 255
_SIGNED, _UNSIGNED, _BYTE = (-0x7FFF, 0x7FFF), (0, 0xFFFF), (0, BYTE_HIGHEST)
_RANGES = (
    (LINE_SIGNED, _SIGNED), (LINE_UNSIGNED, _UNSIGNED),
    (LINE_BYTE, _BYTE), (HISTORY_BYTE, _BYTE), (LASER_MODE_BYTE, _BYTE),
)  # fmt: skip
_FREE = (-(1 << 31), (1 << 31) - 1)
_NOT_NEGATIVE = (0, _FREE[1])


@lru_cache
def line_bounds(name: str) -> tuple[tuple[str, int, int], ...]:
    """Name, least and greatest of each number of a command, in order; () where it has no such numbers."""
    row = BY_NAME.get(name)
    if row is None or row.packet_type is not None or row.any_length or not isinstance(row.line_request, Fields):
        return ()
    bounds = []
    for argument in row.arguments:
        span = next((span for field, span in _RANGES if argument.line is field), _FREE)
        piecewise = (name, argument.name) == ("ws", "timeout_s")
        bounds.append((argument.name, *(_NOT_NEGATIVE if piecewise else span)))
    return tuple(bounds)


def within_line(call: Call) -> Call:
    """The call with each number brought to the nearest that the line can carry."""
    bounds = line_bounds(call.name)
    if len(bounds) != len(call.args) or not bounds:
        return call
    return Call(call.name, tuple(
        min(max(value, least), most) for value, (_, least, most) in zip(call.args, bounds, strict=True)
    ))


def beyond_line(call: Call) -> str:
    """Which number of a call the line cannot carry, how far it may go, and what to do; "" where all fit."""
    for value, (name, least, most) in zip(call.args, line_bounds(call.name), strict=False):
        if isinstance(value, int) and not least <= value <= most:
            return (
                f"{call.name}: {name} is {value}, and a robot's own line carries {least} to {most} "
                "(lengths in 1/10 inch, angles in 1/10 degree); stay within that, in several steps if need be"
            )
    return ""
