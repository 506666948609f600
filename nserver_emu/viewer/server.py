"""HTTP and websocket server of the page, in the daemon's event loop.

    GET /?token=T      the page              GET /page/NAME     its files, which contain no secret
    GET /              the page for a tab that has its token already: a reload
    GET /ws?token=T    the websocket         POST /publish?token=T    estimates of a localizer (localizers.py)
    GET /health, /metrics                    state of the daemon, for Prometheus and monitors

Everything about the simulation requires a token: to act, only to watch (http_port.py), or a student's (classroom.py);
health and metrics are open to loopback. A websocket must come from a page of this server: its Origin must be the
requested Host. The page loads nothing from other sites, which its Content-Security-Policy enforces. A page that does
not answer or receive is disconnected within CONNECTION_LOST_S.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
from collections.abc import AsyncIterator, Iterator, Sequence
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, NamedTuple

from aiohttp import WSMsgType, web

from nclient.transports.listener import LOOPBACK_NAME, is_same_machine
from nserver_emu.server.admission import at_port
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer import http_port
from nserver_emu.viewer.classroom import TEACHER, Student
from nserver_emu.viewer.controller import ViewerController
from nserver_emu.viewer.http_port import Handler, HttpPort, PageMessages, PageWriter, local_address, loop_time
from nserver_emu.viewer.messages import MAX_TEXT, InvalidMessage, encode_message
from nserver_emu.viewer.scene import Broadcaster, SceneHistory, Viewer, laser_modes

log = logging.getLogger(__name__)

PAGE: Final = Path(__file__).with_name("page")
POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS: Final = {
    "Content-Security-Policy": POLICY, "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}  # fmt: skip


class ViewerServer:
    """The page of one daemon. `token` allows everything, `watch_token` only watching, a student's only one robot."""

    def __init__(self, daemon: Daemon, tokens: http_port.Tokens | None = None,
                 students: Sequence[Student] = ()) -> None:
        self._tokens = tokens or http_port.new_tokens()
        self._students = students
        self.token, self.watch_token = self._tokens
        self.broadcaster = Broadcaster(SceneHistory(daemon.emulator))
        names = {student.robot: student.name for student in students}
        self.controller = ViewerController(daemon, self.broadcaster, names)
        self._writers: dict[Viewer, PageWriter] = {}
        self._sending: set[asyncio.Task[None]] = set()
        self._host_name = LOOPBACK_NAME
        self._port = HttpPort(daemon.admission, "the page", "--viewer")
        self._daemon = daemon

    async def open(self, host: str, port: int) -> int:
        """Start serving; return the port (port 0 takes a free one).

        Raises
        ------
        ConnectionLost
            If the port cannot be used; the message names the remedy.
        """
        # 1. Routes and middleware.
        self._host_name = host.lower()
        app = web.Application(client_max_size=MAX_TEXT, middlewares=[self._port.admit, _compress_files])
        app.on_response_prepare.append(_add_headers)
        app.router.add_get("/", self._page)
        app.router.add_get("/favicon.ico", _no_icon)
        app.router.add_get("/ws", self._socket)
        app.router.add_post("/publish", self._publish)
        app.router.add_get("/health", self._health)
        app.router.add_get("/metrics", self._metrics)
        app.router.add_static("/page/", PAGE)
        # 2. The port.
        port = await self._port.open(app, host, port)
        # 3. The clock that takes pictures; localizers that pages start publish to this port.
        self._port.start_clock(self._tick)
        place = http_port.to_loopback(at_port(host, port))
        self.controller.localizers.page_url = f"http://{place}/?token={self.token}"
        return port

    async def close(self) -> None:
        """Stop serving. May be called twice."""
        await self.controller.localizers.close()
        await self._port.close()
        self.controller.close()

    async def _tick(self) -> None:
        """Take a picture and send it to all pages; an error of one page does not affect others."""
        if not self.broadcaster.viewers:
            return
        with self.controller.error_boundary.guard("the clock"):
            self.controller.tick(loop_time())
        with self.controller.error_boundary.guard("the picture"):
            robots = self._daemon.emulator.simulation.robots
            with_laser = [number for number, robot in robots.items() if robot.model.has_light_sensors]
            self.broadcaster.take(laser_modes(self._daemon.connections, with_laser))
        for viewer in tuple(self._writers):
            await self._send_to(viewer)

    def _access(self, request: web.Request) -> http_port.Access:
        """Return what the token of a request allows; raise HTTPForbidden if it is unknown."""
        self._check_host(request)
        access = self._access_of(request.query.get("token", ""))
        if access is None:
            raise web.HTTPForbidden(text="the token is wrong: use the whole address that nserver printed\n")
        return access

    def _access_of(self, token: str) -> http_port.Access | None:
        may_act = self._tokens.may_act(token)
        if may_act is not None:
            return http_port.Access(may_act, name=TEACHER if may_act and self._students else "")
        # All are compared, so that the time does not depend on the token.
        coded = token.encode(errors="replace")
        found = [student for student in self._students if hmac.compare_digest(coded, student.token.encode())]
        return http_port.Access(True, found[0].robot, found[0].name) if found else None

    def _check_host(self, request: web.Request) -> None:
        if not http_port.is_known_host(request.host, self._host_name):
            raise web.HTTPForbidden(text=f"this page is not served as {request.host!a}: use its numeric address\n")

    async def _page(self, request: web.Request) -> web.StreamResponse:
        self._check_host(request)
        if "token" in request.query and self._access_of(request.query["token"]) is None:
            raise web.HTTPForbidden(text=http_port.REFUSED, content_type="text/html")
        return web.FileResponse(PAGE / "index.html")

    def _require_local_or_token(self, request: web.Request) -> None:
        """Raise HTTPForbidden unless the request comes from this machine or has a token."""
        # Monitoring on this machine needs no token; the Host check still excludes pages of other sites.
        is_local = is_same_machine(request.remote or "", local_address(request))
        if not is_local or not http_port.is_known_host(request.host, self._host_name):
            self._access(request)

    async def _health(self, request: web.Request) -> web.StreamResponse:
        self._require_local_or_token(request)
        is_healthy, report = health(self._daemon, loop_time())
        return web.json_response(report, status=HTTPStatus.OK if is_healthy else HTTPStatus.SERVICE_UNAVAILABLE)

    async def _metrics(self, request: web.Request) -> web.StreamResponse:
        self._require_local_or_token(request)
        text = metrics(self._daemon, len(self.broadcaster.viewers), len(asyncio.all_tasks()))
        return web.Response(body=text.encode(), headers={"Content-Type": CONTENT_TYPE})

    async def _publish(self, request: web.Request) -> web.StreamResponse:
        access = self._access(request)
        if not access.may_act:
            raise web.HTTPForbidden(text="this token only looks\n")
        try:
            text = (await request.read()).decode()
            return web.json_response(self.controller.publish(text, loop_time(), only=access.robot))
        except (InvalidMessage, UnicodeDecodeError) as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from None

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        # 1. Token, origin and number of pages, before the websocket is accepted.
        access = self._access(request)
        origin = request.headers.get("Origin", "")
        if not http_port.is_same_origin(origin, request.scheme, request.host):
            raise web.HTTPForbidden(text=f"Origin {ascii(origin) if origin else '(none)'} is not this page's\n")
        # However many pages a class opens, its teacher gets one.
        accepted = self._port.websocket(request, "pages are open", MAX_TEXT, is_limited=access.name != TEACHER)
        async with accepted as (socket, writer):
            # 2. The page is open: its messages are handled in order until it closes.
            viewer = self.controller.connect_page(loop_time(), access, watch_token=self.watch_token)
            self._writers[viewer] = writer
            viewer.on_message = lambda: self._send_soon(viewer)
            viewer.on_message()
            messages = PageMessages(
                self._daemon.scheduler, lambda text: self.controller.handle_message(viewer, text, loop_time()),
                self._port.door.limits.page_rate,
            )  # fmt: skip
            try:
                async for message in socket:
                    if message.type == WSMsgType.TEXT:
                        await messages.handle(message.data)
                    elif message.type == WSMsgType.BINARY:
                        viewer.notify(encode_message("answer", id=None, ok=False, error="a message is text, not bytes"))
                    await asyncio.sleep(0)  # let others run, however much this page sends
            finally:
                del self._writers[viewer]
                self.controller.leave(viewer)
        return socket

    def _send_soon(self, viewer: Viewer) -> None:
        """Send a page its next messages in this turn of the event loop, before the next picture."""
        task = asyncio.create_task(self._send_to(viewer))
        self._sending.add(task)  # the event loop holds tasks by weak references only
        task.add_done_callback(self._sending.discard)

    async def _send_to(self, viewer: Viewer) -> None:
        """Send a page its next messages if it can receive them; messages before an error are sent."""
        writer, now = self._writers.get(viewer), loop_time()
        if writer is None:
            return
        # Nothing is queued behind unsent data: a slow page skips pictures.
        if writer.is_ready(now):
            with self.controller.error_boundary.guard("messages and picture", viewer.name):
                for text in self.broadcaster.next_for(viewer):
                    await writer.send(text)
        elif writer.is_stalled(now):
            log.info("%s receives nothing: disconnected", viewer.name)
            writer.abort()


