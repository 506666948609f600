"""Takes what a page says and has it done: the one table of what `do` does. No socket; real time is handed in.

Rules: whoever only looks is told so when it wants more. What goes wrong is told to who asked, and costs nobody else.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from nclient.protocol.terms import Terms
from nserver_emu.server.control.control import answer_line
from nserver_emu.viewer.guard import Guard
from nserver_emu.viewer.hand import Answer, Hands
from nserver_emu.viewer.hub import Hub, Viewer
from nserver_emu.viewer.localization import published
from nserver_emu.viewer.protocol import LOOKING, VERSION, BadMessage, Message, from_page, to_page
from nserver_emu.viewer.traffic import Listening

if TYPE_CHECKING:
    from nserver_emu.server.ports.daemon import Daemon


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
        asked = self.daemon.emulator.clicks.asked()
        if asked != self._asked:
            self._asked = asked
            self.hub.tell(to_page("asked", robots=asked))

    def _tell_traffic(self) -> None:
        rows, missed, self.listening.missed = self.listening.rows(), self.listening.missed, 0
        if rows:
            self.hub.tell(to_page("traffic", rows=rows, missed=missed), traffic=True)

    def _terms_of(self, name: str) -> Terms | None:
        """What a connection has agreed, between two of its requests."""
        for talker in self.daemon.connections:
            session = talker.session
            if session.name == name:
                return None if session.unfinished or session.ready or session.waiting else session.visit.terms
        return None

    def _open_clicks(self) -> None:
        self.daemon.emulator.clicks.open = any(viewer.may_act for viewer in self.hub.viewers)


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
    _teller(viewer, message["id"])({"ok": True, "held": desk.daemon.emulator.holds.told()})


def _control(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    request = json.dumps({"command": message["command"], "argument": message.get("argument")})
    answer: dict[str, Any] = json.loads(answer_line(desk.daemon, request.encode()))
    _teller(viewer, message["id"])(answer)


def _click(desk: Desk, viewer: Viewer, message: Message, _now: float) -> None:
    x, y, steer, turret = message["pose"]
    if not desk.daemon.emulator.clicks.answer(message["robot"], (x, y, steer, turret)):
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
