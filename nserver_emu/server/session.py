"""A session with one client of Nserver's TCP protocol, and the identities of clients, without I/O: bytes in and out.

    receive(bytes) -> framer -> queue -> answer(call, context) -> process_requests() -> reply bytes
                                               `- deferred (ws, zr): tick() polls until the reply exists

`BaseSession` is independent of the protocol, `Session` speaks the TCP protocol (docs/protocol.md),
`SerialSession` (serial_session.py) a robot's own line.

One reply per request, in order: requests behind a deferred reply wait. The command handler is passed in, so that one
session class serves simulations and real robots. An invalid request gets an ERROR reply; it closes the connection only
if the start of the next frame cannot be found.

An old client may open a second connection and continue there without CONNECT. The first bytes of a connection show if
it starts with CONNECT and, in most cases, the client's word size:

    32-bit client    type, count | word   word   ...
    64-bit client    type, count | 0 word 0 word ...      each word is sent as four zero bytes and its value

The second connection of such a client, without another CONNECT, continues one of those from the same address:

- one that no other connection continues already, if there are any;
- of these, one that has sent nothing since its CONNECT but the sensor mask, if there are any.

If the remaining ones differ in their robot or word size, the connection is ambiguous and refused: it could be given the
robot of another program, or be misread. A word size seen in its first bytes excludes clients of the other size. The
entry of a closed connection stays while an unidentified connection from the same address is pending. A DISCONNECT
over the second connection removes the entry of the first too.

No sockets: a connection is represented by any hashable key.

Deferred replies: they need simulated time (ws, zr, arm_ws), or a click in the viewer (get_robot_conf).
"""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections import Counter, deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.client_state import STATE_SIZE
from nclient.protocol.codec import InvalidFrame, TcpFrame, TcpFramer, limited_request_bounds, request_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, Mask, WireState, tcp_wire_state
from nserver_emu.server.admission import Limits
from nserver_emu.simulation.sensors import LineFit

log = logging.getLogger(__name__)

# Codes of ERROR replies (docs/protocol.md, Error codes).
BAD_VALUES, NOT_CONNECTED, NOT_AVAILABLE, REFUSED = 2, 3, 4, 5
# The reply to a motion of a held robot is HELD of nclient.errors, 7.

# Requests that may wait in a session; its port is not read while there are more.
MAX_QUEUED_REQUESTS: Final = 100

# The header of a TCP frame: type and number of words, two bytes each.
_HEADER_BYTES: Final = 4
_WORD_BYTES: Final = 4
# Words examined for the word size; more would only delay the first reply.
_MAX_SNIFFED_WORDS: Final = 8

# Requests that are valid before a robot is chosen.
_CONNECT_NAMES: Final = frozenset({"connect_robot", "create_robot", "disconnect_robot"})
_CONNECT_TYPES: Final = frozenset(BY_NAME[name].tcp_type for name in _CONNECT_NAMES)
_MASK_TYPE: Final = BY_NAME["ct"].tcp_type
# The request whose reply is prepared; others need nothing but the state.
_PREPARED_TYPE: Final = BY_NAME["predict_sensors"].tcp_type


# The first bytes of a connection.


def has_header(head: bytes) -> bool:
    """Return True if these first bytes suffice for `is_connect` and `sniff_word_size`, or no more need to come."""
    if len(head) < _HEADER_BYTES:
        return len(head) >= 2 and (is_connect(head) or request_bounds(_frame_type(head)) is None)
    bounds = request_bounds(_frame_type(head))
    if is_connect(head) or bounds is None or not bounds[0] <= _word_count(head) <= bounds[1]:
        return True
    return len(head) >= _HEADER_BYTES + _WORD_BYTES * min(_word_count(head), _MAX_SNIFFED_WORDS)


def is_connect(head: bytes) -> bool:
    """Return True if the first message is a CONNECT, which identifies the client by itself."""
    return _frame_type(head) in _CONNECT_TYPES


