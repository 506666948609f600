"""HTTP port with limits, and websockets that are sent to and read without waiting: for the page and for rosbridge.

Connections are limited before HTTP is parsed (auth.py). A client that receives too slowly skips pictures; the messages
of clients are handled in turns that all connections of the daemon share.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus
from typing import Final

from aiohttp import WSCloseCode, web

from nclient.common.allowlist import NOT_ALLOWED
from nclient.errors import ConnectionLost
from nserver_emu.server.admission import AdmissionControl, listen
from nserver_emu.server.connection import FairScheduler, TokenBucket
from nserver_emu.viewer import auth

Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

PERIOD_S: Final = 0.05
"""Twenty pictures a second."""
HEARTBEAT_S: Final = 6.0
"""Interval of pings; a page must answer within half of it."""
CONNECTION_LOST_S: Final = 10.0
"""Ping interval plus reply time-out, rounded up."""
CLOSING_S: Final = 0.5
"""Time-out of the closing handshake."""
STALLED_S: Final = 8.0
"""Time after which a page that receives nothing is disconnected."""
NO_LIMIT: Final = 2**31
"""Write buffer limit of a page's transport in bytes: sending never waits, and PageWriter does the flow control."""


class PageWriter:
    """Sends text messages to one page, without waiting.

    A page gets nothing new before it has received everything sent so far, so that pictures are skipped before they are
    sent. So the transport's write buffer never holds more than one round of messages, and its limit, at which aiohttp
    would wait, is switched off. `now` is real time in seconds.
    """

    def __init__(self, socket: web.WebSocketResponse, transport: asyncio.Transport, now: float) -> None:
        self._socket = socket
        self._transport = transport
        self._unsent = 0
        self._last_progress_s = now
        transport.set_write_buffer_limits(high=NO_LIMIT)

    def is_ready(self, now: float) -> bool:
        """Return True if the page has received everything and more can be sent."""
        # Progress is a shrinking buffer; an empty one has nothing to wait for.
        unsent = self._transport.get_write_buffer_size()
        if unsent < self._unsent or not self._unsent:
            self._last_progress_s = now
        self._unsent = unsent
        return not unsent and not self._socket.closed and not self._transport.is_closing()

    def is_stalled(self, now: float) -> bool:
        """Return True if the page has received nothing for STALLED_S, as far as `is_ready` observed."""
        return self._unsent > 0 and now - self._last_progress_s > STALLED_S

    async def send(self, text: str) -> None:
        """Send a text message."""
        await self._socket.send_str(text)

    def abort(self) -> None:
        """Disconnect at once; closing would wait until everything is received."""
        self._transport.abort()


class PageMessages:
    """Handles the messages of one page in turns of the event loop that connections share (a `Job`).

    `rate` is the limit of messages per second, 0 for none.
    """

    def __init__(self, scheduler: FairScheduler, handle: Callable[[str], None], rate: int) -> None:
        self.is_queued = False
        self.finish_tag_s = self.cpu_s = 0.0
        self._scheduler = scheduler
        self._handle = handle
        self._limit = TokenBucket(rate, 1, loop_time()) if rate else None
        self._text = ""
        self._done: asyncio.Future[None] | None = None

    async def handle(self, text: str) -> None:
        """Handle a message when its turn has come."""
        await wait_for_rate(self._limit)
        self._text, self._done = text, asyncio.get_running_loop().create_future()
        self._scheduler.submit(self)
        try:
            await self._done
        finally:
            self.is_queued = False

    def run_turn(self) -> None:
        """Handle the message, for the scheduler."""
        assert self._done is not None
        try:
            self._handle(self._text)
        finally:
            self._done.set_result(None)


async def wait_for_rate(limit: TokenBucket | None) -> None:
    """Take a token of a rate limit, and wait until it is there: in the order of the calls."""
    if limit is not None:
        limit.consume(1, loop_time())
        if wait_s := limit.wait_s(loop_time()):
            await asyncio.sleep(wait_s)


async def _run_clock(tick: Callable[[], Awaitable[None]]) -> None:
    due = loop_time()
    while True:
        due = next_due(due, loop_time())
        await asyncio.sleep(due - loop_time())
        await tick()


def next_due(due_s: float, now_s: float) -> float:
    """Return the time of the next picture, given the time at which the last one was due.

    One period after that one was due, so that the average rate is right; a longer delay is not made up for.
    """
    return max(due_s + PERIOD_S, now_s)


def loop_time() -> float:
    """Return the event loop's time in seconds."""
    return asyncio.get_running_loop().time()


