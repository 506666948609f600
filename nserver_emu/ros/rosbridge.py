"""Websocket server of rosbridge clients, in the daemon's event loop.

    GET /?token=T             the websocket, at any path; programs send no Origin, pages one of --rosbridge-origin
    POST /publish?token=T     estimates of a localizer: `nomad localize --publish URL`

Tokens, Host, address and rate checks and limits are those of the page (nserver_emu/viewer).

One rosbridge client: its subscriptions, its commands, its messages. No sockets; time is an argument.

    handle(text) ──> advertise, unadvertise, publish, subscribe, unsubscribe, call_service, set_level
    offer(topic, message) ──> {"op": "publish", ...}, if subscribed and not throttled

Every error is a status message of rosbridge; only a message that is too long closes the connection.
Velocities must be repeated: the robot stops DRIVE_TIMEOUT_S after the last one, and when the connection closes. Those
that may be older than that, because the client sends faster than its messages are handled, are refused unless they
stop the robot.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import math
from collections import deque
from collections.abc import AsyncIterator, Callable, Mapping, Set
from dataclasses import dataclass, field
from typing import Any, Final

from aiohttp import WSMsgType, web

from nclient.errors import install_command
from nclient.recording.ros_messages import MAP, TF, TF_STATIC
from nclient.transports.listener import LOOPBACK_NAME
from nserver_emu.ros import topics
from nserver_emu.ros.topics import Estimates, RobotReader, map_message, rings_of
from nserver_emu.server.daemon import Daemon
from nserver_emu.viewer import http_port
from nserver_emu.viewer.clients import ErrorBoundary, ViewerClients
from nserver_emu.viewer.http_port import HttpPort, PageMessages, PageWriter, loop_time
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S, MAX_TEXT, InvalidMessage, parse_estimate
from worlds.world import World

log = logging.getLogger(__name__)

LEVELS: Final = ("none", "error", "warning", "info")
MAX_SUBSCRIPTIONS: Final = 200
"""Subscribe messages of a client that are in force."""
MAX_UNSENT: Final = 200
"""Messages that wait for a slow client; older ones are dropped."""
_ROSAPI: Final = ("/rosapi/topics", "/rosapi/topic_type", "/rosapi/services")
_TYPE_PREFIX: Final = "/msg/"
_TIME: Final = {"sec", "nanosec"}


class InvalidRequest(ValueError):
    """A message of a client that cannot be carried out; the text is for its status message."""


@dataclass(slots=True)
class Subscription:
    """A topic that a client wants, by the ids of its subscribe messages, with the throttle of each in seconds."""

    throttles_s: dict[str, float] = field(default_factory=dict)
    due_s: float = 0.0

    @property
    def interval_s(self) -> float:
        """Return the smallest throttle."""
        return min(self.throttles_s.values(), default=0.0)


@dataclass(frozen=True, slots=True)
class Services:
    """Topics and services for clients: topics by name, and functions of the server."""

    published: Mapping[str, str]
    commands: Mapping[str, str]
    is_differential: Callable[[int], bool]
    latched: Callable[[str], str | None]
    """Returns the encoded message of a topic that is sent once, to new subscribers; raises InvalidRequest."""


class RosbridgeClient:
    """A connected program. `may_act` is False for one with the token that only watches."""

    def __init__(self, robots: ViewerClients, services: Services, *, may_act: bool) -> None:
        self.robots = robots
        self.subscriptions: dict[str, Subscription] = {}
        self.unsent: deque[str] = deque(maxlen=MAX_UNSENT)
        self._services = services
        self._may_act = may_act
        self._level = LEVELS.index("error")

    def handle(self, text: str, now: float, *, is_late: bool = False) -> None:
        """Carry out a message of the client; errors become status messages.

        `is_late` is True if the message may have waited for longer than DRIVE_TIMEOUT_S.
        """
        request: Any = None
        try:
            request = _parse(text)
            self._carry_out(request, now, is_late)
        except InvalidRequest as error:
            self._status("error", str(error), request)

    def offer(self, topic: str, message: dict[str, Any], now: float) -> None:
        """Queue a message of a topic if the client wants it now."""
        subscription = self.subscriptions.get(topic)
        if subscription is not None and now >= subscription.due_s:
            # Counted from the planned time, so that the average rate is right; a longer delay is not made up for.
            interval_s, late_s = subscription.interval_s, now - subscription.due_s
            subscription.due_s = (subscription.due_s if late_s < interval_s else now) + interval_s
            self.unsent.append(encode_published(topic, message))

    def _carry_out(self, request: dict[str, Any], now: float, is_late: bool) -> None:
        match request["op"]:
            case "subscribe":
                self._subscribe(request)
            case "unsubscribe":
                self._unsubscribe(request)
            case "advertise":
                self._require_command(request)
            case "unadvertise":
                self._require_topic(request)
            case "publish":
                self._publish(request, now, is_late)
            case "call_service":
                self._call(request)
            case "set_level" | "status_level":
                if request.get("level") not in LEVELS:
                    raise InvalidRequest(f"set_level: level is one of {', '.join(LEVELS)}")
                self._level = LEVELS.index(request["level"])
            case op:
                raise InvalidRequest(f"no operation {op!r:.40}; there are advertise, unadvertise, publish, subscribe, "
                                     "unsubscribe, call_service, set_level")

    # -- topics

    def _subscribe(self, request: dict[str, Any]) -> None:
        # 1. The topic exists, with this type.
        topic = self._require_topic(request)
        published = self._services.published
        if topic not in published:
            raise InvalidRequest(f"no topic {topic!a:.80} is published; /rosapi/topics lists them")
        _require_type(request, published[topic])
        if request.get("compression", "none") not in ("none", None):
            raise InvalidRequest(f"{topic}: compression {request['compression']!r:.40} is not available; only none is")
        throttle_ms = request.get("throttle_rate", 0) or 0
        if isinstance(throttle_ms, bool) or not isinstance(throttle_ms, int | float) or not 0 <= throttle_ms < 1e9:
            raise InvalidRequest(f"{topic}: throttle_rate is a number of milliseconds, 0 or more")
        number, ids = str(request.get("id")), [one.throttles_s for one in self.subscriptions.values()]
        is_new = topic not in self.subscriptions or number not in self.subscriptions[topic].throttles_s
        if is_new and sum(map(len, ids)) >= MAX_SUBSCRIPTIONS:
            raise InvalidRequest(f"{topic}: this connection has {MAX_SUBSCRIPTIONS} subscriptions, the maximum: "
                                 "unsubscribe from some")
        # 2. What is sent once is sent now.
        constant = self._services.latched(topic)
        subscription = self.subscriptions.setdefault(topic, Subscription())
        subscription.throttles_s[number] = throttle_ms / 1000
        if constant is not None:
            self.unsent.append(constant)

    def _unsubscribe(self, request: dict[str, Any]) -> None:
        topic = self._require_topic(request)
        subscription = self.subscriptions.get(topic)
        if subscription is None:
            raise InvalidRequest(f"{topic!a:.80} is not subscribed")
        # Without an id all subscriptions of the topic end.
        if request.get("id") is not None:
            subscription.throttles_s.pop(str(request["id"]), None)
        if request.get("id") is None or not subscription.throttles_s:
            del self.subscriptions[topic]

    def _publish(self, request: dict[str, Any], now: float, is_late: bool) -> None:
        topic = self._require_command(request)
        robot = _robot_of(topic)
        try:
            args = topics.velocities(request.get("msg"), self._services.is_differential(robot))
        except ValueError as error:
            raise InvalidRequest(f"{topic}: {error}") from None
        if is_late and any(args):
            raise InvalidRequest(f"{topic}: this connection sends faster than its messages are handled "
                                 "(--limit-page-rate), so velocities are late and not carried out: publish 10 to 50 "
                                 "times a second")

        def answered(answer: dict[str, Any]) -> None:
            if not answer["ok"]:
                self._status("error", f"{topic}: {answer['error']}", request)

        self.robots.drive(robot, args, now, answered)

    def _require_topic(self, request: dict[str, Any]) -> str:
        topic = request.get("topic")
        if not isinstance(topic, str) or not topic:
            raise InvalidRequest(f"{request['op']}: topic is missing")
        return topic if topic.startswith("/") else f"/{topic}"

    def _require_command(self, request: dict[str, Any]) -> str:
        topic = self._require_topic(request)
        if topic not in self._services.commands:
            names = ", ".join(self._services.commands)
            raise InvalidRequest(f"no topic {topic!a:.80} takes messages; there are {names}")
        if not self._may_act:
            raise InvalidRequest(f"{topic}: this token only watches")
        _require_type(request, self._services.commands[topic])
        return topic

    # -- services

    def _call(self, request: dict[str, Any]) -> None:
        service = request.get("service")
        if not isinstance(service, str):
            raise InvalidRequest("call_service: service is missing")
        published, commands = self._services.published, self._services.commands
        match service:
            case "/rosapi/topics":
                every = {**published, **commands}
                self._respond(request, {"topics": list(every), "types": list(every.values())})
            case "/rosapi/topic_type":
                args = request.get("args")
                if isinstance(args, list):
                    args = {"topic": next(iter(args), "")}
                topic = args.get("topic") if isinstance(args, dict) else ""
                self._respond(request, {"type": {**published, **commands}.get(str(topic), "")})
            case "/rosapi/services":
                stops = [f"{name.removesuffix('/cmd_vel')}/stop" for name in commands]
                self._respond(request, {"services": [*stops, *_ROSAPI]})
            case _ if service.endswith("/stop") and f"{service.removesuffix('/stop')}/cmd_vel" in commands:
                self._stop(request, _robot_of(service))
            case _:
                self._respond(request, f"no service {service!a:.80}; /rosapi/services lists them", result=False)

    def _stop(self, request: dict[str, Any], robot: int) -> None:
        """Stop a robot at once: std_srvs/Trigger."""
        if not self._may_act:
            self._respond(request, "this token only watches", result=False)
            return

        def answered(answer: dict[str, Any]) -> None:
            self._respond(request, {"success": answer["ok"], "message": answer.get("error", "")})

        self.robots.call(robot, "st", [], answered)

    def _respond(self, request: dict[str, Any], values: Any, *, result: bool = True) -> None:
        answer = {"op": "service_response", "service": request.get("service"), "values": values, "result": result}
        self._send(answer | ({"id": request["id"]} if "id" in request else {}))

    # -- messages

    def _status(self, level: str, text: str, request: Any) -> None:
        if LEVELS.index(level) <= self._level:
            number = request.get("id") if isinstance(request, dict) else None
            self._send({"op": "status", "level": level, "msg": text} | ({} if number is None else {"id": number}))

    def _send(self, message: dict[str, Any]) -> None:
        self.unsent.append(_encode(message))


def encode_published(topic: str, message: dict[str, Any]) -> str:
    """Encode a message of a topic."""
    return _encode({"op": "publish", "topic": topic, "msg": _as_json(message)})


def _as_json(value: Any) -> Any:
    """Return a message in the form of rosbridge: JSON has no infinity and no NaN, and times are those of ROS 1.

    A wall nearer than a sonar measures is its minimum, since null would be no echo.
    """
    match value:
        case {"ranges": ranges, "range_min": nearest}:
            value = value | {"ranges": [max(one, nearest) for one in ranges]}
        case {"range": one, "min_range": nearest}:
            value = value | {"range": max(one, nearest)}
    match value:
        case float():
            return value if math.isfinite(value) else None
        case dict() if value.keys() == _TIME:
            return {"secs": value["sec"], "nsecs": value["nanosec"]}
        case dict():
            return {name: _as_json(one) for name, one in value.items()}
        # A map has a million whole numbers.
        case [float() | dict(), *_]:
            return [_as_json(one) for one in value]
    return value


def _encode(message: dict[str, Any]) -> str:
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


def _parse(text: str) -> dict[str, Any]:
    try:
        request = json.loads(text)
    except (ValueError, RecursionError):
        request = None
    if not isinstance(request, dict) or not isinstance(request.get("op"), str):
        raise InvalidRequest("a message is a JSON object with op, the operation")
    # It is sent back.
    if not isinstance(request.get("id", ""), str | int | None):
        raise InvalidRequest("id is a text")
    return request


def _require_type(request: dict[str, Any], wanted: str) -> None:
    given = request.get("type")
    # ROS 1 and ROS 2 spell it nav_msgs/Odometry and nav_msgs/msg/Odometry.
    if given is not None and short_type(str(given)) != wanted:
        raise InvalidRequest(f"{request['topic']}: is of type {wanted}, not {given!a:.80}")


def short_type(name: str) -> str:
    """Return the name of a type as in ROS 1."""
    return name.replace(_TYPE_PREFIX, "/")


def _robot_of(topic: str) -> int:
    return int(topic.split("/")[1].removeprefix("robot"))


MAX_MESSAGE: Final = 131_072
"""Bytes of a message from a client; they are short. A longer one closes the connection."""


class RosbridgeServer:
    """Serve one daemon's robots to rosbridge clients.

    `has_map` is False if the world is not that of the robots; `origins` are those of pages that may connect.
    """

    def __init__(self, daemon: Daemon, tokens: http_port.Tokens | None = None, *, has_map: bool = True,
                 estimates: Estimates | None = None, origins: Set[str] = frozenset()) -> None:
        self.tokens = tokens or http_port.new_tokens()
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
        if not http_port.is_known_host(request.host, self._host_name):
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
        if is_unnamed and not http_port.is_same_origin(origin or "", request.scheme, request.host):
            raise web.HTTPForbidden(text=f"pages of {origin!a:.80} may not connect (--rosbridge-origin)\n")
        async with self._port.websocket(request, "rosbridge clients", MAX_MESSAGE) as (socket, writer):
            # 2. Its messages are handled in order until it closes, which stops what it drives.
            self._clients_made += 1
            robots = ViewerClients(self._daemon, f"rosbridge {self._clients_made}", self._error_boundary)
            client = RosbridgeClient(robots, self._services(), may_act=may_act)
            self._clients[client] = writer
            backlog = Backlog()

            def handle(text: str) -> None:
                with self._error_boundary.guard("a message", robots.name):
                    client.handle(text, loop_time(), is_late=backlog.max_age_s() > DRIVE_TIMEOUT_S)

            messages = PageMessages(self._daemon.scheduler, handle, self._port.door.limits.page_rate)
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
async def serve_rosbridge(server: RosbridgeServer, host: str, port: int) -> AsyncIterator[list[str]]:
    """Serve rosbridge clients; yield the line to print."""
    port = await server.open(host, port)
    place = http_port.address(host, port).replace("http", "ws", 1)
    try:
        yield [f"listening rosbridge {place}/?token={server.tokens.act}"]
    finally:
        await server.close()