def sniff_word_size(head: bytes) -> bool | None:
    """Return True for 64-bit words, False for 32-bit words, None if these bytes do not show it."""
    words = [head[at : at + _WORD_BYTES] for at in range(_HEADER_BYTES, len(head) - 3, _WORD_BYTES)]
    words = words[: _word_count(head)]
    # A 64-bit client sends zeros at even places; anything else there comes from a 32-bit client.
    if any(any(word) for word in words[::2]):
        return False
    # Zeros there prove nothing, except in a sensor mask (ct): its first word has bits set.
    return True if _frame_type(head) == _MASK_TYPE and any(any(word) for word in words) else None


def _frame_type(head: bytes) -> int:
    return int.from_bytes(head[:2], "big", signed=True)


def _word_count(head: bytes) -> int:
    return int.from_bytes(head[2:_HEADER_BYTES], "big")


# What a session knows of its connection.


@dataclass(slots=True, eq=False)
class CachedStateReply:
    """A state reply with the inputs that it was built from, valid while they are the same objects."""

    snapshot: object
    mask: Mask
    laser_mode: int
    reply: Reply
    # Its frame by command, once it was sent.
    frames: dict[str, bytes] = field(default_factory=dict)

    def is_for(self, snapshot: object, wire_state: WireState) -> bool:
        """Return True if it was built from this snapshot and these settings of the connection."""
        return (self.snapshot is snapshot and self.mask is wire_state.mask
                and self.laser_mode == wire_state.laser_mode)


@dataclass(slots=True, eq=False)
class ConnectionContext:
    """Settings and state of one connection."""

    # Protocol, word size, sensor mask and laser mode.
    wire_state: WireState = field(default_factory=lambda: tcp_wire_state(N150))
    # The robot chosen by CONNECT; None before.
    robot_id: int | None = None
    # State[0..44] as last sent. Slots that the mask excludes keep these values.
    last_sent: list[int] = field(default_factory=lambda: [0] * STATE_SIZE)
    # The last state reply. A client that polls gets it again while nothing changes.
    cached_state: CachedStateReply | None = None
    # What was prepared for the next request (handlers/world.py).
    prediction: object = None
    # Number of laser columns in use; 0 is all.
    laser_columns: int = 0
    # Line extraction of the laser, set by conf_sg.
    line_fit: LineFit = field(default_factory=LineFit)
    # True while a person holds the robot: word 44 of its state replies is HELD.
    is_held: bool = False

    @property
    def robot(self) -> int:
        """The robot chosen by CONNECT, without which no handler of a robot's command is called."""
        assert self.robot_id is not None
        return self.robot_id

    def update_last_sent(self, slots: Mapping[int, int]) -> None:
        """Record State slots sent in a reply that is not a state packet."""
        # A new list: the old one may be shared with other connections.
        self.last_sent = [slots.get(slot, value) for slot, value in enumerate(self.last_sent)]


class ClientIdentity(NamedTuple):
    """The result of a CONNECT."""

    robot_id: int
    # True for a client with 64-bit words.
    wide: bool
    # True while the client has sent nothing since its CONNECT but the sensor mask (ct).
    silent: bool = False


# A reply that does not exist yet: call it again until it returns one.
DeferredReply = Callable[[], Reply | None]
Answer = Callable[[Call, ConnectionContext], Reply | DeferredReply]


class CommandHandler(Protocol):
    """The command handler of all connections: the emulator, or the gateway to real robots."""

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Execute a call and return its reply."""

    def on_disconnect(self, context: ConnectionContext) -> None:
        """Stop the motions that a closed connection started."""

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot and ignore motion commands until it is released (estop.py)."""


def error_reply(code: int) -> Reply:
    """Return the ERROR reply with this code."""
    return Reply("error", values=(code,))


def done() -> Reply:
    """Return the reply of a command without a result."""
    return Reply("simple", values=(0,))


# Sessions.

Request = TypeVar("Request")


