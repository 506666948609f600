"""A session with an Nserver over TCP: one request, one reply, in order.

    connect_robot -> ct, everything on -> calls ... -> disconnect_robot

A reply is never taken for that of another call. After a timeout, a lost connection, or a reply that does not fit its
call the session is closed, and later calls report why; after a refusal it continues. An exchange that is interrupted
(Ctrl-C) leaves a reply outstanding, which is read and dropped before the next one: the program can still stop its
robot.
"""

import os
import time
from functools import lru_cache
from typing import Final

from nclient.backends.base import REAL_TIME, SPEED_SLOT, LinkStatistics
from nclient.errors import HELD, ConnectionLost, ReplyTimeout, RobotHeld, RobotRefused, WireError
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import Call, Command
from nclient.protocol.replies import STATE, Reply, TcpLayout, text_of
from nclient.protocol.types import EVERYTHING, N150, Mask, Model, tcp_wire_state
from nclient.transports.stream import ByteStream, Deadline, on_error

DEFAULT_TIMEOUT_S: Final = 5.0
"""Maximum time for a reply."""
ORDINARY_S: Final = 1.0
"""Commands that a robot answers within this time have the session's timeout, slower ones their own."""
CLICK_S: Final = 120.0
"""get_robot_conf may wait for a click in the server's window."""
_NO_REPLY: Final = Reply("none")
_PORT_0_MEANS: Final = {
    "connect_robot": "the server has no robot number {}",
    "create_robot": "the server makes no robot number {}: no room for one more, or no more are made (nserver -v)",
}
"""Reasons for port 0 in the replies of the commands that connect."""
_REJECTED_HINT: Final = " Does it accept this machine (--allow, --limit-connections)?"
"""A server that rejects a connection closes it without a message."""
_NO_NSERVER_HINT: Final = (
    ". Is it an Nserver that answers there? Its port is 7019; a robot's own line is robotd://HOST:PORT"
)
"""For a first reply that no Nserver would send."""

_encode = lru_cache(maxsize=256)(codec.encode_tcp_request)
"""Cached: programs repeat the same few requests."""