@web.middleware
async def _compress_files(request: web.Request, handler: Handler) -> web.StreamResponse:
    """Compress the files of the page: 54 kB instead of 190 kB, for slow links."""
    response = await handler(request)
    if isinstance(response, web.FileResponse):
        response.enable_compression()
    return response


async def _no_icon(_request: web.Request) -> web.StreamResponse:
    return web.Response(status=HTTPStatus.NO_CONTENT)


async def _add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    response.headers.update(_HEADERS)


@contextlib.asynccontextmanager
async def serve_viewer(server: ViewerServer, host: str, port: int) -> AsyncIterator[list[str]]:
    """Serve the page; yield the line to print."""
    port = await server.open(host, port)
    try:
        yield [f"listening viewer {http_port.address(host, port)}/?token={server.token}"]
    finally:
        await server.close()


CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
STUCK_S: Final = 5.0
"""A simulation clock that has not ticked for this long is reported as stuck."""
# -- metrics: nserver_WHAT in seconds and bytes, counters end in _total; no label contains an address -----------------

GAUGE, COUNTER = "gauge", "counter"


class Metric(NamedTuple):
    """One metric."""

    name: str
    kind: str
    help: str
    value: float


def all_metrics(daemon: Daemon, viewers: int, tasks: int) -> Iterator[Metric]:
    """Yield all metrics; `viewers` is the number of open pages, `tasks` of asyncio tasks."""
    emulator, connected = daemon.emulator, [connection for connection in daemon.connections if connection.is_connected]
    answered = daemon.closed_answered + sum(connection.session.answered for connection in connected)
    refused = daemon.closed_refused + sum(connection.session.refused for connection in connected)
    yield Metric("connections", GAUGE, "Clients and hosts that are connected.", len(connected))
    yield Metric("turned_away_total", COUNTER, "Connections that were rejected.", daemon.admission.rejected)
    yield Metric("answers_total", COUNTER, "Requests that were answered.", answered)
    yield Metric("refusals_total", COUNTER, "Requests that were answered with an error.", refused)
    cpu_s = daemon.closed_cpu_s + sum(connection.cpu_s for connection in connected)
    yield Metric("cpu_seconds_total", COUNTER, "Processor time that requests have taken.", cpu_s)
    yield Metric("viewers", GAUGE, "Pages that are open.", viewers)
    yield Metric("robots", GAUGE, "Robots in the world.", len(emulator.simulation.robots))
    yield Metric("obstacles", GAUGE, "Obstacles in the world.", len(emulator.simulation.world.obstacles))
    yield Metric("shapes", GAUGE, "Client graphics in memory.", len(emulator.graphics.shapes))
    yield Metric("simulated_seconds", GAUGE, "The simulation's clock.", emulator.simulation.time_s)
    yield Metric("steps_total", COUNTER, "Steps of the simulation.", daemon.steps)
    yield Metric("paused", GAUGE, "1 while simulated time is paused.", int(emulator.clock.paused))
    yield Metric("lost_seconds_total", COUNTER, "Real time that the simulation did not catch up on.", daemon.lost_s)
    yield Metric("tasks", GAUGE, "Asynchronous tasks, the one that answers this request included.", tasks)


