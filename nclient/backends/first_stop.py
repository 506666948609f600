"""st as the very first bytes of a conversation on a robot's line: before its hello, its mask, or anything else.

    open ──> st ──> a frame of st's type with a good checksum, whatever it holds ──> hello, ct, gs ...

Rules: the bytes of st are the same for every model and mask, and so is the type of its answer: a robot that cannot be
understood can still be stopped. Nothing is known of the robot here, and nothing is learned but what the frame holds.
"""

from __future__ import annotations

from collections.abc import Callable

from nclient.backends.line import Line
from nclient.backends.statistics import LinkStatistics
from nclient.errors import ReplyTimeout
from nclient.protocol import language
from nclient.protocol.commands import NAK_TYPE, Call
from nclient.protocol.models import N150
from nclient.protocol.serial_frame import SerialFrame
from nclient.protocol.terms import line_terms
from nclient.transports.byte_stream import ByteStream

ATTEMPTS = 3
"""How often st is said before the conversation is given up for a new one."""


def say_stop(
    stream: ByteStream, patience_s: float, clock: Callable[[], float], told: Callable[[], object]
) -> SerialFrame:
    """The frame that answers st; `told` is called for each st said. Raises ReplyTimeout, ConnectionLost."""
    line_type = language.row_named("st").line_type
    assert line_type is not None
    request = language.line_request(Call("st"), line_terms(N150))
    for _ in range(ATTEMPTS):
        told()
        line = Line(stream, LinkStatistics(), clock)  # a new one: the late answer to an earlier st is one to this
        try:
            frame = line.ask(line_type, request, patience_s)
        except ReplyTimeout:
            continue
        if frame.type != NAK_TYPE:
            return frame
    raise ReplyTimeout(f"st was not answered within {patience_s:g} s, {ATTEMPTS} times")
