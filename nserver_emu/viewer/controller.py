"""A viewer's hand: what the page does to a robot is said as a client of that robot says it, so the same rules hold.

    call(name, args, then) ──> bytes ──> Session ──> answer of simulation or real robot ──> bytes ──> then(answer)

Rules: one connection a robot, made when it is first touched; it is on the recording as any client's is, and what it
drives stops when the page is gone. Who drives by hand says so again and again: silence stops the robot. Faults on
purpose are for lines and clients: no plan touches a hand, for what stops a robot must arrive.

Takes what a page says and has it done: the one table of what `do` does. No socket; real time is handed in.

Rules: whoever only looks is told so when it wants more. What goes wrong is told to who asked, and costs nobody else.
"""

from __future__ import annotations

import json
import logging
from collections import Counter, deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from nclient.errors import REFUSALS, NomadError
from nclient.faults.frames import Language, TcpLanguage
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_framing import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.types import N150
from nclient.protocol.wire_state import WireState, tcp_wire_state
from nclient.recording.recorder import TCP
from nserver_emu.control.commands import answer_line
from nserver_emu.server.connection import ConnectionHandler
from nserver_emu.server.ownership import MOTIONS
from nserver_emu.server.session import Session
from nserver_emu.viewer.error_boundary import Guard
from nserver_emu.viewer.hub import Hub, Viewer
from nserver_emu.viewer.localization import published
from nserver_emu.viewer.messages import DEAD_MAN_S, LOOKING, VERSION, BadMessage, Message, from_page, to_page
from nserver_emu.viewer.traffic import Listening

if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon

log = logging.getLogger(__name__)

ALWAYS_MOVE: Final = frozenset({"zr", "lp"})
"""What moves a robot, or lets it go, without an argument."""
Answer = dict[str, Any]
Then = Callable[[Answer], None]


class Hand(ConnectionHandler):
    """One viewer's connection to one robot."""

    line = "viewer"

    def __init__(self, daemon: Daemon, name: str) -> None:
        super().__init__(daemon)
        self._handler = daemon.handler
        self.session = Session(daemon.handler.answer, name)
        self._recorder = daemon.recorder.open(name, TCP, N150)
        self._wire_state = tcp_wire_state(N150)
        self._framer = TcpFramer(reply_bounds, wide=False)
        self._waiting: deque[tuple[str, Then]] = deque()
        daemon.connections.add(self)

    def connect(self, robot_id: int) -> bool:
        """Tie the hand to a robot; False where there is none of that number."""
        found: list[Answer] = []
        self.call("connect_robot", [robot_id, 0], found.append)
        return bool(found and found[0]["ok"] and found[0]["values"][0])

    def call(self, name: str, args: list[int], then: Then) -> None:
        """Say a command; `then` gets the answer, at once or when it is there."""
        try:
            request = codec.tcp_request(Call(name, tuple(args)))
        except (NomadError, TypeError, ValueError) as error:
            then({"ok": False, "error": f"{name}: {error}"})
            return
        self._waiting.append((name, then))
        self.data_received(request)

    def close(self) -> None:
        """The page is gone, or the daemon ends: what moves by this hand stops, what was asked is not answered any
        more. Twice is fine."""
        if self not in self._server.connections:
            return
        self._cancel_timers()
        self._server.connections.discard(self)
        self._handler.on_disconnect(self.session.context)
        self._recorder.close()
        self.session.closing = True
        while self._waiting:
            name, then = self._waiting.popleft()
            then({"ok": False, "error": f"{name}: the connection to the robot broke off"})

    def _write(self, data: bytes) -> None:
        for frame in self._framer.receive(data):
            if not isinstance(frame, TcpFrame) or not self._waiting:
                log.error("%s: hung up: %r answers nothing that was asked", self.session.name, frame)
                self.close()
                return
            name, then = self._waiting.popleft()
            then(_answer(name, codec.read_tcp_reply(BY_NAME[name], frame, self._wire_state)))

    def _install_faults(self) -> None:
        """None here, whatever plan is in force."""

    def _language(self) -> Language:
        return TcpLanguage(False)

    def _set_reading(self, on: bool) -> None:
        """Nothing is read from anywhere: who calls is heard."""

    def _close_port(self) -> None:
        self.close()

    def _abort(self) -> None:
        self.close()


def _answer(name: str, reply: Reply) -> Answer:
    if reply.kind == "error":
        return {"ok": False, "code": reply.values[0], "error": f"{name}: {REFUSALS.get(reply.values[0], 'refused')}"}
    return {"ok": True, "values": list(reply.values)}


