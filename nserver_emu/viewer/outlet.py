"""What is said to one page: text frames of a websocket, written straight to its transport.

    takes(now) ──> say(text) ...        False: not now; stalled(now) says whether it is past hope

Rules: nobody waits. Whoever has not taken all that was said is told nothing new, so that what is thinned out is thinned
before it is sent; who has taken nothing of it for STALLED_S is given up. A frame is written in one piece, so pings and
the goodbye, which aiohttp writes to the same transport, stand between frames. aiohttp's own send_str would do, but it
may wait, which takes a task a page: that was more than half of what pages cost.
"""

from __future__ import annotations

import asyncio
from typing import Final

from aiohttp import web

STALLED_S: Final = 8.0
"""How long a page that says something, but takes nothing, is put up with."""
FINAL_TEXT: Final = 0x81
"""A text, whole in this frame, not compressed (RFC 6455, 5.2); what a server says has no mask (5.1)."""
SHORT, MEDIUM = 125, 0xFFFF
"""The longest payloads whose length stands in 7 and in 16 bits."""
TWO_BYTES, EIGHT_BYTES = 126, 127
"""In place of a length: so many bytes behind have it."""


class Outlet:
    """See the head of this file. `now`: real time in seconds."""

    def __init__(self, socket: web.WebSocketResponse, transport: asyncio.Transport, now: float) -> None:
        self._socket = socket
        self._transport = transport
        self._unsent = 0
        self._took_at = now

    def takes(self, now: float) -> bool:
        """Whether it has taken all that was said, and may be told more."""
        unsent = self._transport.get_write_buffer_size()
        if unsent < self._unsent or not self._unsent:
            self._took_at = now
        self._unsent = unsent
        return not unsent and not self._socket.closed and not self._transport.is_closing()

    def stalled(self, now: float) -> bool:
        """Whether it has taken nothing for so long, as far as `takes` saw, that it never will."""
        return self._unsent > 0 and now - self._took_at > STALLED_S

    def say(self, text: str) -> None:
        """Send a text, as one frame."""
        self._transport.write(frame(text))

    def hang_up(self) -> None:
        """Let go of it at once; closing would wait until it has taken all that was said."""
        self._transport.abort()


def frame(text: str) -> bytes:
    """A text as a server's websocket frame."""
    payload = text.encode()
    size = len(payload)
    if size <= SHORT:
        head = bytes((FINAL_TEXT, size))
    elif size <= MEDIUM:
        head = bytes((FINAL_TEXT, TWO_BYTES)) + size.to_bytes(2)
    else:
        head = bytes((FINAL_TEXT, EIGHT_BYTES)) + size.to_bytes(8)
    return head + payload
