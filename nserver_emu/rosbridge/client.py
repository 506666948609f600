"""One rosbridge client: its subscriptions, its commands, its messages. No sockets; time is an argument.

    handle(text) ──> advertise, unadvertise, publish, subscribe, unsubscribe, call_service, set_level
    offer(topic, message) ──> {"op": "publish", ...}, if subscribed and not throttled

Every error is a status message of rosbridge; none closes the connection. Velocities must be repeated: the robot stops
DRIVE_TIMEOUT_S after the last one, and when the connection closes.
"""

import json
import logging
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from nserver_emu.rosbridge import topics
from nserver_emu.viewer.controller import ViewerClients

log = logging.getLogger(__name__)

LEVELS: Final = ("none", "error", "warning", "info")
MAX_SUBSCRIPTIONS: Final = 200
MAX_UNSENT: Final = 200
"""Messages that wait for a slow client; older ones are dropped."""
_ROSAPI: Final = ("/rosapi/topics", "/rosapi/topic_type", "/rosapi/services")
_TYPE_PREFIX: Final = "/msg/"


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
    latched: Callable[[str], dict[str, Any] | None]
    """Returns the last message of a topic that does not change, for new subscribers; raises InvalidRequest."""


class RosbridgeClient:
    """A connected program. `may_act` is False for one with the token that only watches."""

    def __init__(self, robots: ViewerClients, services: Services, *, may_act: bool) -> None:
        self.robots = robots
        self.subscriptions: dict[str, Subscription] = {}
        self.unsent: deque[str] = deque(maxlen=MAX_UNSENT)
        self._services = services
        self._may_act = may_act
        self._level = LEVELS.index("error")

    def handle(self, text: str, now: float) -> None:
        """Carry out a message of the client; errors become status messages."""
        request: Any = None
        try:
            request = _parse(text)
            self._carry_out(request, now)
        except InvalidRequest as error:
            self._status("error", str(error), request)

    def offer(self, topic: str, message: dict[str, Any], now: float) -> None:
        """Queue a message of a topic if the client wants it now."""
        subscription = self.subscriptions.get(topic)
        if subscription is not None and now >= subscription.due_s:
            # Counted from the planned time, so that the average rate is right; a longer delay is not made up for.
            interval_s, late_s = subscription.interval_s, now - subscription.due_s
            subscription.due_s = (subscription.due_s if late_s < interval_s else now) + interval_s
            self._send({"op": "publish", "topic": topic, "msg": message})

    def _carry_out(self, request: dict[str, Any], now: float) -> None:
        match request["op"]:
            case "subscribe":
                self._subscribe(request, now)
            case "unsubscribe":
                self._unsubscribe(request)
            case "advertise":
                self._require_command(request)
            case "unadvertise":
                self._require_topic(request)
            case "publish":
                self._publish(request, now)
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

    def _subscribe(self, request: dict[str, Any], now: float) -> None:
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
        if topic not in self.subscriptions and len(self.subscriptions) >= MAX_SUBSCRIPTIONS:
            raise InvalidRequest(f"{topic}: this connection has {MAX_SUBSCRIPTIONS} subscriptions, the most there are")
        # 2. What never changes is sent once, now.
        constant = self._services.latched(topic)
        subscription = self.subscriptions.setdefault(topic, Subscription())
        subscription.throttles_s[str(request.get("id"))] = throttle_ms / 1000
        if constant is not None:
            self.offer(topic, constant, now)

    def _unsubscribe(self, request: dict[str, Any]) -> None:
        topic = self._require_topic(request)
        subscription = self.subscriptions.get(topic)
        if subscription is None:
            raise InvalidRequest(f"{topic}: is not subscribed")
        # Without an id all subscriptions of the topic end.
        if request.get("id") is not None:
            subscription.throttles_s.pop(str(request["id"]), None)
        if request.get("id") is None or not subscription.throttles_s:
            del self.subscriptions[topic]

    def _publish(self, request: dict[str, Any], now: float) -> None:
        topic = self._require_command(request)
        robot = _robot_of(topic)
        try:
            args = topics.velocities(request.get("msg"), self._services.is_differential(robot))
        except ValueError as error:
            raise InvalidRequest(f"{topic}: {error}") from None

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
        published, commands = self._services.published, self._services.commands
        match service:
            case "/rosapi/topics":
                every = {**published, **commands}
                self._respond(request, {"topics": list(every), "types": list(every.values())})
            case "/rosapi/topic_type":
                args = request.get("args")
                topic = args.get("topic", "") if isinstance(args, dict) else args[0] if isinstance(args, list) else ""
                self._respond(request, {"type": {**published, **commands}.get(str(topic), "")})
            case "/rosapi/services":
                stops = [f"{name.removesuffix('/cmd_vel')}/stop" for name in commands]
                self._respond(request, {"services": [*stops, *_ROSAPI]})
            case str() if service.endswith("/stop") and f"{service.removesuffix('/stop')}/cmd_vel" in commands:
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
        self.unsent.append(json.dumps(message, separators=(",", ":"), allow_nan=False))


def _parse(text: str) -> dict[str, Any]:
    try:
        request = json.loads(text)
    except (ValueError, RecursionError):
        request = None
    if not isinstance(request, dict) or not isinstance(request.get("op"), str):
        raise InvalidRequest("a message is a JSON object with op, the operation")
    return request


def _require_type(request: dict[str, Any], wanted: str) -> None:
    given = request.get("type")
    # ROS 1 and ROS 2 spell it nav_msgs/Odometry and nav_msgs/msg/Odometry.
    if given is not None and str(given).replace(_TYPE_PREFIX, "/") != wanted:
        raise InvalidRequest(f"{request['topic']}: is of type {wanted}, not {given!a:.80}")


def _robot_of(topic: str) -> int:
    return int(topic.split("/")[1].removeprefix("robot"))
