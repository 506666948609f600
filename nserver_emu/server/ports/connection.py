"""One client's socket and the session behind it: an Nserver's client here, a robot's own line in lines.py."""

from __future__ import annotations

import asyncio
import logging
import socket
import weakref
from collections.abc import Callable
from typing import TYPE_CHECKING, cast

from nclient.faults.language import Language, TcpLanguage
from nclient.protocol.models import N150
from nclient.recording.follower import TCP
from nserver_emu.server.admission.allowance import Allowance
from nserver_emu.server.admission.patience import Patience
from nserver_emu.server.conversation.acquaintances import FORGOTTEN_AFTER_S
from nserver_emu.server.conversation.session import Acquaintance, Host, Session
from nserver_emu.server.ports.talker import READ_SIZE, REQUESTS_A_TURN, Talker

if TYPE_CHECKING:
    from nserver_emu.server.ports.daemon import Daemon

log = logging.getLogger(__name__)


class Connection(Talker, asyncio.BufferedProtocol):
    """A client's socket."""

    line = "nserver"

    def __init__(self, daemon: Daemon) -> None:
        super().__init__(daemon)
        self._behind: Host = daemon.host
        self._inbox = bytearray(READ_SIZE)
        self._met: Acquaintance | None = None
        limits, now_s = daemon.door.limits, self._loop.time()
        self._allowance = Allowance(limits.rate, REQUESTS_A_TURN, now_s) if limits.rate else None
        self._patience = Patience(limits.idle, limits.stall, now_s)
        self._look: asyncio.TimerHandle | None = None
        self._closed_by_us = False
        self.host = ""
        """The address that it came from."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        peer = transport.get_extra_info("peername")
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        self.host = peer[0] if peer else ""
        self._transport.set_write_buffer_limits(high=self._daemon.door.limits.write_queue)
        self._meet(f"{peer[0]}:{peer[1]}" if peer else "client")
        self._daemon.connections.add(self)
        self._daemon.acquaintances.arrive(self, self.host)
        self._look_later()
        log.info("%s: connected", self.session.name)

    def connection_lost(self, exc: Exception | None) -> None:
        self._silence()
        if self._look is not None:
            self._look.cancel()
        self._daemon.connections.discard(self)
        if self.session.closing:
            self._daemon.acquaintances.leave(self, disconnected=True)
        else:
            self._loop.call_later(FORGOTTEN_AFTER_S, self._daemon.acquaintances.leave, self)
        if not self._closed_by_us and (exc or self.session.unfinished):
            log.warning("%s: vanished%s%s", self.session.name, " in mid-request" if self.session.unfinished else "",
                        f": {exc}" if exc else "")
        self._behind.leave(self.session.visit)
        self._daemon.gone_answered += self.session.answered
        self._daemon.gone_refused += self.session.refused
        self._tape.close()
        self.session.closing = True
        log.info("%s: gone after %d refusals", self.session.name, self.session.refused)

    def get_buffer(self, sizehint: int) -> bytearray:
        del sizehint
        return self._inbox

    def buffer_updated(self, nbytes: int) -> None:
        self._patience.heard(self._loop.time())
        self._came(bytes(self._inbox[:nbytes]))

    def pause_writing(self) -> None:
        self.blocked = True
        self._pace()

    def resume_writing(self) -> None:
        self.blocked = False
        self._answer()

    def close(self) -> None:
        self._transport.close()

    def _look_later(self) -> None:
        look_s = self._patience.look_s
        self._look = None if look_s is None else self._loop.call_later(look_s, self._look_at)

    def _look_at(self) -> None:
        """Whether this one is still to be put up with."""
        now_s, waiting = self._loop.time(), self.session.waiting
        if waiting:
            self._patience.heard(now_s)
        stuck = self.blocked or (bool(self.session.unfinished) and not waiting)
        reason = self._patience.overdue(now_s, self.session.answered, stuck)
        if not reason:
            self._look_later()
            return
        log.warning("%s: closed: %s", self.session.name, reason)
        self._closed_by_us = True
        self._abort()

    def _meet(self, name: str) -> None:
        """Begin the conversation."""
        # A session that held its connection would keep both until Python looks for garbage, seldom (garbage.py).
        asks = weakref.WeakMethod(self._met_before)
        self.session = Session(
            self._behind.answer, name, lambda wide: ask(wide) if (ask := asks()) else None,
            self._daemon.emulator.allowed.frame,
        )
        self._tape = self._daemon.recorder.open(name, TCP, N150)

    def _met_before(self, wide: bool | None) -> Acquaintance | None:
        return self._daemon.acquaintances.find(self, self.host, wide)

    def _guarded(self, speak: Callable[[], bytes], by_time: bool = False) -> None:
        super()._guarded(speak, by_time)
        if self.session.met != self._met:
            self._met = self.session.met
            self._daemon.acquaintances.note(self, self.host, self._met)

    def _language(self) -> Language:
        return TcpLanguage(None if self.session.met is None else self.session.met.wide)

    def _send(self, data: bytes) -> None:
        self._transport.write(data)

    def _listen(self, on: bool) -> None:
        if self._transport.is_closing():
            return
        if on:
            self._transport.resume_reading()
        else:
            self._transport.pause_reading()

    def _hang_up(self) -> None:
        self._transport.close()

    def _abort(self) -> None:
        self._transport.abort()