class Hands:
    """The hands of one viewer. `now` is real time in seconds, handed in."""

    def __init__(self, daemon: Daemon, name: str, guard: Guard) -> None:
        self._daemon = daemon
        self._guard = guard
        self.name = name
        self._hands: dict[int, Hand] = {}
        self._driven: dict[int, float] = {}

    def call(self, robot_id: int, name: str, args: list[int], then: Then) -> None:
        """Say a command to a robot."""
        hand = self._hands.get(robot_id)
        if hand is None or hand.session.closing:
            hand = Hand(self._daemon, f"{self.name} on robot {robot_id}")
            if not hand.connect(robot_id):
                hand.close()
                then({"ok": False, "error": f"there is no robot {robot_id}"})
                return
            self._hands[robot_id] = hand
        self._driven.pop(robot_id, None)
        hold = self._daemon.emulator.estop.get(robot_id)
        if hold is not None and (name in ALWAYS_MOVE or (name in MOTIONS and any(args))):
            error = f"robot {robot_id} is held by {hold.by}: release it first"
            then({"ok": False, "held": hold.by, "error": error})
            return
        hand.call(name, args, then)

    def drive(self, robot_id: int, args: list[int], now: float, then: Then) -> None:
        """Drive at these velocities, for as long as it is said again in time."""
        self.call(robot_id, "vm", args, then)
        if any(args) and self._daemon.emulator.estop.get(robot_id) is None:
            self._driven[robot_id] = now + DEAD_MAN_S

    def drives(self, robot_id: int) -> bool:
        """Whether a robot is driven by hand now."""
        return robot_id in self._driven

    def tick(self, now: float) -> None:
        """Real time has passed: whoever fell silent lets go."""
        for robot_id in [robot_id for robot_id, until in self._driven.items() if now >= until]:
            with self._guard.over("stopping a robot", self.name):
                self._let_go(robot_id)

    def close(self) -> None:
        """The page is gone."""
        self._driven.clear()
        while self._hands:
            _, hand = self._hands.popitem()
            with self._guard.over("letting a robot go", self.name):
                hand.close()

    def _let_go(self, robot_id: int) -> None:
        """Stop a robot: by a word or, where that goes wrong, by hanging up, which stops what this hand moves."""
        del self._driven[robot_id]
        try:
            self.call(robot_id, "st", [], lambda _: None)
        except Exception:
            self._hands.pop(robot_id).close()
            raise


if TYPE_CHECKING:
    from nserver_emu.server.daemon import Daemon


STALE_S: Final = 60.0
"""Real seconds after which an estimate is no news to a newcomer any more."""


class Desk:
    """What all viewers share: the daemon, who looks, what was clicked, where to go."""

    def __init__(self, daemon: Daemon, hub: Hub) -> None:
        self.daemon = daemon
        self.hub = hub
        self.guard = Guard()
        self._asked: dict[int, int] = {}
        self.waypoints: dict[int, list[list[float]]] = {}
        """Where each robot is to go, as set at a page."""
        self._waypoints_set: Counter[int] = Counter()
        self._hands: dict[Viewer, Hands] = {}
        self._published: dict[int, tuple[float, Message]] = {}
        self.listening = Listening(daemon.recorder, self._terms_of, lambda: daemon.emulator.simulation.time_s)
        daemon.recorder = self.listening

    def arrive(self, now: float, *, may_act: bool, watch_token: str = "") -> Viewer:
        """A page was opened."""
        viewer = self.hub.join(may_act=may_act)
        viewer.tell(to_page("hello", version=VERSION, name=viewer.name, may_act=may_act,
                            watch_token=watch_token if may_act else None, waypoints=self.waypoints,
                            lines=dict(self.daemon.lines()) if may_act else {}))
        viewer.tell(to_page("asked", robots=self._asked))
        for heard, told in self._published.values():
            if now - heard < STALE_S:
                viewer.tell(to_page("localization", **told, age_s=round(now - heard, 1)))
        self._hands[viewer] = Hands(self.daemon, viewer.name, self.guard)
        self._open_clicks()
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """It is gone; what it drove stops."""
        self.hub.leave(viewer)
        self._hands.pop(viewer).close()
        self.listening.watched = self.hub.watch_traffic
        self._open_clicks()

    def tick(self, now: float) -> None:
        """Real time has passed: first of all, who drove by hand and fell silent lets go."""
        for hands in self._hands.values():
            hands.tick(now)
        with self.guard.over("what programs ask for"):
            self._tell_asked()
        with self.guard.over("the traffic"):
            self._tell_traffic()

    def close(self) -> None:
        """Nobody looks any more."""
        self.daemon.recorder = self.listening.inner

    def hear(self, viewer: Viewer, text: str, now: float) -> None:
        """Do what a page says. Whatever goes wrong is an answer, and costs nobody else."""
        try:
            message = from_page(text)
        except BadMessage as error:
            self._refuse(viewer, error.number, str(error))
            return
        number = message.get("id")
        if message["do"] not in LOOKING and not viewer.may_act:
            self._refuse(viewer, number, "this link only looks")
            return

        def failed(error: Exception) -> None:
            self._refuse(viewer, number, f"a fault of the daemon, its log says where: {error!r}")

        with self.guard.over("what a page says", viewer.name, failed):
            try:
                _DOES[message["do"]](self, viewer, message, now)
            except BadMessage as error:
                self._refuse(viewer, number, str(error))

    def publish(self, text: str, now: float) -> Message:
        """What a localizer thinks, for all to see; where it is to go. Raises BadMessage."""
        told = published(text)
        robot = told["robot"]
        if robot not in self.daemon.emulator.simulation.robots:
            raise BadMessage(f"there is no robot {robot}")
        if told.pop("began") and self.waypoints.get(robot):
            self.set_waypoints(robot, [])
        self._published[robot] = now, told
        self.hub.tell(to_page("localization", **told, age_s=0.0))
        return {"waypoints": self.waypoints.get(robot), "set": self._waypoints_set[robot]}

    def set_waypoints(self, robot: int, points: list[list[float]]) -> None:
        """Somebody says where a robot is to go."""
        self.waypoints[robot] = points
        self._waypoints_set[robot] += 1
        self.hub.tell(to_page("waypoints", robot=robot, points=points))

    def others(self, viewer: Viewer, robot: int) -> list[str]:
        """The names of the other viewers that drive a robot by hand now."""
        return [hands.name for other, hands in self._hands.items() if other is not viewer and hands.drives(robot)]

    def robots(self, message: Message) -> list[int]:
        """The robots that a message is about: the one it names, or all. Raises BadMessage."""
        there, named = list(self.daemon.emulator.simulation.robots), message.get("robot")
        if named is not None and named not in there:
            raise BadMessage(f"there is no robot {named}; there are {', '.join(map(str, there))}")
        return there if named is None else [named]

    def hands(self, viewer: Viewer) -> Hands:
        """What this viewer does things with."""
        return self._hands[viewer]

    def _refuse(self, viewer: Viewer, number: int | None, error: str) -> None:
        viewer.tell(to_page("answer", id=number, ok=False, error=error))

    def _tell_asked(self) -> None:
        asked = self.daemon.emulator.pose_requests.counts()
        if asked != self._asked:
            self._asked = asked
            self.hub.tell(to_page("asked", robots=asked))

    def _tell_traffic(self) -> None:
        rows, missed, self.listening.missed = self.listening.rows(), self.listening.missed, 0
        if rows:
            self.hub.tell(to_page("traffic", rows=rows, missed=missed), traffic=True)

    def _terms_of(self, name: str) -> WireState | None:
        """What a connection has agreed, between two of its requests."""
        for talker in self.daemon.connections:
            session = talker.session
            if session.name == name:
                return None if session.unfinished or session.ready or session.waiting else session.context.wire_state
        return None

    def _open_clicks(self) -> None:
        self.daemon.emulator.pose_requests.open = any(viewer.may_act for viewer in self.hub.viewers)