class BaseSession(ABC, Generic[Request]):
    """A queue of requests with one reply each, of which one may be deferred."""

    def __init__(self, answer: Answer, name: str, context: ConnectionContext) -> None:
        self.context = context
        # Name of the client in logs and recordings, and `extra` of log lines: its address, per which they are limited.
        self.name = name
        self.log_extra = {"address": name.rpartition(":")[0] or name}
        # True if the connection is to be closed after the returned bytes are sent.
        self.closing = False
        # The identity that another connection may continue; replaced whenever it changes.
        self.identity: ClientIdentity | None = None
        # Number of requests answered with an error, and with any reply.
        self.refused = 0
        # Kinds of refusals that were logged.
        self._logged_kinds: set[str] = set()
        self.answered = 0
        self._answer = answer
        self._queue: deque[Request] = deque()
        # Name of the command whose reply is deferred, and the function to poll.
        self._deferred: tuple[str, DeferredReply] | None = None

    @property
    def ready(self) -> bool:
        """True if a request can be answered now."""
        return bool(self._queue) and self._deferred is None and not self.closing

    def call_to_prepare(self) -> Call | None:
        """Return the request that is answered next if its command has a preparation of its own."""
        return None

    @property
    def is_queue_full(self) -> bool:
        """True if no more should be read from the port."""
        return len(self._queue) >= MAX_QUEUED_REQUESTS

    @property
    def waiting(self) -> bool:
        """True while a reply is deferred."""
        return self._deferred is not None

    @property
    @abstractmethod
    def unfinished(self) -> int:
        """Number of received bytes that do not form a whole request yet."""

    @abstractmethod
    def receive(self, data: bytes) -> None:
        """Add bytes from the client; `process_requests` returns the replies."""

    def process_requests(self, max_requests: int) -> bytes:
        """Return the replies to at most `max_requests` of the waiting requests."""
        replies = b""
        for _ in range(max_requests):
            if not self.ready:
                break
            replies += self._process_one(self._queue.popleft())
            self.answered += 1
        return replies

    def tick(self) -> bytes:
        """Return the deferred reply if it exists now, else nothing."""
        if self._deferred is None:
            return b""
        name, poll = self._deferred
        reply = poll()
        if reply is None:
            return b""
        self._deferred = None
        return self._encode(name, reply)

    def cancel_deferred(self, code: int) -> bytes:
        """Give up a deferred reply and return an ERROR reply in its place; the session continues."""
        if self._deferred is None:
            return b""
        name, self._deferred = self._deferred[0], None
        return self._encode(name, error_reply(code))

    def _reply_or_defer(self, name: str, answer: Reply | DeferredReply) -> bytes:
        """Return the encoded reply, or defer it."""
        if isinstance(answer, Reply):
            return self._encode(name, answer)
        self._deferred = (name, answer)
        return self.tick()

    def _count_refused(self, kind: str, reason: str) -> None:
        # Log the first of each kind: a client in a loop would fill the log.
        self.refused += 1
        if kind not in self._logged_kinds:
            self._logged_kinds.add(kind)
            log.warning("%s: refused: %s (further refusals of this kind are counted, not logged)", self.name, reason,
                        extra=self.log_extra)

    @abstractmethod
    def _process_one(self, request: Request) -> bytes: ...

    def _encode(self, name: str, reply: Reply) -> bytes:
        """Return the bytes of a reply; a cached state is encoded once per command."""
        if reply.kind == "error":
            reason = f"{name}: error {reply.values[0]}"
            self._count_refused(reason, reason)
        cached = self.context.cached_state
        if cached is None or cached.reply is not reply:
            return self._encode_anew(name, reply)
        if name not in cached.frames:
            cached.frames[name] = self._encode_anew(name, reply)
        return cached.frames[name]

    @abstractmethod
    def _encode_anew(self, name: str, reply: Reply) -> bytes: ...


