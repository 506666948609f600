"""What is said to one page: text frames of a websocket, written straight to its transport.

    takes(now) ──> say(text) ...        False: not now; stalled(now) says whether it is past hope

Rules: nobody waits. Whoever has not taken all that was said is told nothing new, so that what is thinned out is thinned
before it is sent; who has taken nothing of it for STALLED_S is given up. A frame is written in one piece, so pings and
the goodbye, which aiohttp writes to the same transport, stand between frames. aiohttp's own send_str would do, but it
may wait, which takes a task a page: that was more than half of what pages cost.

The page on the web: page and files over HTTP, pictures over a websocket, all from one asyncio loop with the daemon.

    GET /?token=T      the page              GET /page/NAME     its files (no secret in them)
    GET /              the page, of a tab that keeps its token to itself: a reload
    GET /ws?token=T    the websocket         POST /publish?token=T    what a localizer thinks (localization.py)
    GET /health, /metrics                    how the daemon does (numbers.py)

Rules: nothing of the simulation without the token (how the daemon does may be known from loopback), of which there are
two, to act and to look only (entrance.py). A websocket is opened by a page that came from here: its Origin must be the
Host asked. Nothing is loaded from elsewhere, by Content-Security-Policy too. A page that does not answer, or takes
nothing, is forgotten after FORGOTTEN_S at most.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus
from pathlib import Path
from typing import TYPE_CHECKING, Final

from aiohttp import WSCloseCode, WSMsgType, web

from nclient.common.allowlist import LOOPBACK_NAME, NOT_ALLOWED, is_loopback, is_this_machine
from nclient.errors import ConnectionLost
from nserver_emu.viewer.auth import HTTP_LOG, REFUSED, Reception, Tokens, address, from_here, known_host, new_tokens
from nserver_emu.viewer.controller import Desk
from nserver_emu.viewer.hub import Hub, Viewer
from nserver_emu.viewer.messages import MOST_TEXT, BadMessage, to_page
from nserver_emu.viewer.metrics import CONTENT_TYPE, health, metrics
from nserver_emu.viewer.scene import Album, Modes, laser_modes

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


Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

PAGE: Final = Path(__file__).with_name("page")
PERIOD_S: Final = 0.05
"""Twenty pictures a second."""
HEARTBEAT_S: Final = 6.0
"""How often a page is asked whether it is there; half as long it may take to answer."""
FORGOTTEN_S: Final = 10.0
"""Both of them, and the clock's coarseness."""
CLOSING_S: Final = 0.5
"""How long a page that is told to go may take to say goodbye."""
REMEDIES: Final = {errno.EADDRINUSE: "--viewer 0 takes a free port", errno.EACCES: "take a port above 1023"}
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}  # fmt: skip


