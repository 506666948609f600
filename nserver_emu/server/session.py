"""What the first message of a connection gives away that says no CONNECT: how wide its sender's words are.

    32 bits   type, count | word   word   ...          a 64-bit client sends every word as
    64 bits   type, count | 0 word 0 word ...          four zero bytes and then its value

Rules: bytes in, an answer out. A word that is not 0 where a 64-bit client sends zeros tells for certain; zeros in all
those places tell nothing by themselves, but for a mask (ct), that a client begins with and that has bits in its first
byte. Nobody is kept waiting for bytes that do not have to come.

A conversation with one client, without I/O: bytes in, bytes out.

    receive(bytes) ──> framer ──> queue ──> answer(call, visit) ──> replies
                                                └─ later: tick() asks again until there is one

    Conversation    that course of things, in whatever language        Session    over TCP, with a CONNECT

An old client may go on over a second connection without another CONNECT: it is then taken for the one that
`acquaintance` knows, robot and word width. Its first message tells: it is a CONNECT or it is not (first_bytes.py).

Rules: one request, one reply, in order; a request behind one that is answered later waits its turn. Who answers is
handed in, so the same conversation serves a simulation and a gateway. Nothing here knows a socket or a clock.
Every bad request costs its sender an ERROR reply, or the connection once its stream has lost its frame.
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_framing import InvalidFrame, TcpFrame, TcpFramer, limit_words, request_bounds
from nclient.protocol.types import N150, Mask
from nclient.protocol.wire_state import WireState, tcp_wire_state
from nserver_emu.server.limits import Limits

_HEADER_BYTES: Final = 4
_WORD_BYTES: Final = 4
_MOST_WORDS: Final = 8
"""Words that are looked at, of a message that has more."""

_CONNECTS: Final = ("connect_robot", "create_robot", "disconnect_robot")
_CONNECT_TYPES: Final = frozenset(BY_NAME[name].tcp_type for name in _CONNECTS)
_MASK_TYPE: Final = BY_NAME["ct"].tcp_type


def has_header(head: bytes) -> bool:
    """Whether these first bytes tell all that they can."""
    if len(head) < _HEADER_BYTES:
        return len(head) >= 2 and (is_connect(head) or request_bounds(_type(head)) is None)
    bounds = request_bounds(_type(head))
    if is_connect(head) or bounds is None or not bounds[0] <= _count(head) <= bounds[1]:
        return True
    return len(head) >= _HEADER_BYTES + _WORD_BYTES * min(_count(head), _MOST_WORDS)


def is_connect(head: bytes) -> bool:
    """Whether the first message says by itself who comes."""
    return _type(head) in _CONNECT_TYPES


def sniff_word_size(head: bytes) -> bool | None:
    """True for words of 64 bits, False for 32, None where these bytes do not tell."""
    words = [head[at : at + _WORD_BYTES] for at in range(_HEADER_BYTES, len(head) - 3, _WORD_BYTES)]
    words = words[: _count(head)]
    if any(any(word) for word in words[::2]):
        return False
    return True if _type(head) == _MASK_TYPE and any(any(word) for word in words) else None


def _type(head: bytes) -> int:
    return int.from_bytes(head[:2], "big", signed=True)


def _count(head: bytes) -> int:
    return int.from_bytes(head[2:_HEADER_BYTES], "big")


log = logging.getLogger(__name__)

BAD_VALUES, NOT_CONNECTED, NOT_AVAILABLE, REFUSED = 2, 3, 4, 5
"""Codes of ERROR replies."""
CROWD = 100
_CONNECTS_SESSION = frozenset({"connect_robot", "create_robot", "disconnect_robot"})


class CachedStateReply(NamedTuple):
    """A state reply, and what it was made from: one look at the robot, on these terms."""

    look: object
    mask: Mask
    laser_mode: int
    reply: Reply


@dataclass(slots=True, eq=False)
class ConnectionContext:
    """What the server knows of one connection: whose robot, on what terms, and the State values last sent.

    told             the state last told on a robot's own line, where nothing else decides what a packet says
    laser_columns    how many columns of the laser count, 0: all; segments: threshold and gap in tenths of an inch and
                     fewest points of a laser line, in the order of conf_sg; None: as at power-on
    """

    wire_state: WireState = field(default_factory=lambda: tcp_wire_state(N150))
    robot_id: int | None = None
    kept: list[int] = field(default_factory=lambda: [0] * STATE_SIZE)
    told: CachedStateReply | None = None
    laser_columns: int = 0
    segments: tuple[int, int, int] | None = None

    def keep(self, slots: Mapping[int, int]) -> None:
        """These were sent, too; the list itself may be another connection's as well, so it is not changed."""
        self.kept = [slots.get(slot, value) for slot, value in enumerate(self.kept)]


DeferredReply = Callable[[], Reply | None]
"""An answer that is not there yet: ask again until it gives one."""
Answer = Callable[[Call, ConnectionContext], Reply | DeferredReply]
"""Who answers: a reply, or a promise of one."""


class Host(Protocol):
    """Who answers all connections, and is told when one is gone."""

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """What an Answer gives."""
        ...

    def on_disconnect(self, context: ConnectionContext) -> None:
        """The connection is gone; what it drove stops."""
        ...

    def hold(self, robot_id: int, by: str) -> None:
        """Stop this robot, and let nobody move it until it is released (holds.py)."""
        ...


class ClientIdentity(NamedTuple):
    """What a CONNECT agreed: which robot, whether the client is a 64-bit one, and whether it said nothing since."""

    robot_id: int
    wide: bool
    silent: bool = False


def error_reply(code: int) -> Reply:
    """The ERROR reply with this code (PROTOCOL.md, section 1)."""
    return Reply("error", values=(code,))


Request = TypeVar("Request")