class Session(BaseSession[TcpFrame | InvalidFrame]):
    """A session over TCP.

    Parameters
    ----------
    answer
        Executes calls.
    name
        Name of the client in logs.
    find_identity
        Called for a connection that does not start with CONNECT, with the word size that its first bytes show (True 64,
        False 32 bits, None unknown); returns the identity that it continues, several if that is ambiguous.
    max_words
        Maximum length of a request.
    """

    def __init__(self, answer: Answer, name: str = "client",
                 find_identity: Callable[[bool | None], Sequence[ClientIdentity]] = lambda _: (),
                 max_words: int = Limits().frame) -> None:
        super().__init__(answer, name, ConnectionContext())
        self._find_identity = find_identity
        # The first bytes until they identify the client, then None.
        self._head: bytes | None = b""
        # True for a connection without CONNECT that could continue several clients.
        self._is_ambiguous = False
        self._framer = TcpFramer(limited_request_bounds(max_words), drop_after_loss=True)

    @property
    def unfinished(self) -> int:
        """Return the number of received bytes that do not form a whole request yet."""
        return self._framer.pending + self._framer.bytes_to_skip + len(self._head or b"")

    def receive(self, data: bytes) -> None:
        """Add bytes from the client; the first ones decide its word size."""
        if self.closing:
            return
        if self._head is not None:
            data = self._head = self._head + data
            if not has_header(data):
                return
            self._head = None
            self._identify(data)
        self._queue.extend(self._framer.receive(data))

    def call_to_prepare(self) -> Call | None:
        """Return the request that is answered next if its command has a preparation of its own."""
        request = self._queue[0] if self._queue else None
        if not isinstance(request, TcpFrame) or request.type != _PREPARED_TYPE:
            return None
        try:
            return codec.decode_tcp_request(request)
        except WireError:
            return None

    @property
    def may_have_32_bit_words(self) -> bool:
        """True if an incomplete CONNECT of a 64-bit client would be a whole CONNECT to robot 0 of a 32-bit client."""
        return self._framer.may_be_narrow

    def assume_32_bit_words(self) -> None:
        """Read an incomplete CONNECT as one to robot 0, because the rest of a 64-bit message has not come."""
        if self._framer.may_be_narrow:
            log.warning("%s: connects to robot 0; the numbers of robots begin with 1", self.name, extra=self.log_extra)
            self._framer.wide = False
            self._queue.extend(self._framer.receive(b""))

    def _identify(self, head: bytes) -> None:
        """Continue the session of another connection if this one does not start with CONNECT."""
        found = () if is_connect(head) else self._find_identity(sniff_word_size(head))
        if not found:
            return
        identity, *others = found
        self._framer.wide = identity.wide
        if others:
            self._is_ambiguous = True
            names = " or ".join(f"robot {each.robot_id} ({64 if each.wide else 32}-bit words)" for each in found)
            log.warning("%s: closed: it starts without CONNECT and could continue %s of the same address; start such "
                        "programs one after another", self.name, names, extra=self.log_extra)  # fmt: skip
            return
        log.info("%s: continues without CONNECT, as robot %d", self.name, identity.robot_id, extra=self.log_extra)
        self.context.robot_id = identity.robot_id
        self.identity = identity._replace(silent=False)

    def _process_one(self, request: TcpFrame | InvalidFrame) -> bytes:
        # 1. Requests of an unknown client, and frames that are no request.
        if self._is_ambiguous:
            self.closing = True
            return self._refuse("ambiguous", NOT_CONNECTED, "a request without CONNECT of an ambiguous client")
        if isinstance(request, InvalidFrame):
            self.closing = request.fatal
            if request.fatal:
                log.warning("%s: closed: %s", self.name, request.reason, extra=self.log_extra)
            return self._refuse(f"frame {request.code}", request.code, request.reason)
        # 2. Decode, and require a CONNECT.
        try:
            call = codec.decode_tcp_request(request)
        except WireError as error:
            return self._refuse(f"values {request.type}", BAD_VALUES, str(error))
        row = BY_NAME[call.name]
        if self.context.robot_id is None and call.name not in _CONNECT_NAMES:
            return self._refuse("not connected", NOT_CONNECTED, f"{call.name} before connect_robot")
        # No process has the number 0: it is the second half of a word that has eight bytes.
        if call.name in _CONNECT_NAMES and call.args[-1] == 0 and (self._queue or self.unfinished):
            self.closing = True
            reason = (f"{call.name}: words of eight bytes with the value in front; only 64-bit words with the value "
                      "behind four zero bytes are known: build the program for 32 bits, or with clib")  # fmt: skip
            return self._refuse("word layout", BAD_VALUES, reason)
        # 3. Settings of the protocol that the request changes take effect in its own reply.
        context, wire_state = self.context, self.context.wire_state
        wire_state.wide = bool(self._framer.wide)
        codec.update_from_request(call, wire_state)
        # 4. Execute. The result of CONNECT is an identity, unless it named no existing robot.
        answer = self._answer(call, context)
        self._update_identity(call.name)
        # 5. Reply. A request without a reply (disconnect_robot) ends the connection.
        self.closing = not row.has_tcp_reply
        if self.closing:
            return b""
        return self._reply_or_defer(call.name, answer)

    def _update_identity(self, name: str) -> None:
        """Note after a request which robot and word size a second connection of this client would continue.

        A client is silent from CONNECT until it sends anything but the sensor mask; its robot is taken from CONNECT and
        from the first request after the silence, and from any request of a client that had none.
        """
        was_silent = self.identity is not None and self.identity.silent
        is_silent = name in _CONNECT_NAMES or (was_silent and name == "ct")
        if is_silent or self.identity is None or was_silent:
            robot_id = self.context.robot_id
            wide = self.context.wire_state.wide
            self.identity = None if robot_id is None else ClientIdentity(robot_id, wide, is_silent)

    def _encode_anew(self, name: str, reply: Reply) -> bytes:
        return codec.encode_tcp_reply(BY_NAME[name], reply, self.context.wire_state)

    def _refuse(self, kind: str, code: int, reason: str) -> bytes:
        self._count_refused(kind, reason)
        self.context.wire_state.wide = bool(self._framer.wide)
        # An ERROR reply has the same form for every command.
        return codec.encode_tcp_reply(BY_NAME["gs"], error_reply(code), self.context.wire_state)