class HttpPort:
    """A port that serves an application of aiohttp; connections are limited before HTTP is parsed.

    Parameters
    ----------
    door
        Permitted addresses and limits.
    title, option
        What is served, and the option that chooses the port, for errors.
    """

    def __init__(self, door: AdmissionControl, title: str, option: str) -> None:
        self.door, self._title, self._option = door, title, option
        self.runner: web.AppRunner | None = None
        self.admission: auth.HttpAdmission | None = None
        self._server: asyncio.Server | None = None
        self._sockets: set[web.WebSocketResponse] = set()
        self._clock: asyncio.Task[None] | None = None

    async def open(self, app: web.Application, host: str, port: int) -> int:
        """Start serving; return the port. Raises ConnectionLost if it cannot be used; the message names the remedy."""
        self.runner = web.AppRunner(app, access_log=None, logger=auth.HTTP_LOG, shutdown_timeout=1.0)
        await self.runner.setup()
        try:
            assert self.runner.server is not None
            self.admission = auth.HttpAdmission(self.door, self.runner.server)
            self._server = await listen(self.admission.protocol_factory, host, port)
        except OSError as error:
            await self.runner.cleanup()
            remedies = {errno.EADDRINUSE: f"{self._option} 0 takes a free port", errno.EACCES: "take a port above 1023"}
            remedy = remedies.get(error.errno or 0, "take an address of this machine")
            raise ConnectionLost(
                f"cannot serve {self._title} on {host}:{port}: {error.strerror or error}; {remedy}"
            ) from error
        auth.HTTP_LOG.addFilter(self.admission.keep_record)  # only if something is served: close() removes it
        return int(self._server.sockets[0].getsockname()[1])

    def start_clock(self, tick: Callable[[], Awaitable[None]]) -> None:
        """Call a function every PERIOD_S until `close`."""
        self._clock = asyncio.create_task(_run_clock(tick))

    @contextlib.asynccontextmanager
    async def websocket(
        self, request: web.Request, clients: str, max_bytes: int, *, is_limited: bool = True
    ) -> AsyncIterator[tuple[web.WebSocketResponse, PageWriter]]:
        """Accept a websocket, which counts towards --limit-viewers until the end of the block.

        Parameters
        ----------
        request
        clients
            Who there are too many of if the limit is reached, such as "clients".
        max_bytes
            Size of the largest message.
        is_limited
            False: accept it in any case.
        """
        if is_limited and len(self._sockets) >= self.door.limits.viewers:
            self.door.reject(request.remote or "", f"too many {clients} (--limit-viewers)")
            raise web.HTTPServiceUnavailable(text=f"too many {clients}: close one (--limit-viewers)\n")
        socket = web.WebSocketResponse(
            compress=False, heartbeat=HEARTBEAT_S, timeout=CLOSING_S, max_msg_size=max_bytes
        )
        self._sockets.add(socket)
        writer = None
        try:
            await socket.prepare(request)
            writer = PageWriter(socket, transport_of(request), loop_time())
            yield socket, writer
        finally:
            self._sockets.discard(socket)
            if writer and socket.close_code == WSCloseCode.ABNORMAL_CLOSURE:
                writer.abort()
            clear_tracebacks(socket.exception())

    async def close(self) -> None:
        """Stop serving: the clock, websockets, the port. May be called twice."""
        if self._clock is not None:
            self._clock.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._clock
            self._clock = None
        closing = [socket.close(code=WSCloseCode.GOING_AWAY, drain=False) for socket in self._sockets]
        await asyncio.gather(*closing, return_exceptions=True)
        if self._server is not None:
            self._server.close()
            self._server = None
        if self.admission is not None:
            auth.HTTP_LOG.removeFilter(self.admission.keep_record)
            self.admission = None
        if self.runner is not None:
            await self.runner.cleanup()
            self.runner = None

    @web.middleware
    async def admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Answer a request by its handler if its address is allowed, at the rate of its address."""
        host = request.remote or ""
        if self.admission is not None:
            self.admission.request_received(request)
            await wait_for_rate(self.admission.rate_limit(host, loop_time()))
        if not self.door.access.allows(host, local_address(request)):
            self.door.reject(host, NOT_ALLOWED)
            return web.Response(status=HTTPStatus.FORBIDDEN, text="this address is not allowed\n")
        try:
            return await handler(request)
        except web.HTTPException as refusal:  # aiohttp stores what is raised, with its traceback
            clear_tracebacks(refusal)
            return web.Response(status=refusal.status, headers=refusal.headers, body=refusal.body)


def transport_of(request: web.Request) -> asyncio.Transport:
    """Return the request's transport. Raises ConnectionResetError, which aiohttp ignores, if it is closed."""
    if request.transport is None:
        raise ConnectionResetError("closed before the request was answered")
    return request.transport


def clear_tracebacks(error: BaseException | None) -> None:
    """Drop the tracebacks of an error and its context: their frames would keep it alive until garbage collection."""
    while error is not None:
        error.__traceback__, error = None, error.__context__


def local_address(request: web.Request) -> str:
    """Return the local address of a request's connection."""
    own = request.transport and request.transport.get_extra_info("sockname")
    return str(own[0]) if own else ""
