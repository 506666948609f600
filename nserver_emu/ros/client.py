"""One rosbridge client: its subscriptions, its commands, its messages. No sockets; time is an argument.

    handle(text) ──> advertise, unadvertise, publish, subscribe, unsubscribe, call_service, set_level
    offer(topic, message) ──> {"op": "publish", ...}, if subscribed and not throttled

Every error is a status message of rosbridge; only a message that is too long closes the connection (server.py).
Velocities must be repeated: the robot stops DRIVE_TIMEOUT_S after the last one, and when the connection closes. Those
that may be older than that, because the client sends faster than its messages are handled, are refused unless they
stop the robot.
"""

import json
import logging
import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from nserver_emu.ros import topics
from nserver_emu.viewer.clients import ViewerClients

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