# Seconds. The close of one connection may be seen this much earlier than the opening of the one that continues it.
CLOSED_RETENTION_S: Final = 0.2


@dataclass(slots=True)
class _Entry:
    host: str
    identity: ClientIdentity
    is_continued: bool = False
    is_closed: bool = False


class ClientRegistry:
    """Identities of all connections, in the order in which they were registered."""

    def __init__(self) -> None:
        self._entries: dict[Hashable, _Entry] = {}
        # For a connection without CONNECT: the connection that it continues.
        self._continued: dict[Hashable, Hashable] = {}
        # Addresses of connections that have not sent enough to be identified.
        self._pending: dict[Hashable, str] = {}

    def __len__(self) -> int:
        return len(self._entries)

    def add_pending(self, connection: Hashable, host: str) -> None:
        """Add a new connection that is not yet identified."""
        self._pending[connection] = host

    def register(self, connection: Hashable, host: str, identity: ClientIdentity | None) -> None:
        """Set the identity of a connection, None to remove it."""
        entry = self._entries.get(connection)
        if identity is None:
            self._entries.pop(connection, None)
        elif entry is None:
            self._entries[connection] = _Entry(host, identity)
        else:
            entry.identity = identity
        self._resolve(connection)

    def lookup(self, connection: Hashable, host: str, wide: bool | None) -> list[ClientIdentity]:
        """Return the identity that a new connection without CONNECT continues.

        Parameters
        ----------
        connection, host
            The new connection and its address.
        wide
            True for 64-bit words, False for 32-bit words, None if the first bytes do not show it.

        Returns
        -------
        list
            One identity; none if there is no such client; several, with different robots or word sizes, if the
            connection is ambiguous.
        """
        # 1. Entries from this address with a matching word size.
        matching = {other: entry for other, entry in self._entries.items()
                    if entry.host == host and wide in (None, entry.identity.wide)}
        # 2. Prefer clients that nothing continues yet, and of these the ones that only connected: old clients open
        #    their second connection right after that.
        originals = {other: entry for other, entry in matching.items() if other not in self._continued}
        fresh = {other: entry for other, entry in originals.items() if not entry.is_continued}
        silent = {other: entry for other, entry in fresh.items() if entry.identity.silent}
        candidates = silent or fresh or originals or matching
        # 3. Continue one if it makes no difference which.
        distinct = {entry.identity[:2]: entry.identity for entry in candidates.values()}
        if len(distinct) == 1:
            first = next(iter(candidates))
            candidates[first].is_continued = True
            self._continued[connection] = first
        self._resolve(connection)
        return list(distinct.values())

    def remove(self, connection: Hashable, *, disconnected: bool = False) -> None:
        """Mark a connection as closed; `disconnected`: after DISCONNECT, which ends the one it continued too."""
        if connection in self._entries:
            self._entries[connection].is_closed = True
        first = self._continued.pop(connection, None)
        if disconnected:
            self._entries.pop(connection, None)
            self._entries.pop(first, None)
        self._resolve(connection)

    def _resolve(self, connection: Hashable) -> None:
        """End the pending state of a connection and drop closed entries that no pending connection can continue."""
        self._pending.pop(connection, None)
        pending_hosts = set(self._pending.values())
        for other in [other for other, e in self._entries.items() if e.is_closed and e.host not in pending_hosts]:
            del self._entries[other]