class Viewing:
    """The page of one daemon. `token` lets act, `watch_token` look."""

    def __init__(self, daemon: Daemon, tokens: Tokens | None = None) -> None:
        self._tokens = tokens or new_tokens()
        self.token, self.watch_token = self._tokens
        self.hub = Hub(Album(daemon.emulator))
        self.desk = Desk(daemon, self.hub)
        self._outlets: dict[Viewer, Outlet] = {}
        self._sockets: set[web.WebSocketResponse] = set()
        self._known = LOOPBACK_NAME
        self._door = daemon.door
        self._daemon = daemon
        self._runner: web.AppRunner | None = None
        self._server: asyncio.Server | None = None
        self._reception: Reception | None = None
        self._clock: asyncio.Task[None] | None = None

    async def open(self, host: str, port: int) -> int:
        """Serve; the port it is on (port 0: a free one). Raises ConnectionLost, naming the remedy."""
        self._known = host.lower()
        app = web.Application(client_max_size=MOST_TEXT, middlewares=[self._at_the_door])
        app.on_response_prepare.append(_add_headers)
        app.router.add_get("/", self._page)
        app.router.add_get("/favicon.ico", _no_icon)
        app.router.add_get("/ws", self._socket)
        app.router.add_post("/publish", self._publish)
        app.router.add_get("/health", self._health)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_static("/page/", PAGE)
        self._runner = web.AppRunner(app, access_log=None, logger=HTTP_LOG, shutdown_timeout=1.0)
        await self._runner.setup()
        try:
            assert self._runner.server is not None
            self._reception = Reception(self._door, self._runner.server)
            loop = asyncio.get_running_loop()
            self._server = await loop.create_server(self._reception.keeper, host, port)
        except OSError as error:
            await self._runner.cleanup()
            remedy = REMEDIES.get(error.errno or 0, "take an address of this machine")
            raise ConnectionLost(
                f"cannot serve the page on {host}:{port}: {error.strerror or error}; {remedy}"
            ) from error
        HTTP_LOG.addFilter(self._reception.worth_saying)  # not where the page is not served: nobody would take it back
        self._clock = asyncio.create_task(self._run_clock())
        return int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """No page any more. Twice is fine."""
        if self._clock is not None:
            self._clock.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._clock
            self._clock = None
        going = [socket.close(code=WSCloseCode.GOING_AWAY, drain=False) for socket in self._sockets]
        await asyncio.gather(*going, return_exceptions=True)
        if self._server is not None:
            self._server.close()
            self._server = None
        if self._reception is not None:
            HTTP_LOG.removeFilter(self._reception.worth_saying)
            self._reception = None
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None
        self.desk.close()

    async def _run_clock(self) -> None:
        due = _now()
        while True:
            due = next_due(due, _now())
            await asyncio.sleep(due - _now())
            if self.hub.viewers:
                self._beat()

    def _beat(self) -> None:
        """A twentieth of a second has passed, for everybody, whatever goes wrong with one."""
        with self.desk.guard.over("the clock"):
            self.desk.tick(_now())
        with self.desk.guard.over("the picture"):
            self.hub.take(self._laser_modes())
        for viewer in tuple(self._outlets):
            self._tell(viewer)

    def _laser_modes(self) -> Modes:
        robots = self._daemon.emulator.simulation.robots
        return laser_modes(self._daemon.connections, [n for n, robot in robots.items() if robot.model.has_light_sensors])

    @web.middleware
    async def _at_the_door(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        if self._reception is not None:
            self._reception.heard(request)
        host = request.remote or ""
        if not self._door.access.admits(host, _our_end(request)):
            self._door.turn_away(host, NOT_ALLOWED)
            return web.Response(status=HTTPStatus.FORBIDDEN, text="this address is not let in\n")
        try:
            return await handler(request)
        except web.HTTPException as refusal:  # aiohttp keeps what is raised, and so where it was raised
            _forget_where(refusal)
            return web.Response(status=refusal.status, headers=refusal.headers, body=refusal.body)

    def _may(self, request: web.Request) -> bool:
        """Whether who asks may act; False: look only. Raises HTTPForbidden for who may neither."""
        self._check_host(request)
        may_act = self._tokens.may_act(request.query.get("token", ""))
        if may_act is None:
            raise web.HTTPForbidden(text="the token is wrong: take the whole address that nserver printed\n")
        return may_act

    def _check_host(self, request: web.Request) -> None:
        if not known_host(request.host, self._known):
            raise web.HTTPForbidden(text=f"this page is not known as {request.host!a}: ask by its number\n")

    async def _page(self, request: web.Request) -> web.StreamResponse:
        self._check_host(request)
        if "token" in request.query and self._tokens.may_act(request.query["token"]) is None:
            raise web.HTTPForbidden(text=REFUSED, content_type="text/html")
        return web.FileResponse(PAGE / "index.html")

    def _may_know(self, request: web.Request) -> None:
        """Raises HTTPForbidden for who may not know how the daemon does."""
        if not is_this_machine(request.remote or "", _our_end(request)) or not known_host(request.host, self._known):
            self._may(request)

    async def _health(self, request: web.Request) -> web.StreamResponse:
        self._may_know(request)
        well, told = health(self._daemon, _now())
        return web.json_response(told, status=HTTPStatus.OK if well else HTTPStatus.SERVICE_UNAVAILABLE)

    async def _metrics(self, request: web.Request) -> web.StreamResponse:
        self._may_know(request)
        text = metrics(self._daemon, len(self.hub.viewers), len(asyncio.all_tasks()))
        return web.Response(body=text.encode(), headers={"Content-Type": CONTENT_TYPE})

    async def _publish(self, request: web.Request) -> web.StreamResponse:
        if not self._may(request):
            raise web.HTTPForbidden(text="this token only looks\n")
        try:
            return web.json_response(self.desk.publish((await request.read()).decode(), _now()))
        except (BadMessage, UnicodeDecodeError) as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from None

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        may_act = self._may(request)
        origin = request.headers.get("Origin", "")
        if not from_here(origin, request.scheme, request.host):
            raise web.HTTPForbidden(text=f"a page from {ascii(origin) if origin else 'nowhere'} is none of ours\n")
        if len(self._sockets) >= self._door.limits.viewers:
            self._door.turn_away(request.remote or "", "as many pages are open as may be (--limit-viewers)")
            raise web.HTTPServiceUnavailable(text="as many pages are open as may be: close one (--limit-viewers)\n")
        socket = web.WebSocketResponse(compress=False, heartbeat=HEARTBEAT_S, timeout=CLOSING_S, max_msg_size=MOST_TEXT)
        self._sockets.add(socket)  # it counts from now on, not only once it is there
        try:
            await socket.prepare(request)
            outlet = Outlet(socket, _transport(request), _now())
        except BaseException:
            self._sockets.discard(socket)
            raise
        viewer = self.desk.arrive(_now(), may_act=may_act, watch_token=self.watch_token)
        self._outlets[viewer] = outlet
        viewer.ring = lambda: asyncio.get_running_loop().call_soon(self._tell, viewer)
        viewer.ring()
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    self.desk.hear(viewer, message.data, _now())
                elif message.type == WSMsgType.BINARY:
                    viewer.tell(to_page("answer", id=None, ok=False, error="a message is text, not bytes"))
                await asyncio.sleep(0)  # it is the others' turn, however much this one has to say
        finally:
            self._sockets.discard(socket)
            del self._outlets[viewer]
            self.desk.leave(viewer)
            if socket.close_code == WSCloseCode.ABNORMAL_CLOSURE:
                outlet.hang_up()
            _forget_where(socket.exception())
        return socket

    def _tell(self, viewer: Viewer) -> None:
        """What is new for a page, where it takes it; what comes before a fault is told all the same."""
        outlet, now = self._outlets.get(viewer), _now()
        if outlet is None:
            return
        if outlet.takes(now):
            with self.desk.guard.over("the news and the picture", viewer.name):
                for text in self.hub.next_for(viewer):
                    outlet.say(text)
        elif outlet.stalled(now):
            log.info("%s takes nothing: hung up", viewer.name)
            outlet.hang_up()


def next_due(due_s: float, now_s: float) -> float:
    """When the picture after the one that was due then is due: a period later, however late that one was, so that they
    are twenty a second on the whole; what a whole period was not enough for is not made up for."""
    return max(due_s + PERIOD_S, now_s)


def _now() -> float:
    """Real time, seconds, as the loop has it."""
    return asyncio.get_running_loop().time()


def _transport(request: web.Request) -> asyncio.Transport:
    """What goes to who asks. Raises ConnectionResetError, which aiohttp passes over, where it is gone already."""
    if request.transport is None:
        raise ConnectionResetError("gone before it was answered")
    return request.transport


def _forget_where(error: BaseException | None) -> None:
    """Who keeps an error keeps the frames in which it arose, and they keep him, until garbage is looked for."""
    while error is not None:
        error.__traceback__, error = None, error.__context__


def _our_end(request: web.Request) -> str:
    """The address that a request came to."""
    own = request.transport and request.transport.get_extra_info("sockname")
    return str(own[0]) if own else ""


async def _no_icon(_request: web.Request) -> web.StreamResponse:
    return web.Response(status=HTTPStatus.NO_CONTENT)


async def _add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)


@contextlib.asynccontextmanager
async def served(daemon: Daemon, host: str, port: int, tokens: Tokens | None = None) -> AsyncIterator[list[str]]:
    """The page, while it lasts; the line to print."""
    viewing = Viewing(daemon, tokens)
    port = await viewing.open(host, port)
    if not is_loopback(host):
        log.warning("the page is open to the network, unencrypted: whoever sees its address may drive the robots; "
                    "ssh -L %d:127.0.0.1:%d brings a page on loopback elsewhere", port, port)
    try:
        yield [f"listening viewer {address(host, port)}/?token={viewing.token}"]
    finally:
        await viewing.close()
