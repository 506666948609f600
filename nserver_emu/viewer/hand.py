"""A viewer's hand: what the page does to a robot is said as a client of that robot says it, so the same rules hold.

    call(name, args, then) ──> bytes ──> Session ──> answer of simulation or real robot ──> bytes ──> then(answer)

Rules: one connection a robot, made when it is first touched; it is on the recording as any client's is, and what it
drives stops when the page is gone. Who drives by hand says so again and again: silence stops the robot. Faults on
purpose are for lines and clients: no plan touches a hand, for what stops a robot must arrive.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from nclient.errors import REFUSALS, NomadError
from nclient.faults.language import Language, TcpLanguage
from nclient.protocol import language
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.models import N150
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_frame import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.terms import tcp_terms
from nclient.recording.follower import TCP
from nserver_emu.server.conversation.session import Session
from nserver_emu.server.ports.talker import Talker
from nserver_emu.server.stage.holds import MOTIONS
from nserver_emu.viewer.guard import Guard
from nserver_emu.viewer.protocol import DEAD_MAN_S

if TYPE_CHECKING:
    from nserver_emu.server.ports.daemon import Daemon

log = logging.getLogger(__name__)

ALWAYS_MOVE: Final = frozenset({"zr", "lp"})
"""What moves a robot, or lets it go, without an argument."""
Answer = dict[str, Any]
Then = Callable[[Answer], None]


class Hand(Talker):
    """One viewer's connection to one robot."""

    line = "viewer"

    def __init__(self, daemon: Daemon, name: str) -> None:
        super().__init__(daemon)
        self._behind = daemon.host
        self.session = Session(daemon.host.answer, name)
        self._tape = daemon.recorder.open(name, TCP, N150)
        self._terms = tcp_terms(N150)
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
            request = language.tcp_request(Call(name, tuple(args)))
        except (NomadError, TypeError, ValueError) as error:
            then({"ok": False, "error": f"{name}: {error}"})
            return
        self._waiting.append((name, then))
        self._came(request)

    def close(self) -> None:
        """The page is gone, or the daemon ends: what moves by this hand stops, what was asked is not answered any
        more. Twice is fine."""
        if self not in self._daemon.connections:
            return
        self._silence()
        self._daemon.connections.discard(self)
        self._behind.leave(self.session.visit)
        self._tape.close()
        self.session.closing = True
        while self._waiting:
            name, then = self._waiting.popleft()
            then({"ok": False, "error": f"{name}: the connection to the robot broke off"})

    def _send(self, data: bytes) -> None:
        for frame in self._framer.receive(data):
            if not isinstance(frame, TcpFrame) or not self._waiting:
                log.error("%s: hung up: %r answers nothing that was asked", self.session.name, frame)
                self.close()
                return
            name, then = self._waiting.popleft()
            then(_answer(name, language.read_tcp_reply(BY_NAME[name], frame, self._terms)))

    def _plug_in_faults(self) -> None:
        """None here, whatever plan is in force."""

    def _language(self) -> Language:
        return TcpLanguage(False)

    def _listen(self, on: bool) -> None:
        """Nothing is read from anywhere: who calls is heard."""

    def _hang_up(self) -> None:
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
        hold = self._daemon.emulator.holds.of(robot_id)
        if hold is not None and (name in ALWAYS_MOVE or (name in MOTIONS and any(args))):
            error = f"robot {robot_id} is held by {hold.by}: release it first"
            then({"ok": False, "held": hold.by, "error": error})
            return
        hand.call(name, args, then)

    def drive(self, robot_id: int, args: list[int], now: float, then: Then) -> None:
        """Drive at these velocities, for as long as it is said again in time."""
        self.call(robot_id, "vm", args, then)
        if any(args) and self._daemon.emulator.holds.of(robot_id) is None:
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