class NserverBackend:
    """A session with an Nserver about one robot. Connects at once.

    Parameters
    ----------
    stream
        The connection; closed if connecting fails.
    robot_id
        Number of the robot on the server.
    model
        The robot's model; the protocol does not transmit it.
    timeout_s
        Maximum time for a reply, default 5 s; ws, zr and special packets have time of their own.
    create
        True to create the robot first.
    pid
        Process id sent to the server, default that of this process.
    link
        Statistics to count in; None counts nothing.

    Raises
    ------
    ConnectionLost, ReplyTimeout
        If the server closes the connection or does not reply.
    RobotRefused
        If the server has no robot of that number.
    """

    def __init__(self, stream: ByteStream, *, robot_id: int = 1, model: Model = N150,
                 timeout_s: float | None = None, create: bool = False, pid: int | None = None,
                 link: LinkStatistics | None = None) -> None:
        self.timeout_s = DEFAULT_TIMEOUT_S if timeout_s is None else timeout_s
        self.robot_id = robot_id
        self.link = link
        """Statistics of the link, None if nothing is counted."""
        self._pid = os.getpid() if pid is None else pid
        self._stream = stream
        self.wire_state = tcp_wire_state(model)
        """Model, sensor mask and laser mode, which determine the format of replies."""
        self._framer = TcpFramer(reply_bounds, wide=False)
        # The last reply, its bytes, and what else its form depends on.
        self._last_frame: TcpFrame | None = None
        self._last_format: tuple[TcpLayout, Mask, int] | None = None
        self._last_reply = _NO_REPLY
        self._outstanding = 0
        """Replies that are still to come."""
        self._slowness = 1.0
        """Real time per server time, at least 1."""
        self._closed_because: str | None = None
        with on_error(lambda: self._finish("connecting failed")):
            connecting = Call("create_robot" if create else "connect_robot", (robot_id, self._pid))
            # The port is where the server accepts connections, the greeting the state at that time.
            self.port = self.execute(connecting).values[0]
            self.greeting = self.execute(Call("ct", EVERYTHING.smask))

    @property
    def closed(self) -> bool:
        """Return True if the session is over."""
        return self._closed_because is not None

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply. Raises as `Backend.execute`."""
        # 1. Reject what cannot be sent.
        if self._closed_because is not None:
            raise ConnectionLost(f"{call.name}: {self._closed_because}; connect again")
        row = codec.find_command(call.name)
        if row.tcp_type is None:
            raise RobotRefused(call.name, None, "exists only on a robot's own line")
        request = _encode(call)

        # 2. Exchange. The request may change the format of its own reply (ct, conf_ls).
        codec.update_from_request(call, self.wire_state)
        if not row.has_tcp_reply:
            return self._disconnect(request)
        exchange = self._exchange if self.link is None else self._counted_exchange
        frame = exchange(call, request, self._reply_timeout_s(row, call))

        # 3. Decode, and raise what the server refused. While nothing changes, the server sends the same state again.
        format_key = (row.tcp_reply, self.wire_state.mask, self.wire_state.laser_width)
        if frame != self._last_frame or format_key != self._last_format or row.tcp_reply is not STATE:
            try:
                self._last_reply = codec.decode_tcp_reply(row, frame, self.wire_state)
            except WireError as error:
                self._finish(f"{row.name} was answered by a reply that does not fit it")
                raise ConnectionLost(f"{row.name}: {error}; the connection was closed") from error
            self._last_frame, self._last_format = frame, format_key
        self._evaluate(call, self._last_reply)
        return self._last_reply

    def close(self) -> None:
        """Send disconnect_robot, unless a reply is outstanding, and close the connection."""
        if self._closed_because is None and not self._outstanding:
            self.execute(Call("disconnect_robot", (self.robot_id, self._pid)))
        self._finish("this side closed the connection")

    def _exchange(self, call: Call, request: bytes, timeout_s: float) -> TcpFrame:
        """Send a request and return the frame of its reply."""
        sent = False
        # Counted before sending: a count too high ends in a timeout, one too low in a reply of the wrong call.
        self._outstanding += 1
        try:
            self._stream.send(request)
            sent = True
            return self._next_reply(Deadline(time.monotonic() + timeout_s))
        except ReplyTimeout as error:
            # A late reply would be taken for that of the next call.
            self._finish(f"{call.name} was not answered, and a late answer must not be taken for another's")
            raise ReplyTimeout(
                f"{call.name}, with {timeout_s:g} s to answer: {error}; the connection was closed"
            ) from None
        except WireError as error:
            self._finish(f"{call.name} was answered by a malformed reply")
            hint = _NO_NSERVER_HINT if call.name in _PORT_0_MEANS else ""
            raise ConnectionLost(f"{call.name}: {error}; the connection was closed{hint}") from error
        except ConnectionLost as error:
            self._finish(str(error))
            hint = _REJECTED_HINT if call.name in _PORT_0_MEANS else ""
            raise ConnectionLost(f"{call.name}: {self._closed_because}{hint}") from error
        finally:
            if not sent:
                self._finish(f"{call.name} was cut off while it was sent")

    def _counted_exchange(self, call: Call, request: bytes, timeout_s: float) -> TcpFrame:
        assert self.link is not None
        self.link.exchanges += 1
        start_s = time.monotonic()
        try:
            frame = self._exchange(call, request, timeout_s)
        except ReplyTimeout:
            self.link.timeouts += 1
            raise
        self.link.frames += 1
        self.link.record_latency(time.monotonic() - start_s)
        return frame

    def _next_reply(self, deadline: Deadline) -> TcpFrame:
        """Return the last outstanding reply and drop those before it. Raises WireError for more or other bytes."""
        while True:
            # A reply counts only if it is the last one due, and nothing follows it.
            frames = self._framer.receive(self._stream.receive(deadline))
            for frame in frames:
                if not isinstance(frame, TcpFrame):
                    raise WireError(frame.reason)
                self._outstanding -= 1
                if self._outstanding == 0 and frame is frames[-1] and not self._framer.pending:
                    return frame
            if self._outstanding <= 0:
                raise WireError("more replies came than requests were sent")

    def _evaluate(self, call: Call, reply: Reply) -> None:
        """Raise RobotRefused for a refusal; record which robot is connected and how fast its time runs."""
        if reply.kind == "error":
            if reply.values[0] == HELD:
                raise RobotHeld(call.name, self.robot_id, self._holder())
            raise RobotRefused(call.name, reply.values[0])
        # The reply to connecting is a port, 0 if there is no such robot.
        if call.name in _PORT_0_MEANS:
            if not reply.values[0]:
                raise RobotRefused(call.name, None, _PORT_0_MEANS[call.name].format(call.args[0]))
            self.robot_id = call.args[0]
        elif reply.slots.get(SPEED_SLOT, 0) > 0:
            self._slowness = max(1.0, REAL_TIME / reply.slots[SPEED_SLOT])

    def _holder(self) -> str:
        """Return who holds the robot, which an ERROR reply does not say; empty if the server does not report it."""
        try:
            return text_of(self.execute(Call("held_by")).values)
        except RobotRefused:
            return ""

    def _reply_timeout_s(self, row: Command, call: Call) -> float:
        """Return the maximum time for a reply; motions take server time, which may run slower than real time."""
        # ws ends by its own timeout, in server time.
        if row.name == "ws":
            return self.timeout_s + float(max(0, call.args[3])) * self._slowness
        if row.name == "get_robot_conf":
            return max(self.timeout_s, CLICK_S)
        # zr, packets and the arm.
        if row.line_timeout_s > ORDINARY_S:
            return max(self.timeout_s, row.line_timeout_s * self._slowness)
        return self.timeout_s

    def _disconnect(self, request: bytes) -> Reply:
        try:
            self._stream.send(request)
        except ConnectionLost:
            pass  # disconnected already
        finally:
            self._finish("this side disconnected")
        return _NO_REPLY

    def _finish(self, reason: str) -> None:
        if self._closed_because is None:
            self._closed_because = reason
            self._stream.close()