def metrics(daemon: Daemon, viewers: int, tasks: int) -> str:
    """Return the metrics in the text format of Prometheus."""
    return "".join(
        f"# HELP nserver_{one.name} {one.help}\n# TYPE nserver_{one.name} {one.kind}\n"
        f"nserver_{one.name} {one.value!r}\n"
        for one in all_metrics(daemon, viewers, tasks)
    ) + _connection_times(daemon)


def _connection_times(daemon: Daemon) -> str:
    """Return the processor time of each connection."""
    name = "nserver_connection_cpu_seconds_total"
    samples = sorted((one.number, one.cpu_s) for one in daemon.connections if one.is_connected)
    head = f"# HELP {name} Processor time that the requests of a connection have taken.\n# TYPE {name} counter\n"
    return head + "".join(f'{name}{{connection="{number}"}} {cpu_s!r}\n' for number, cpu_s in samples)


def health(daemon: Daemon, now_s: float) -> tuple[bool, dict[str, Any]]:
    """Return whether the daemon is healthy, and the body of the reply; `now_s` is the event loop's time."""
    age_s = now_s - daemon.ticked_s
    is_healthy = age_s < STUCK_S
    return is_healthy, {
        "status": "ok" if is_healthy else "clock stuck", "clock_age_s": round(age_s, 3),
        "simulated_s": round(daemon.emulator.simulation.time_s, 3), "paused": daemon.emulator.clock.paused,
    }  # fmt: skip