class BaseSession(ABC, Generic[Request]):
    """What a conversation is in either language: requests in their order, one answer that may come later."""

    def __init__(self, answer: Answer, name: str, context: ConnectionContext) -> None:
        self.context = context
        self.name = name
        self.closing = False
        """Whether the connection is to be closed, once what was given back is sent."""
        self.refused = 0
        self.answered = 0
        self._answer = answer
        self._queue: deque[Request] = deque()
        self._later: tuple[str, DeferredReply] | None = None

    @property
    def ready(self) -> bool:
        """Whether a request waits that could be answered now."""
        return bool(self._queue) and self._later is None and not self.closing

    @property
    def is_queue_full(self) -> bool:
        """Whether so many requests wait that no more should be read."""
        return len(self._queue) >= CROWD

    @property
    def waiting(self) -> bool:
        """Whether an answer is outstanding that only time can bring."""
        return self._later is not None

    @property
    def identity(self) -> ClientIdentity | None:
        """What the conversation has agreed that another connection may go on with; None for nothing."""
        return None

    @property
    @abstractmethod
    def unfinished(self) -> int:
        """Bytes of a request that is not whole yet."""

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Take in what the client sent; `answers` gives what there is to say to it."""

    def process_requests(self, most: int) -> bytes:
        """The replies to at most so many of the requests that wait."""
        replies = bytearray()
        while most > 0 and self.ready:
            replies += self._answer_one(self._queue.popleft())
            most -= 1
            self.answered += 1
        return bytes(replies)

    def tick(self) -> bytes:
        """The reply that was to come later, if it is there now."""
        if self._later is None:
            return b""
        name, later = self._later
        reply = later()
        if reply is None:
            return b""
        self._later = None
        return self._encode(name, reply)

    def cancel_deferred(self, code: int) -> bytes:
        """The ERROR reply to a request whose answer cannot come; the conversation goes on."""
        if self._later is None:
            return b""
        name, self._later = self._later[0], None
        return self._encode(name, error_reply(code))

    def _say(self, name: str, answer: Reply | DeferredReply) -> bytes:
        """An answer to a command: now, or when it is there."""
        if isinstance(answer, Reply):
            return self._encode(name, answer)
        self._later = (name, answer)
        return self.tick()

    def _count_refusal(self, reason: str) -> None:
        self.refused += 1
        if self.refused == 1:
            log.warning("%s: refused: %s (further refusals are counted, not logged)", self.name, reason)

    @abstractmethod
    def _answer_one(self, request: Request) -> bytes: ...

    @abstractmethod
    def _encode(self, name: str, reply: Reply) -> bytes: ...


class Session(BaseSession[TcpFrame | InvalidFrame]):
    """One client's conversation. `name` stands in the log; `acquaintance` tells who came from that address before, of
    the word width that the first bytes show (None: they do not); a request has `most_words` at most."""

    def __init__(
        self,
        answer: Answer,
        name: str = "client",
        find_identity: Callable[[bool | None], ClientIdentity | None] = lambda _: None,
        most_words: int = Limits().frame,
    ) -> None:
        super().__init__(answer, name, ConnectionContext())
        self._find_identity = find_identity
        self._head: bytes | None = b""
        self._silent = False
        self._framer = TcpFramer(limit_words(request_bounds, most_words), drop_after_loss=True)

    @property
    def unfinished(self) -> int:
        return self._framer.pending + self._framer.bytes_to_skip + len(self._head or b"")

    @property
    def identity(self) -> ClientIdentity | None:
        """What this connection has agreed so far; None before its CONNECT and after one that found no robot."""
        robot_id = self.context.robot_id
        return None if robot_id is None else ClientIdentity(robot_id, self.context.wire_state.wide, self._silent)

    def receive(self, data: bytes) -> None:
        if self.closing:
            return
        if self._head is not None:
            data = self._head = self._head + data
            if not has_header(data):
                return
            self._head = None
            self._recognise(data)
        self._queue.extend(self._framer.receive(data))

    def _recognise(self, head: bytes) -> None:
        known = None if is_connect(head) else self._find_identity(sniff_word_size(head))
        if known is not None:
            log.info("%s: goes on without CONNECT, as robot %d", self.name, known.robot_id)
            self.context.robot_id = known.robot_id
            self._framer.wide = known.wide

    def _answer_one(self, request: TcpFrame | InvalidFrame) -> bytes:
        if isinstance(request, InvalidFrame):
            self.closing = request.fatal
            if request.fatal:
                log.warning("%s: closed: %s", self.name, request.reason)
            return self._refuse(request.code, request.reason)
        try:
            call = codec.decode_tcp_request(request)
        except WireError as error:
            return self._refuse(BAD_VALUES, str(error))
        row = BY_NAME[call.name]
        if self.context.robot_id is None and call.name not in _CONNECTS_SESSION:
            return self._refuse(NOT_CONNECTED, f"{call.name} before connect_robot")
        self.context.wire_state.wide = bool(self._framer.wide)
        codec.update_from_request(call, self.context.wire_state)
        answer = self._answer(call, self.context)
        self._silent = call.name in _CONNECTS_SESSION
        self.closing = not row.has_tcp_reply
        if self.closing:
            return b""
        return self._say(call.name, answer)

    def _encode(self, name: str, reply: Reply) -> bytes:
        if reply.kind == "error":
            self._count_refusal(f"{name}: error {reply.values[0]}")
        return codec.encode_tcp_reply(BY_NAME[name], reply, self.context.wire_state)

    def _refuse(self, code: int, reason: str) -> bytes:
        self._count_refusal(reason)
        self.context.wire_state.wide = bool(self._framer.wide)
        return codec.encode_tcp_reply(BY_NAME["gs"], error_reply(code), self.context.wire_state)
