"""Connections to robots from inside the server: of a page, and of what ROS programs send.

    ViewerClients.call ──> ViewerClient.call ──> bytes ──> Session ──> reply of simulation or real robot ──> bytes

What a page does to a robot is sent as a client of that robot would send it, so that the same rules apply: one
connection per page and robot, opened at the first use, recorded as any client's is. Closing the page stops what it
drives. Driving must be repeated in time, or the robot stops. Injected faults do not apply to these connections, since
a stop must arrive.

Isolation of viewers: an exception that concerns one viewer is logged, and all others continue.

This is the outermost edge of the page's server, and the only place that catches every exception. Repeated errors of one
kind in one place are logged once and then counted, since twenty pictures a second would fill a disk.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Final

from nclient.errors import REFUSALS, NomadError
from nclient.faults.inject import Language, TcpLanguage
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, tcp_wire_state
from nclient.recording.recorder import TCP
from nserver_emu.server.connection import ConnectionHandler, ConnectionState
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.estop import MOTIONS
from nserver_emu.server.session import Session
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S

log = logging.getLogger(__name__)

OnError = Callable[[Exception], None]


@dataclass(slots=True)
class ErrorBoundary:
    """Catches, logs and counts exceptions of a server; `counts` by place and exception type."""

    server: str = "page"
    counts: Counter[tuple[str, type[Exception]]] = field(default_factory=Counter)

    @contextmanager
    def guard(self, place: str, viewer: str = "", on_error: OnError = lambda _: None) -> Iterator[None]:
        """Catch the exceptions of the block, count them, log the first of its kind in this place, and pass them on.

        Parameters
        ----------
        place : what the block does, for the log.
        viewer : name of the viewer that it concerns, for the log.
        on_error : called with the exception.
        """
        try:
            yield
        except Exception as error:
            kind = place, type(error)
            self.counts[kind] += 1
            if self.counts[kind] == 1:
                suffix = f" of {viewer}" if viewer else ""
                log.error("%s: %s%s: internal error, all else goes on (logged once)", self.server, place, suffix,
                          exc_info=error)
            on_error(error)


ALWAYS_MOVE: Final = frozenset({"zr", "lp"})
"""Commands without arguments that move a robot or switch its motors off."""
Answer = dict[str, Any]
OnAnswer = Callable[[Answer], None]
ToAnswer = Callable[[str, Reply], Answer]


class ViewerClient(ConnectionHandler):
    """Connection of one viewer to one robot."""

    line = "viewer"
    # The page waits for its turn before it sends a call (server.py).
    is_scheduled = False

    def __init__(self, daemon: Daemon, name: str, to_answer: ToAnswer) -> None:
        super().__init__(daemon)
        self._to_answer = to_answer
        self._handler = daemon.handler
        self.session = Session(daemon.handler.answer, name)
        # Over TCP the layout of messages does not depend on the model.
        self._recorder = daemon.recorder.open(name, TCP, N150)
        self._wire_state = tcp_wire_state(N150)
        self._framer = TcpFramer(reply_bounds, wide=False)
        self._waiting: deque[tuple[str, OnAnswer]] = deque()
        daemon.connections.add(self)

    def connect(self, robot_id: int) -> bool:
        """Connect to a robot; return False if there is none of that number."""
        # connect_robot is answered at once, so the reply is there when `call` returns.
        found: list[Answer] = []
        self.call("connect_robot", [robot_id, 0], found.append)
        return bool(found and found[0]["ok"] and found[0]["values"][0])

    def call(self, name: str, args: list[int], on_answer: OnAnswer) -> None:
        """Make a call; `on_answer` gets the reply, now or when it arrives."""
        try:
            # The call becomes bytes and its reply is parsed from bytes, exactly as for a client on a socket.
            request = codec.encode_tcp_request(Call(name, tuple(args)))
        except (NomadError, TypeError, ValueError) as error:
            on_answer({"ok": False, "error": f"{name}: {error}"})
            return
        self._waiting.append((name, on_answer))
        self.data_received(request)

    def close(self) -> None:
        """Close the connection: stop what it moves, answer pending calls with an error. May be called twice."""
        if self.state is ConnectionState.CLOSED:
            return
        # 1. No more turns; what this connection moves is stopped by on_disconnect.
        self.state = ConnectionState.CLOSED
        self._cancel_timers()
        self._server.connections.discard(self)
        self._handler.on_disconnect(self.session.context)
        self._recorder.close()
        # 2. Calls whose replies can no longer come are answered with an error.
        self.session.closing = True
        while self._waiting:
            name, on_answer = self._waiting.popleft()
            on_answer({"ok": False, "error": f"{name}: the connection to the robot was closed"})

    def _write(self, data: bytes) -> None:
        for frame in self._framer.receive(data):
            # A reply without request means an internal error: later replies would be assigned wrongly.
            if not isinstance(frame, TcpFrame) or not self._waiting:
                log.error("%s: closed: %r answers no request", self.session.name, frame)
                self.close()
                return
            name, on_answer = self._waiting.popleft()
            on_answer(self._to_answer(name, codec.decode_tcp_reply(BY_NAME[name], frame, self._wire_state)))

    def _install_faults(self) -> None:
        """Do nothing: faults do not apply here."""

    def _language(self) -> Language:
        return TcpLanguage(False)

    def _set_reading(self, on: bool) -> None:
        """Do nothing: there is no socket to read."""


def _answer(name: str, reply: Reply) -> Answer:
    if reply.kind == "error":
        return {"ok": False, "code": reply.values[0], "error": f"{name}: {REFUSALS.get(reply.values[0], 'refused')}"}
    return {"ok": True, "values": list(reply.values)}


class ViewerClients:
    """Connections of one viewer, one per robot. `now` is real time in seconds.

    `to_answer` makes the answer of a call's name and reply; by default the one that pages get.
    """

    def __init__(self, daemon: Daemon, name: str, error_boundary: ErrorBoundary, to_answer: ToAnswer = _answer) -> None:
        self._to_answer = to_answer
        self._daemon = daemon
        self._error_boundary = error_boundary
        self.name = name
        self._clients: dict[int, ViewerClient] = {}
        # When robots that are driven stop, and velocities: those not answered yet, and the latest ones after them.
        self._driven: dict[int, float] = {}
        self._unanswered: set[int] = set()
        self._next: dict[int, tuple[list[int], float, OnAnswer]] = {}

    def call(self, robot_id: int, name: str, args: list[int], on_answer: OnAnswer) -> None:
        """Make a call to a robot."""
        # 1. The connection to this robot, opened at the first call.
        client = self._clients.get(robot_id)
        if client is None or client.session.closing:
            client = ViewerClient(self._daemon, f"{self.name} on robot {robot_id}", self._to_answer)
            if not client.connect(robot_id):
                client.close()
                on_answer({"ok": False, "error": f"there is no robot {robot_id}"})
                return
            self._clients[robot_id] = client
        # 2. Any other call ends continuous driving.
        self._driven.pop(robot_id, None)
        self._skip_next(robot_id)
        # 3. A held robot accepts no motion; velocities of 0 are no motion.
        hold = self._daemon.emulator.estop.get(robot_id)
        if hold is not None and (name in ALWAYS_MOVE or (name in MOTIONS and any(args))):
            error = f"robot {robot_id} is held by {hold.by}: release it first"
            on_answer({"ok": False, "held": hold.by, "error": error})
            return
        client.call(name, args, on_answer)

    def drive(self, robot_id: int, args: list[int], now: float, on_answer: OnAnswer) -> None:
        """Drive at these velocities; the robot stops if the next call does not come within DRIVE_TIMEOUT_S.

        A real robot may be slower than its driver: of velocities that come before the last ones were answered only the
        latest are sent, so that neither they nor a stop wait in a queue. The others are answered without values.
        """
        if robot_id in self._unanswered:
            self._skip_next(robot_id)
            self._next[robot_id] = args, now, on_answer
        else:
            self._unanswered.add(robot_id)

            def answered(answer: Answer) -> None:
                self._unanswered.discard(robot_id)
                on_answer(answer)
                if robot_id in self._next:
                    self.drive(robot_id, *self._next.pop(robot_id))

            try:
                self.call(robot_id, "vm", args, answered)
            except Exception:
                self._unanswered.discard(robot_id)
                raise
        # Velocities of 0 need no repetition.
        if any(args) and self._daemon.emulator.estop.get(robot_id) is None:
            self._driven[robot_id] = now + DRIVE_TIMEOUT_S

    def _skip_next(self, robot_id: int) -> None:
        """Answer velocities that wait, instead of sending them."""
        if robot_id in self._next:
            *_, on_answer = self._next.pop(robot_id)
            on_answer({"ok": True, "values": []})

    def is_driving(self, robot_id: int) -> bool:
        """Return True while this viewer drives the robot."""
        return robot_id in self._driven

    def tick(self, now: float) -> None:
        """Stop robots whose driving was not repeated in time."""
        # A copy, because stopping changes the dictionary.
        for robot_id in [robot_id for robot_id, until in self._driven.items() if now >= until]:
            with self._error_boundary.guard("stopping a robot", self.name):
                self._stop_driving(robot_id)

    def close(self) -> None:
        """Close all connections."""
        self._driven.clear()
        self._next.clear()
        while self._clients:
            _, client = self._clients.popitem()
            with self._error_boundary.guard("closing a connection", self.name):
                client.close()

    def _stop_driving(self, robot_id: int) -> None:
        """Stop a robot: by st or, where that fails, by closing the connection, which stops what it moves."""
        del self._driven[robot_id]
        try:
            self.call(robot_id, "st", [], lambda _: None)
        except Exception:
            self._clients.pop(robot_id).close()
            raise
