"""An Nserver: its language over a stream of bytes. One request, one reply, in order.

    connect_robot ──> ct, all masks on ──> calls ... ──> disconnect_robot

Rules: an answer is never taken for another call's. After a time-out, a stream that ended, or an answer that does not
fit its call (ConnectionLost, caused by the WireError), the conversation is closed and says why from then on. After a
refusal it goes on. An exchange that was interrupted from outside (Ctrl-C) leaves a reply owed: it is read and dropped
before the next one's, so that a program can still stop its robot.
"""

from __future__ import annotations

import os
import time
from functools import lru_cache
from typing import Final

from nclient.backends.base import LinkStatistics
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol import codec
from nclient.protocol.commands import Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_framing import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.types import EVERYTHING, N150, Model
from nclient.protocol.wire_state import WireState, tcp_wire_state
from nclient.transports.stream import ByteStream, Deadline

DEFAULT_TIMEOUT_S = 5.0
"""How long a server may take to answer."""
ORDINARY_S = 1.0
"""Commands that the robot itself answers within this are given the time-out that was set; the others their own."""
CLICK_S = 120.0
"""get_robot_conf may wait for a click in the server's window."""
SPEED_SLOT, REAL_TIME = 0, 10
_NO_ANSWER = Reply("none")
_REFUSED_PORT: Final = {
    "connect_robot": "the server has no robot number {}",
    "create_robot": "the server makes no robot number {}: no room for one more, or no more are made (nserver -v)",
}
"""What port 0 means."""

_request = lru_cache(maxsize=256)(codec.encode_tcp_request)
"""Programs ask the same few things again and again."""

_TURNED_AWAY: Final = " Does it let this machine in (--allow, --limit-connections)?"
"""A server that turns a newcomer away says nothing: it only closes."""

_NO_NSERVER: Final = ". Is it an Nserver that answers there? Its port is 7019; a robot's own line is robotd://HOST:PORT"
"""What answers to a first call, and is none of an Nserver's answers."""