def _seen(_desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    viewer.saw(message["frame"])


def _watch(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    viewer.traffic, viewer.laser, viewer.whose_laser = message["traffic"], message["laser"], message.get("robot")
    desk.listening.watched = desk.hub.watch_traffic


def _call(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    desk.hands(viewer).call(message["robot"], message["call"], message["args"], _teller(viewer, message["id"]))


def _drive(desk: Desk, viewer: Viewer, message: Message, now: float) -> None:
    robot, tell = message["robot"], _teller(viewer, message["id"])
    others = desk.others(viewer, robot)
    desk.hands(viewer).drive(robot, message["args"], now, lambda answer: tell(answer | {"others": others}))


def _stop(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    desk.daemon.hold(desk.robots(message), viewer.name)
    _tell_held(desk, viewer, message)


def _release(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    desk.daemon.release(desk.robots(message))
    _tell_held(desk, viewer, message)


def _tell_held(desk: Desk, viewer: Viewer, message: Message) -> None:
    _teller(viewer, message["id"])({"ok": True, "held": desk.daemon.emulator.estop.as_dict()})


def _control(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    request = json.dumps({"command": message["command"], "argument": message.get("argument")})
    answer: dict[str, Any] = json.loads(answer_line(desk.daemon, request.encode()))
    _teller(viewer, message["id"])(answer)


def _click(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    x, y, steer, turret = message["pose"]
    if not desk.daemon.emulator.pose_requests.answer(message["robot"], (x, y, steer, turret)):
        viewer.tell(to_page("answer", id=None, ok=False, error=f"nobody asks for a pose of robot {message['robot']}"))


def _waypoints(desk: Desk, _viewer: Viewer, message: Message, _now: float) -> None:
    desk.set_waypoints(message["robot"], message["points"])


def _teller(viewer: Viewer, number: int) -> Callable[[Answer], None]:
    """Who tells the viewer the answer to what it asked under this number."""
    return lambda answer: viewer.tell(to_page("answer", id=number, **answer))


_DOES: Final[dict[str, Callable[[Desk, Viewer, Message, float], None]]] = {
    "seen": _seen, "watch": _watch, "call": _call, "drive": _drive, "stop": _stop, "release": _release,
    "control": _control, "click": _click, "waypoints": _waypoints,
}  # fmt: skip
