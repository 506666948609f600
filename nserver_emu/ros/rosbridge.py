"""Websocket server of rosbridge clients, in the daemon's event loop.

    GET /?token=T             the websocket, at any path; programs send no Origin, pages one of --rosbridge-origin
    POST /publish?token=T     estimates of a localizer: `nomad localize --publish URL`

Tokens, Host, address and rate checks and limits are those of the page (nserver_emu/viewer).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Set
from typing import Any, Final

from aiohttp import WSMsgType, web

from nclient.common.allowlist import LOOPBACK_NAME, is_loopback
from nclient.common.hints import install_command
from nclient.recording.ros_messages import MAP, TF, TF_STATIC
from nserver_emu.ros import topics
from nserver_emu.ros.client import InvalidRequest, RosbridgeClient, Services, encode_published, short_type
from nserver_emu.ros.readings import RobotReader, map_message, rings_of
from nserver_emu.ros.topics import Estimates
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer import auth
from nserver_emu.viewer.clients import ViewerClients
from nserver_emu.viewer.error_boundary import ErrorBoundary
from nserver_emu.viewer.http_port import HttpPort, PageMessages, PageWriter, loop_time
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S, MAX_TEXT, InvalidMessage, parse_estimate
from worlds.world import World

log = logging.getLogger(__name__)

MAX_MESSAGE: Final = 131_072
"""Bytes of a message from a client; they are short. A longer one closes the connection."""


class RosbridgeServer:
    """Serve one daemon's robots to rosbridge clients.

    `has_map` is False if the world is not that of the robots; `origins` are those of pages that may connect.
    """

    def __init__(
        self, daemon: Daemon, tokens: auth.Tokens | None = None, *, has_map: bool = True,
        estimates: Estimates | None = None, origins: Set[str] = frozenset(),
    ) -> None:  # fmt: skip
        self.tokens = tokens or auth.new_tokens()
        self._daemon = daemon
        self._port = HttpPort(daemon.admission, "rosbridge", "--rosbridge")
        self._has_map = has_map
        self._origins = origins
        self._error_boundary = ErrorBoundary("rosbridge")
        self._clients: dict[RosbridgeClient, PageWriter] = {}
        self._clients_made = 0
        # The world of /map, and the message about it.
        self._map: tuple[World, str] | None = None
        self._estimates = estimates or Estimates()
        self._reader = RobotReader(daemon, "rosbridge", self._error_boundary, self._offer, self._estimates)
        self._host_name = LOOPBACK_NAME

    async def open(self, host: str, port: int) -> int:
        """Start serving; return the port (port 0 takes a free one).

        Raises
        ------
        ConnectionLost
            If the port cannot be used.
        """
        self._host_name = host.lower()
        app = web.Application(client_max_size=MAX_TEXT, middlewares=[self._port.admit])
        app.router.add_post("/publish", self._publish)
        app.router.add_get("/{path:.*}", self._socket)
        port = await self._port.open(app, host, port)
        self._port.start_clock(self._tick)
        return port

    async def close(self) -> None:
        """Stop serving; robots that clients drive stop. May be called twice."""
        await self._port.close()
        self._reader.close()

    # -- requests

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
        self._estimates.add(robot, estimate)
        return web.json_response({"waypoints": None, "set": 0})

    async def _socket(self, request: web.Request) -> web.StreamResponse:
        # 1. Token, origin and number of clients, before the websocket is accepted. Programs send no Origin.
        may_act = self._may_act(request)
        origin = request.headers.get("Origin")
        is_unnamed = origin is not None and origin not in self._origins
        if is_unnamed and not auth.is_same_origin(origin or "", request.scheme, request.host):
            raise web.HTTPForbidden(text=f"pages of {origin!a:.80} may not connect (--rosbridge-origin)\n")
        async with self._port.websocket(request, "rosbridge clients", MAX_MESSAGE) as (socket, writer):
            # 2. Its messages are handled in order until it closes, which stops what it drives.
            self._clients_made += 1
            robots = ViewerClients(self._daemon, f"rosbridge {self._clients_made}", self._error_boundary)
            client = RosbridgeClient(robots, self._services(), may_act=may_act)
            self._clients[client] = writer
            backlog = Backlog()
            messages = PageMessages(
                self._daemon.scheduler,
                lambda text: self._handle(client, text, is_late=backlog.max_age_s() > DRIVE_TIMEOUT_S),
                self._port.door.limits.page_rate,
            )
            try:
                async for message in socket:
                    backlog.message_received()
                    if message.type == WSMsgType.TEXT:
                        if MAP in message.data:
                            await self._prepare_map()
                        await messages.handle(message.data)
                        await self._send(client)
                    await asyncio.sleep(0)
                    backlog.expect_message()
            finally:
                del self._clients[client]
                robots.close()
        return socket

    def _handle(self, client: RosbridgeClient, text: str, *, is_late: bool) -> None:
        with self._error_boundary.guard("a message", client.robots.name):
            client.handle(text, loop_time(), is_late=is_late)

    def _services(self) -> Services:
        simulated = self._daemon.emulator.simulation.robots
        published, commands = topics.topic_types(rings_of(self._daemon)), topics.command_types(simulated)
        return Services(
            {name: short_type(kind) for name, kind in published.items()},
            {name: short_type(kind) for name, kind in commands.items()},
            lambda robot: simulated[robot].model.track_in is not None, self._latched,
        )  # fmt: skip

    async def _prepare_map(self) -> None:
        """Make /map of the present world in a thread, since that takes up to a second; `_latched` reports errors."""
        world = self._daemon.emulator.simulation.world
        if self._has_map and (self._map is None or self._map[0] is not world):
            with contextlib.suppress(ImportError, ValueError):
                self._map = world, await asyncio.to_thread(lambda: encode_published(MAP, map_message(world)))

    def _latched(self, topic: str) -> str | None:
        """Return a topic that is sent once: frames of sonars, map. Raises InvalidRequest if there is no map."""
        if topic == TF_STATIC:
            return encode_published(topic, self._reader.static_frames())
        if topic != MAP:
            return None
        if not self._has_map:
            raise InvalidRequest("/map: the map of this robot is not known; name it with --map")
        world = self._daemon.emulator.simulation.world
        if self._map is None or self._map[0] is not world:
            try:
                self._map = world, encode_published(topic, map_message(world))
            except ImportError as error:
                raise InvalidRequest(f"/map: {error}; install it: {install_command('maps')}") from None
            except ValueError as error:
                raise InvalidRequest(f"/map: {error}") from None
        return self._map[1]

    # -- publishing

    async def _tick(self) -> None:
        if self._clients:
            with self._error_boundary.guard("the clock"):
                await self._update_clients()

    async def _update_clients(self) -> None:
        """Stop robots whose driver is silent, read those that are watched, send what is due.

        An error of one robot or client does not affect others.
        """
        now = loop_time()
        for client in self._clients:
            client.robots.tick(now)
        wanted = {topic for client in self._clients for topic in client.subscriptions}
        for robot in self._daemon.emulator.simulation.robots:
            if TF in wanted or any(topic.startswith(f"/robot{robot}/") for topic in wanted):
                with self._error_boundary.guard("reading a robot"):
                    self._reader.read(robot)
        for client in tuple(self._clients):
            await self._send(client)

    def _offer(self, topic: str, message: dict[str, Any]) -> None:
        now = loop_time()
        for client in self._clients:
            client.offer(topic, message, now)

    async def _send(self, client: RosbridgeClient) -> None:
        writer, now = self._clients.get(client), loop_time()
        if writer is None:
            return
        if writer.is_ready(now):
            # One after another: what is sent once, such as a map, is large.
            with self._error_boundary.guard("messages", client.robots.name):
                while client.unsent and writer.is_ready(now):
                    await writer.send(client.unsent.popleft())
        elif writer.is_stalled(now):
            writer.abort()


class Backlog:
    """Bound of the age of a client's messages.

    A program that sends faster than its messages are handled leaves a queue, which is handled even after the program
    has vanished. A message is no older than the time since the queue was last empty.
    """

    def __init__(self) -> None:
        self._empty_at_s = loop_time()
        self._has_turned = True

    def expect_message(self) -> None:
        """Call before waiting for the next message."""
        # The event loop turns only if there is none.
        self._has_turned = False
        asyncio.get_running_loop().call_soon(self._turned)

    def message_received(self) -> None:
        """Call with the next message."""
        if self._has_turned:
            self._empty_at_s = loop_time()

    def max_age_s(self) -> float:
        """Return the largest possible age of the message that is handled."""
        return loop_time() - self._empty_at_s

    def _turned(self) -> None:
        self._has_turned = True


@contextlib.asynccontextmanager
async def serve_rosbridge(
    daemon: Daemon, host: str, port: int, tokens: auth.Tokens | None = None, *, has_map: bool = True,
    estimates: Estimates | None = None, origins: Set[str] = frozenset(),
) -> AsyncIterator[list[str]]:
    """Serve rosbridge clients; yield the line to print."""
    server = RosbridgeServer(daemon, tokens, has_map=has_map, estimates=estimates, origins=origins)
    port = await server.open(host, port)
    if not is_loopback(host):
        log.warning("rosbridge is open to the network, unencrypted: all who read its address can drive the robots; "
                    "ssh -L %d:127.0.0.1:%d forwards a port on loopback to another machine", port, port)
    place = auth.address(host, port).replace("http", "ws", 1)
    try:
        yield [f"listening rosbridge {place}/?token={server.tokens.act}"]
    finally:
        await server.close()
