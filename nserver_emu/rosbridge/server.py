"""Websocket server of rosbridge clients, in the daemon's event loop.

    GET /?token=T             the websocket, at any path; programs send no Origin, pages that of this port
    POST /publish?token=T     estimates of a localizer: `nomad localize --publish URL`

Tokens, Host, address and rate checks and limits are those of the page (nserver_emu/viewer). Simulated robots are read
without a request, so that watching does not feed a program's motion timeout; a real one is asked by gs.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from http import HTTPStatus
from typing import Any, Final

from aiohttp import WSCloseCode, WSMsgType, web

from nclient.common.allowlist import LOOPBACK_NAME, NOT_ALLOWED
from nclient.errors import ConnectionLost
from nclient.protocol.replies import Reply
from nclient.protocol.types import M_PER_IN, MOTOR_RANGE_V, volts
from nserver_emu.rosbridge import topics
from nserver_emu.rosbridge.client import InvalidRequest, RosbridgeClient, Services
from nserver_emu.rosbridge.topics import Reading
from nserver_emu.server.admission import listen
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.server_state import state_slots
from nserver_emu.simulation.robot import battery_v
from nserver_emu.viewer import auth
from nserver_emu.viewer.controller import Answer, ViewerClients
from nserver_emu.viewer.error_boundary import ErrorBoundary
from nserver_emu.viewer.messages import MAX_TEXT, InvalidMessage, parse_estimate
from nserver_emu.viewer.server import CLOSING_S, HEARTBEAT_S, PageMessages, PageWriter, next_due, wait_for_rate
from worlds.cells import cells_of_world

PERIOD_S: Final = 0.05
"""Interval at which robots are read: twenty times a second, as for the page."""
MAP_CELL_IN: Final = 2.0
"""Cells of /map: 5 cm."""
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class RosbridgeServer:
    """Serve one daemon's robots to rosbridge clients. `has_map` is False if the world is not that of the robots."""

    def __init__(self, daemon: Daemon, tokens: auth.Tokens | None = None, *, has_map: bool = True) -> None:
        self.tokens = tokens or auth.new_tokens()
        self._daemon = daemon
        self._door = daemon.admission
        self._has_map = has_map
        self._error_boundary = ErrorBoundary()
        self._clients: dict[RosbridgeClient, PageWriter] = {}
        self._sockets: set[web.WebSocketResponse] = set()
        self._clients_made = 0
        self._estimates: dict[int, dict[str, Any]] = {}
        # A real robot is asked for its state on connections of the server's own.
        self._readers = ViewerClients(daemon, "rosbridge", self._error_boundary, answer_with_reply)
        self._asked: set[int] = set()
        self._host_name = LOOPBACK_NAME
        self._runner: web.AppRunner | None = None
        self._server: asyncio.Server | None = None
        self._admission: auth.HttpAdmission | None = None
        self._clock: asyncio.Task[None] | None = None

    async def open(self, host: str, port: int) -> int:
        """Start serving; return the port (port 0 takes a free one).

        Raises
        ------
        ConnectionLost
            If the port cannot be used.
        """
        self._host_name = host.lower()
        app = web.Application(client_max_size=MAX_TEXT, middlewares=[self._admit])
        app.router.add_post("/publish", self._publish)
        app.router.add_get("/{path:.*}", self._socket)
        self._runner = web.AppRunner(app, access_log=None, logger=auth.HTTP_LOG, shutdown_timeout=1.0)
        await self._runner.setup()
        try:
            assert self._runner.server is not None
            self._admission = auth.HttpAdmission(self._door, self._runner.server)
            self._server = await listen(self._admission.protocol_factory, host, port)
        except OSError as error:
            await self._runner.cleanup()
            raise ConnectionLost(f"cannot serve rosbridge on {host}:{port}: {error.strerror or error}; "
                                 "--rosbridge 0 takes a free port") from error
        auth.HTTP_LOG.addFilter(self._admission.keep_record)
        self._clock = asyncio.create_task(self._run_clock())
        return int(self._server.sockets[0].getsockname()[1])

    async def close(self) -> None:
        """Stop serving; robots that clients drive stop. May be called twice."""
        if self._clock is not None:
            self._clock.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._clock
            self._clock = None
        closing = [socket.close(code=WSCloseCode.GOING_AWAY, drain=False) for socket in self._sockets]
        await asyncio.gather(*closing, return_exceptions=True)
        self._readers.close()
        if self._server is not None:
            self._server.close()
            self._server = None
        if self._admission is not None:
            auth.HTTP_LOG.removeFilter(self._admission.keep_record)
            self._admission = None
        if self._runner is not None:
            await self._runner.cleanup()
            self._runner = None

    # -- requests

    @web.middleware
    async def _admit(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        if self._admission is not None:
            self._admission.request_received(request)
            await wait_for_rate(self._admission.rate_limit(request.remote or "", _now()))
        own = request.transport and request.transport.get_extra_info("sockname")
        if not self._door.access.allows(request.remote or "", str(own[0]) if own else ""):
            self._door.reject(request.remote or "", NOT_ALLOWED)
            return web.Response(status=HTTPStatus.FORBIDDEN, text="this address is not allowed\n")
        return await handler(request)

    def _may_act(self, request: web.Request) -> bool:
        """Return True if the token allows everything, False if only watching; else raise HTTPForbidden."""
        if not auth.is_known_host(request.host, self._host_name):
            raise web.HTTPForbidden(text=f"rosbridge is not served as {request.host!a}: use its numeric address\n")
        may_act = self.tokens.may_act(request.query.get("token", ""))
        if may_act is None:
            raise web.HTTPForbidden(text="the token is wrong: use the whole address that was printed\n")
        return may_act

    async def _publish(self, request: web.Request) -> web.StreamResponse:
        if not self._may_act(request):
            raise web.HTTPForbidden(text="this token only watches\n")
        try:
            estimate = parse_estimate((await request.read()).decode())
        except (InvalidMessage, UnicodeDecodeError) as error:
            raise web.HTTPBadRequest(text=f"{error}\n") from None
        robot = estimate["robot"]
        if robot not in self._daemon.emulator.simulation.robots:
            raise web.HTTPBadRequest(text=f"there is no robot {robot}\n")
        self._estimates[robot] = estimate
        self._offer(f"/robot{robot}/pose", topics.estimate_message(estimate, time.time()))
        return web.json_response({"waypoints": None, "set": 0})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        # 1. Token, origin and number of clients, before the websocket is accepted. Programs send no Origin.
        may_act = self._may_act(request)
        origin = request.headers.get("Origin")
        if origin is not None and not auth.is_same_origin(origin, request.scheme, request.host):
            raise web.HTTPForbidden(text=f"Origin {origin!a:.80} is not this server's\n")
        if len(self._sockets) >= self._door.limits.viewers:
            self._door.reject(request.remote or "", "too many rosbridge clients (--limit-viewers)")
            raise web.HTTPServiceUnavailable(text="too many clients: close one (--limit-viewers)\n")
        socket = web.WebSocketResponse(compress=False, heartbeat=HEARTBEAT_S, timeout=CLOSING_S, max_msg_size=MAX_TEXT)
        self._sockets.add(socket)
        try:
            await socket.prepare(request)
            if request.transport is None:
                raise ConnectionResetError("closed before the request was answered")
            writer = PageWriter(socket, request.transport, _now())
        except BaseException:
            self._sockets.discard(socket)
            raise
        # 2. Its messages are handled in order until it closes, which stops what it drives.
        self._clients_made += 1
        robots = ViewerClients(self._daemon, f"rosbridge {self._clients_made}", self._error_boundary)
        client = RosbridgeClient(robots, self._services(), may_act=may_act)
        self._clients[client] = writer
        messages = PageMessages(self._daemon.scheduler, lambda text: self._handle(client, text),
                                self._door.limits.page_rate)  # fmt: skip
        try:
            async for message in socket:
                if message.type == WSMsgType.TEXT:
                    await messages.handle(message.data)
                    await self._send(client)
                await asyncio.sleep(0)
        finally:
            self._sockets.discard(socket)
            del self._clients[client]
            robots.close()
            if socket.close_code == WSCloseCode.ABNORMAL_CLOSURE:
                writer.abort()
        return socket

    def _handle(self, client: RosbridgeClient, text: str) -> None:
        with self._error_boundary.guard("a message", client.robots.name):
            client.handle(text, _now())

    def _services(self) -> Services:
        simulated = self._daemon.emulator.simulation.robots
        return Services(
            topics.topic_types(list(simulated)), topics.command_types(list(simulated)),
            lambda robot: simulated[robot].model.track_in is not None, self._latched,
        )  # fmt: skip

    def _latched(self, topic: str) -> dict[str, Any] | None:
        """Return the map, the only topic that is sent once. Raises InvalidRequest if there is none."""
        if topic != topics.MAP:
            return None
        if not self._has_map:
            raise InvalidRequest("/map: the map of this robot is not known; name it with --map")
        try:
            grid = cells_of_world(self._daemon.emulator.simulation.world, MAP_CELL_IN)
        except (ImportError, ValueError) as error:
            raise InvalidRequest(f"/map: {error}; the extra maps has what it needs") from None
        return topics.grid_message(grid, time.time())

    # -- publishing

    async def _run_clock(self) -> None:
        due = _now()
        while True:
            due = next_due(due, _now())
            await asyncio.sleep(due - _now())
            if self._clients:
                with self._error_boundary.guard("the clock"):
                    await self._tick()

    async def _tick(self) -> None:
        """Stop robots whose driver is silent, read those that are watched, send what is due."""
        now = _now()
        for client in self._clients:
            client.robots.tick(now)
        wanted = {topic for client in self._clients for topic in client.subscriptions}
        for robot in self._daemon.emulator.simulation.robots:
            if topics.TF in wanted or any(topic.startswith(f"/robot{robot}/") for topic in wanted):
                self._read(robot)
        for client in tuple(self._clients):
            await self._send(client)

    def _read(self, robot: int) -> None:
        daemon = self._daemon
        if daemon.handler is daemon.emulator:
            simulated = daemon.emulator.simulation.robots[robot]
            slots = state_slots(simulated, daemon.emulator.clock.speed_tenths)
            self._publish_reading(robot, slots, battery_v(daemon.emulator.simulation.time_s))
        elif robot not in self._asked:
            # One question at a time: a slow line is not asked faster than it answers.
            self._asked.add(robot)
            self._readers.call(robot, "gs", [], lambda answer: self._answered(robot, answer))

    def _answered(self, robot: int, answer: Answer) -> None:
        self._asked.discard(robot)
        reply = answer.get("reply")
        if answer["ok"] and reply is not None and reply.slots:
            raw = reply.volts[1] if reply.volts else None
            slots = [reply.slots.get(slot, 0) for slot in range(45)]
            self._publish_reading(robot, slots, None if raw is None else volts(raw, MOTOR_RANGE_V))

    def _publish_reading(self, robot: int, slots: list[int], volts_v: float | None) -> None:
        body = self._daemon.emulator.simulation.robots[robot].model
        reading = Reading(robot, slots, body.track_in is not None, time.time(), volts_v)
        for topic, message in topics.messages_of(reading):
            self._offer(topic, message)
        estimate = self._estimates.get(robot)
        ring_m = body.body.sonar_ring_radius_in * M_PER_IN
        localized = None if estimate is None else topics.map_to_odom(estimate)
        self._offer(topics.TF, {"transforms": topics.transforms(reading, ring_m, localized)})

    def _offer(self, topic: str, message: dict[str, Any]) -> None:
        now = _now()
        for client in self._clients:
            client.offer(topic, message, now)

    async def _send(self, client: RosbridgeClient) -> None:
        writer, now = self._clients.get(client), _now()
        if writer is None:
            return
        if writer.is_ready(now):
            while client.unsent:
                await writer.send(client.unsent.popleft())
        elif writer.is_stalled(now):
            writer.abort()


def answer_with_reply(name: str, reply: Reply) -> Answer:
    """Return the answer to a call with its whole reply."""
    del name
    return {"ok": reply.kind != "error", "values": list(reply.values), "reply": reply}


def _now() -> float:
    return asyncio.get_running_loop().time()


@contextlib.asynccontextmanager
async def serve_rosbridge(
    daemon: Daemon, host: str, port: int, tokens: auth.Tokens | None = None, *, has_map: bool = True
) -> AsyncIterator[list[str]]:
    """Serve rosbridge clients; yield the line to print."""
    server = RosbridgeServer(daemon, tokens, has_map=has_map)
    port = await server.open(host, port)
    place = auth.address(host, port).replace("http", "ws", 1)
    try:
        yield [f"listening rosbridge {place}/?token={server.tokens.act}"]
    finally:
        await server.close()