class NserverBackend:
    """A conversation with an Nserver about one robot; connects at once (`create`: to a robot that it then makes).

    `timeout_s`: how long it may take to answer (zr 120 s, ws its own time-out more, special packets 30 s). Raises
    ConnectionLost, ReplyTimeout, or RobotRefused where there is no robot of that number; the stream is then closed.
    `link`: to count in, which is for those who ask for it: nearly nothing goes wrong over TCP.
    """

    def __init__(
        self,
        stream: ByteStream,
        *,
        robot_id: int = 1,
        model: Model = N150,
        timeout_s: float = DEFAULT_TIMEOUT_S,
        create: bool = False,
        pid: int | None = None,
        link: LinkStatistics | None = None,
    ) -> None:
        self.timeout_s = timeout_s
        self.robot_id = robot_id
        self._link = link
        self._pid = os.getpid() if pid is None else pid
        self._stream = stream
        self._wire_state = tcp_wire_state(model)
        self._framer = TcpFramer(reply_bounds, wide=False)
        self._owed = 0
        self._slowness = 1.0
        self._over: str | None = None
        try:
            joining = Call("create_robot" if create else "connect_robot", (robot_id, self._pid))
            self._port = self.execute(joining).values[0]
            self._greeting = self.execute(Call("ct", EVERYTHING.smask))
        except BaseException:
            self._finish("connecting failed")
            raise

    @property
    def wire_state(self) -> WireState:
        """Mask, laser shape and model of this conversation."""
        return self._wire_state

    @property
    def greeting(self) -> Reply:
        """The state that came with connecting."""
        return self._greeting

    @property
    def port(self) -> int:
        """The port that the server takes connections on, as it said when connecting."""
        return self._port

    @property
    def closed(self) -> bool:
        """Whether the conversation is over."""
        return self._over is not None

    @property
    def link(self) -> LinkStatistics | None:
        """Exchanges, their latencies and what wrappers add, where one was given to count in."""
        return self._link

    def execute(self, call: Call) -> Reply:
        """The answer to a call. Raises as Backend.execute says."""
        if self._over is not None:
            raise ConnectionLost(f"{call.name}: {self._over}; connect again")
        row = codec.find_command(call.name)
        if row.tcp_type is None:
            raise RobotRefused(call.name, None, "exists only on a robot's own line")
        request = _request(call)
        codec.update_from_request(call, self._wire_state)
        if not row.has_tcp_reply:
            return self._leave(request)
        exchange = self._exchange if self._link is None else self._counted
        reply = self._answer_of(row, exchange(call, request, self._patience_s(row, call)))
        self._judge(call, reply)
        return reply

    def close(self) -> None:
        """Say goodbye, unless an answer is outstanding, and leave."""
        if self._over is None and not self._owed:
            self.execute(Call("disconnect_robot", (self.robot_id, self._pid)))
        self._finish("this side closed the connection")

    def _exchange(self, call: Call, request: bytes, patience_s: float) -> TcpFrame:
        """The frame that answers. `_owed` rises first: too high ends in a time-out, too low in a mistake."""
        sent = False
        self._owed += 1
        try:
            self._stream.send(request)
            sent = True
            return self._next_answer(Deadline.after(patience_s))
        except ReplyTimeout as error:
            self._finish(f"{call.name} was not answered, and a late answer must not be taken for another's")
            raise ReplyTimeout(
                f"{call.name}, with {patience_s:g} s to answer: {error}; the connection was closed"
            ) from None
        except WireError as error:
            self._finish(f"{call.name} was answered by what makes no sense")
            hint = _NO_NSERVER if call.name in _REFUSED_PORT else ""
            raise ConnectionLost(f"{call.name}: {error}; the connection was closed{hint}") from error
        except ConnectionLost as error:
            self._finish(str(error))
            hint = _TURNED_AWAY if call.name in _REFUSED_PORT else ""
            raise ConnectionLost(f"{call.name}: {self._over}{hint}") from error
        finally:
            if not sent:
                self._finish(f"{call.name} was cut off while it was sent")

    def _counted(self, call: Call, request: bytes, patience_s: float) -> TcpFrame:
        assert self._link is not None
        self._link.exchanges += 1
        asked_s = time.monotonic()
        try:
            frame = self._exchange(call, request, patience_s)
        except ReplyTimeout:
            self._link.timeouts += 1
            raise
        self._link.frames += 1
        self._link.took(time.monotonic() - asked_s)
        return frame

    def _next_answer(self, deadline: Deadline) -> TcpFrame:
        """The last of the answers that are owed. Raises WireError when what comes is none, or too much."""
        while True:
            frames = self._framer.receive(self._stream.receive(deadline))
            for frame in frames:
                if not isinstance(frame, TcpFrame):
                    raise WireError(frame.reason)
                self._owed -= 1
                if self._owed == 0 and frame is frames[-1] and not self._framer.pending:
                    return frame
            if self._owed <= 0:
                raise WireError("more was answered than was asked")

    def _answer_of(self, row: Command, frame: TcpFrame) -> Reply:
        try:
            return codec.decode_tcp_reply(row, frame, self._wire_state)
        except WireError as error:
            self._finish(f"{row.name} was answered by what does not fit it")
            raise ConnectionLost(f"{row.name}: {error}; the connection was closed") from error

    def _judge(self, call: Call, reply: Reply) -> None:
        """Raise what the other end refused; remember how fast its time runs."""
        if reply.kind == "error":
            raise RobotRefused(call.name, reply.values[0])
        if call.name in _REFUSED_PORT:
            self._connected(call, reply.values[0])
        elif reply.slots.get(SPEED_SLOT, 0) > 0:
            self._slowness = max(1.0, REAL_TIME / reply.slots[SPEED_SLOT])

    def _connected(self, call: Call, port: int) -> None:
        if not port:
            raise RobotRefused(call.name, None, _REFUSED_PORT[call.name].format(call.args[0]))
        self.robot_id = call.args[0]

    def _patience_s(self, row: Command, call: Call) -> float:
        """How long to wait: motions are waited for in the server's time, which may run slower than ours."""
        if row.name == "ws":
            return self.timeout_s + float(max(0, call.args[3])) * self._slowness
        if row.name == "get_robot_conf":
            return max(self.timeout_s, CLICK_S)
        if row.line_timeout_s > ORDINARY_S:
            return max(self.timeout_s, row.line_timeout_s * self._slowness)
        return self.timeout_s

    def _leave(self, request: bytes) -> Reply:
        try:
            self._stream.send(request)
        except ConnectionLost:
            pass  # gone already, which is where we were going
        finally:
            self._finish("this side disconnected")
        return _NO_ANSWER

    def _finish(self, why: str) -> None:
        if self._over is None:
            self._over = why
            self._stream.close()
