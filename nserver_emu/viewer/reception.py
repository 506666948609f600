"""Who comes to the page's port, before there is a request: no more than pages want, and nobody who asks nothing.

    socket ──> Doorkeeper ──> aiohttp's handler ──> a request, heard     or closed: at once where there are too many,
                                                                         after --limit-stall where none came

Rules: a connection is a descriptor, and those are what clients come in by too: whoever opens many here, and says
nothing, takes none of theirs. Who may ask what is web.py's.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Collection
from typing import Final

from aiohttp import web
from aiohttp.http import HttpProcessingError

from nserver_emu.server.admission.door import Door, Doorkeeper

HTTP_LOG: Final = logging.getLogger("nserver_emu.viewer.http")
"""Where aiohttp says what went wrong with a request."""


class Reception:
    """See the head of this file. `server`: aiohttp's, which makes a handler for each connection."""

    def __init__(self, door: Door, server: web.Server) -> None:
        self._door, self._server = door, server
        self._silent: set[asyncio.BaseProtocol] = set()

    def keeper(self) -> Doorkeeper:
        """The protocol of a newcomer's socket."""
        return Doorkeeper(self, self._hosts, self._receive)

    def heard(self, request: web.Request) -> None:
        """Whose request this is has asked something."""
        self._silent.discard(request.protocol)

    def refusal(self, host: str, present: Collection[str], at: str = "") -> str:
        """Why a newcomer may not come in; empty: he may. By the address he is asked with his request, in words."""
        del at
        limits = self._door.limits
        if len(present) >= limits.page_connections:
            return f"there are {len(present)} connections to the page already (--limit-viewers)"
        if sum(one == host for one in present) >= limits.per_address:
            return f"there are {limits.per_address} connections to the page from there already (--limit-per-address)"
        return ""

    def turn_away(self, host: str, reason: str) -> None:
        """He was not let in."""
        self._door.turn_away(host, reason)

    def worth_saying(self, record: logging.LogRecord) -> bool:
        """A filter of HTTP_LOG: what is no HTTP is one more who was turned away, and no fault with a traceback."""
        error = record.exc_info[1] if record.exc_info else None
        if isinstance(error, HttpProcessingError):
            host, *_ = record.args if isinstance(record.args, tuple) else ("somebody",)
            self.turn_away(str(host), "what it says at the page's port is no HTTP")
        return not isinstance(error, HttpProcessingError)

    def _hosts(self) -> list[str]:
        peers = [handler.transport and handler.transport.get_extra_info("peername")
                 for handler in self._server.connections]  # fmt: skip
        return [peer[0] if peer else "" for peer in peers]

    def _receive(self) -> asyncio.BaseProtocol:
        handler = self._server()
        if self._door.limits.stall:
            self._silent.add(handler)
            asyncio.get_running_loop().call_later(self._door.limits.stall, self._look_at, handler)
        return handler

    def _look_at(self, handler: web.RequestHandler) -> None:
        if handler in self._silent:
            self._silent.discard(handler)
            handler.force_close()