# Replies that need simulated time.


class PolledReply:
    """A deferred reply that is built at the moment it is due, however late its session fetches it."""

    def __init__(self, context: ConnectionContext, poll: DeferredReply) -> None:
        self.context = context
        self.reply: Reply | None = None
        self._poll = poll

    def __call__(self) -> Reply | None:
        """Return the reply if it exists now."""
        if self.reply is None:
            self.reply = self._poll()
        return self.reply


class DeferredReplies:
    """All deferred replies, polled each time simulated time has passed."""

    def __init__(self) -> None:
        self._pending: list[PolledReply] = []

    def __len__(self) -> int:
        return len(self._pending)

    def add(self, context: ConnectionContext, poll: DeferredReply) -> PolledReply:
        """Add the deferred reply of a connection."""
        reply = PolledReply(context, poll)
        self._pending.append(reply)
        return reply

    def poll(self) -> None:
        """Build the replies that are due."""
        self._pending = [reply for reply in self._pending if reply() is None]

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the deferred replies of a connection."""
        self._pending = [reply for reply in self._pending if reply.context is not context]


# get_robot_conf: a pose clicked in the viewer.

# x, y, steering and turret in tenths.
ClickedPose = tuple[int, int, int, int]


@dataclass(eq=False, slots=True)
class PoseRequest:
    """A connection that waits for a pose."""

    robot_id: int
    context: ConnectionContext
    pose: ClickedPose | None = None


class PoseRequests:
    """Pending requests for a clicked pose. One click answers all requests for that robot."""

    def __init__(self) -> None:
        # True while a viewer with permission to click is open; without one, requests are answered at once.
        self.open = False
        self._requests: list[PoseRequest] = []

    def add(self, robot_id: int, context: ConnectionContext,
            default: Callable[[], ClickedPose]) -> Callable[[], ClickedPose | None]:
        """Request a pose of a robot.

        Returns
        -------
        Callable
            Poll it until it returns a pose. It returns `default()` as soon as no viewer is open.
        """
        request = PoseRequest(robot_id, context)
        self._requests.append(request)

        def poll() -> ClickedPose | None:
            if request.pose is None and not self.open:
                self._requests = [other for other in self._requests if other is not request]
                request.pose = default()
            return request.pose

        return poll

    def counts(self) -> dict[int, int]:
        """Return the number of pending requests by robot."""
        return Counter(request.robot_id for request in self._requests)

    def answer(self, robot_id: int, pose: ClickedPose) -> bool:
        """Answer the requests for a robot with a clicked pose; return True if there were any."""
        pending = [request for request in self._requests if request.robot_id == robot_id]
        for request in pending:
            request.pose = pose
        self._requests = [request for request in self._requests if request.pose is None]
        return bool(pending)

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the requests of a closed connection."""
        self._requests = [request for request in self._requests if request.context is not context]
