"""A session with a robot on its serial line, which is never free of errors.

    ct, or the handshake of an N200 over TCP -> command -> its reply, a NAK, or silence -> command ...

`SerialLink` decides which request a frame answers, `DirectBackend` encodes, decodes and validates,
`send_emergency_stop` sends st before anything else is known of the robot.

A command is sent once, after the input was cleared. A missing or corrupt reply is a ReplyTimeout, and the session
continues, as in the C library. A late reply is never taken for that of another command (docs/decisions/017): while
a reply of a command's type is outstanding, a request of another type is sent first; once that is answered, nothing
older can arrive.
"""

import contextlib
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Final

from nclient.backends.base import LinkStatistics, is_wait, split_wait
from nclient.backends.wrappers import ReplyValidator
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol import codec
from nclient.protocol.client_state import HANDSHAKE_SIZE, apply_handshake, read_handshake
from nclient.protocol.codec import MAX_BYTE
from nclient.protocol.commands import NAK_TYPE, Call, Command, exists_on_serial
from nclient.protocol.decode import guess_model, model_mismatch_hint
from nclient.protocol.replies import LINE_STATE, Reply
from nclient.protocol.serial_framing import MIN_FRAME, SerialFrame, SerialFramer
from nclient.protocol.types import DEFAULT_LASER_MODE, EVERYTHING, LINES, N150, Model, serial_wire_state
from nclient.transports.stream import ByteStream, Deadline, on_error

GAP_S: Final = 0.25
"""Silence after which a frame is not continued: bytes are 0.3 ms apart, the bursts of a radio modem 0.1 s."""
QUIET_S: Final = 2.0
"""Silence after which no late reply arrives any more."""
MAX_DRAIN_S: Final = 10.0
"""Time after which waiting for silence is given up."""
MAX_CLEAR_READS: Final = 64
"""Reads that clear the input before a request; on a line that never stops sending, the request is sent nevertheless."""
QUICK_S: Final = 1.0
"""Default time for a reply that a robot gives at once."""
HANDSHAKE_S: Final = 5.0
STOP_ATTEMPTS: Final = 3
"""Times that st is sent before a session is given up for a new one."""
_CT_ATTEMPTS: Final = 3
_PROBES: Final = ("get_ra", "get_rv", "get_rc", "get_bp", "get_sn")
"""Requests that every model answers, each with a reply type of its own; shortest reply first."""
_FORMAT_COMMANDS: Final = ("ct", "conf_ls")
"""Commands that change the format of the replies after them, in the order in which they are repeated."""
_URGENT: Final = frozenset({"st", "lp"})
_NO_REPLY: Final = Reply("none")
_LINE_MODE: Final = 33
_PIXEL_MODE: Final = DEFAULT_LASER_MODE


class SerialLink:
    """Requests and replies on a serial line, which has no sequence numbers.

        outstanding:  gs get_rv pr      a get_rv arrives: it answers get_rv, and gs is lost
                                        a gs arrives: it was late, and get_rv may still come

    A robot replies in the order of the requests, and a line does not reorder. So a frame answers the earliest
    outstanding request of its type, and every request before that is lost.

    Parameters
    ----------
    stream
        The line.
    statistics
        Counts of the link.
    clock
        Seconds; all waiting and all latencies use it.
    """

    def __init__(self, stream: ByteStream, statistics: LinkStatistics,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._statistics = statistics
        self._clock = clock
        self._framer = SerialFramer()
        self._outstanding: list[int] = []
        """Types of the outstanding replies, oldest first."""
        self._sent_s = 0.0

    def deadline(self, seconds: float) -> Deadline:
        """Return the deadline that many seconds from now."""
        return Deadline.after(seconds, self._clock)

    def expects(self, frame_type: int | None) -> bool:
        """Return True if a reply of this type may still arrive late."""
        return frame_type in self._outstanding

    def request(self, frame_type: int, request: bytes, timeout_s: float) -> SerialFrame:
        """Send a request and return the frame of its reply, or a NAK.

        Parameters
        ----------
        frame_type
            Type of the reply. None of this type should be outstanding: a late one would be waited for and dropped.
        request
            The encoded request.
        timeout_s
            Maximum time for the reply in seconds.

        Raises
        ------
        ReplyTimeout
            At the deadline, or earlier at a gap after bytes that are no frame.
        ConnectionLost
            If the line is closed.
        """
        # What arrived before the request cannot answer it.
        self.clear_input()
        self._outstanding.append(frame_type)
        self._statistics.exchanges += 1
        self._sent_s = self._clock()
        self._stream.send(request)
        try:
            return self._receive_reply(timeout_s)
        finally:
            self._update_statistics()

    def record_latency(self) -> None:
        """Count the last reply as accepted, with the time it took."""
        self._statistics.record_latency(self._clock() - self._sent_s)

    def send(self, frame_type: int, request: bytes) -> None:
        """Send a request without waiting; its reply stays outstanding."""
        self._outstanding.append(frame_type)
        self._stream.send(request)

    def receive_raw(self, size: int, deadline: Deadline) -> bytes:
        """Return that many bytes that are no frame, or fewer at the deadline."""
        data = b""
        with contextlib.suppress(ReplyTimeout):
            while len(data) < size:
                data += self._stream.receive(deadline)
        return data[:size]

    def clear_input(self) -> None:
        """Read and drop what has arrived, so that it does not answer the next request."""
        with contextlib.suppress(ReplyTimeout):
            for _ in range(MAX_CLEAR_READS):
                for frame in self._framer.receive(self._stream.receive(self.deadline(0))):
                    self._matches_last_request(frame)
                    self._statistics.strays += 1
        self._framer.clear()
        self._update_statistics()

    def drain(self) -> None:
        """Wait until nothing arrives any more; then no reply is outstanding.

        Raises
        ------
        ReplyTimeout
            If the line does not become quiet.
        """
        limit = self.deadline(MAX_DRAIN_S)
        while limit.remaining():
            try:
                self._stream.receive(self.deadline(QUIET_S))
            except ReplyTimeout:
                self._outstanding.clear()
                return
        raise ReplyTimeout("the line is never quiet")

    def close(self) -> None:
        """Close the stream."""
        self._stream.close()

    def _receive_reply(self, timeout_s: float) -> SerialFrame:
        """Return the frame that answers the last request."""
        deadline, is_over = self.deadline(timeout_s), False
        while not is_over:
            # After bytes that could have been a frame, a gap means that the rest of it is lost.
            unframed = self._framer.skipped_bytes + self._framer.pending
            wait = self.deadline(min(GAP_S, deadline.remaining())) if unframed >= MIN_FRAME else deadline
            try:
                frames = self._framer.receive(self._stream.receive(wait))
            except ReplyTimeout:
                frames, is_over = self._framer.expire(), True
            for frame in frames:
                if self._matches_last_request(frame):
                    return frame
                self._statistics.strays += 1
        raise ReplyTimeout(f"{unframed} bytes came and no answer" if unframed else f"no answer within {timeout_s:g} s")

    def _matches_last_request(self, frame: SerialFrame) -> bool:
        """Match a frame to the earliest request that it can answer; return True if that is the last one.

        A NAK does not name its request, so that it counts only if no other reply is outstanding.
        """
        # In-order line: all requests before the matched one are lost.
        if frame.type in self._outstanding:
            del self._outstanding[: self._outstanding.index(frame.type) + 1]
        elif frame.type == NAK_TYPE and len(self._outstanding) == 1:
            self._outstanding.clear()
        else:
            return False
        return not self._outstanding

    def _update_statistics(self) -> None:
        """Move the framer's counts to the statistics."""
        framer, statistics = self._framer, self._statistics
        statistics.frames += framer.frames
        statistics.skipped_bytes += framer.skipped_bytes
        statistics.checksum_errors += framer.bad_checksums
        framer.frames = framer.skipped_bytes = framer.bad_checksums = 0


class DirectBackend:
    """A session with a robot on its serial line.

    Parameters
    ----------
    stream
        The line; closed if connecting fails.
    model
        The robot's model, which decides the format of replies.
    hello
        True if the robot sends its handshake first: an N200 over TCP.
    timeout_s
        Maximum time for a reply that a robot gives at once, default 1 s; zr (120 s), ws and special packets (30 s)
        have time of their own.
    checks
        True to treat implausible replies as corrupt.
    link
        Statistics to count in.
    clock
        Seconds for all waiting, those of a simulation too.

    Raises
    ------
    ReplyTimeout, RobotRefused, ConnectionLost
        If connecting fails.
    """

    port = 1
    """As connect_robot of the C library returns."""

    def __init__(self, stream: ByteStream, model: Model, *, hello: bool = False, timeout_s: float | None = None,
                 checks: bool = True, link: LinkStatistics | None = None,
                 clock: Callable[[], float] = time.monotonic) -> None:
        self.timeout_s = QUICK_S if timeout_s is None else timeout_s
        self.link = link or LinkStatistics()
        self._line = SerialLink(stream, self.link, clock)
        self.wire_state = serial_wire_state(model)
        """Model, sensor mask and laser mode, which determine the format of replies."""
        self._validator = ReplyValidator(model) if checks else None
        self._format_calls: dict[str, Call] = {}
        """The last ct and conf_ls that were sent."""
        self._unconfirmed: set[str] = set()
        """Those of them whose effect is uncertain, since no reply confirmed it."""
        self._laser_mode_is_certain = False
        self._decoded_any = False
        self._closed_because: str | None = None
        # An N200 over TCP sends its mask, over a serial port it gets one; other models have a fixed one.
        with on_error(lambda: self._finish("connecting failed")):
            if hello:
                self._receive_handshake()
            self.greeting = None if hello else self._send_mask()
            """The state that an N200 answers to its mask; other models are not asked for one."""

    @property
    def closed(self) -> bool:
        """Return True if the session is over."""
        return self._closed_because is not None

    def execute(self, call: Call) -> Reply:
        """Send a command and return its reply. Raises as `Backend.execute`."""
        if self._closed_because is not None:
            raise ConnectionLost(f"{call.name}: {self._closed_because}; connect again")

        # 1. Commands that a serial line has under other names, or in pieces.
        row = codec.find_command(call.name)
        if row.name == "place_robot":
            x, y, steering, turret = call.args
            self.execute(Call("dp", (x, y)))
            return self.execute(Call("da", (steering, turret)))
        if row.name == "disconnect_robot":
            self.close()
            return _NO_REPLY
        if is_wait(call) and call.args[3] > MAX_BYTE:
            return split_wait(call, MAX_BYTE, self.execute)

        # 2. One exchange, once no older reply can be taken for this one.
        self._require_exists_on_serial(row)
        request = _encode(call, self.wire_state.model)
        try:
            self._resynchronize(row, request)
            return self._request(row, call, request)
        except ConnectionLost as error:
            self._finish(str(error))
            raise ConnectionLost(f"{row.name}: {self._closed_because}") from error

    def close(self) -> None:
        """Close the line, which needs no message; an `execute` in another thread ends with ConnectionLost."""
        self._finish("this side closed the line")

    def _finish(self, reason: str) -> None:
        if self._closed_because is None:
            self._closed_because = reason
            self._line.close()

    # one exchange

    def _require_exists_on_serial(self, row: Command) -> None:
        """Raise RobotRefused for a command that the serial line of this model does not have."""
        model = self.wire_state.model
        if row.line_type is None:
            raise RobotRefused(row.name, None, "exists only on an Nserver, not on a robot's own line")
        if not exists_on_serial(row, model):
            raise RobotRefused(row.name, None, f"a {model.name} does not have it on its own line")

    def _request(self, row: Command, call: Call, request: bytes) -> Reply:
        # 1. The request may take effect whether or not its reply arrives.
        revert = self._update_format(call)
        frame = self._exchange(row, request, self._reply_timeout_s(row, call))
        # 2. A NAK says that it had no effect.
        if frame.type == NAK_TYPE:
            self.link.naks += 1
            self._line.record_latency()
            revert()
            raise RobotRefused(row.name, None)
        # 3. A valid reply confirms that it had.
        reply = self._decode_valid(row, frame)
        self._unconfirmed.discard(row.name)
        self._line.record_latency()
        return reply

    def _exchange(self, row: Command, request: bytes, timeout_s: float) -> SerialFrame:
        assert row.line_type is not None
        try:
            return self._line.request(row.line_type, request, timeout_s)
        except ReplyTimeout as error:
            raise self._no_reply(f"{row.name}: {error}") from None

    def _decode_valid(self, row: Command, frame: SerialFrame) -> Reply:
        """Return the reply in a frame. Raises ReplyTimeout if it does not fit the command or is implausible."""
        try:
            reply = self._decode(frame)
        except WireError as error:
            self.link.misfits += 1
            self._unconfirmed.update(self._format_calls)
            reason = f"{row.name}: the reply does not fit the command: {error}"
            raise self._no_reply(reason + self._hint_for(row, frame)) from None
        inconsistency = self._validator.find_inconsistency(reply) if self._validator else ""
        if inconsistency:
            self.link.implausible += 1
            raise self._no_reply(
                f"{row.name}: the answer cannot be true, {inconsistency}; checks=0 turns such checks off"
            )
        self._decoded_any = True
        return reply

    def _decode(self, frame: SerialFrame) -> Reply:
        """Decode a frame.

        An earlier client may have left the laser in another mode. Until conf_ls is sent, the length of a reply
        shows which.
        """
        try:
            return codec.decode_serial_reply(frame, self.wire_state)
        except WireError:
            if self._laser_mode_is_certain or "conf_ls" in self._format_calls or not self.wire_state.model.has_laser:
                raise
            # Line modes have four numbers per reading, other modes one: if one does not fit, the other may.
            other = self.wire_state.copy()
            other.set_laser_mode(_PIXEL_MODE if other.laser_width == LINES else _LINE_MODE)
            with contextlib.suppress(WireError):
                reply = codec.decode_serial_reply(frame, other)
                self.wire_state = other
                return reply
            raise

    def _hint_for(self, row: Command, frame: SerialFrame) -> str:
        """Return a hint if no reply was decoded yet and this one looks like another model's."""
        model = guess_model(frame.data) if row.line_reply is LINE_STATE and not self._decoded_any else None
        if model is None or model is self.wire_state.model:
            return ""
        return "; " + model_mismatch_hint(self.wire_state.model, frame.data)

    def _no_reply(self, reason: str) -> ReplyTimeout:
        self.link.timeouts += 1
        return ReplyTimeout(reason)

    def _reply_timeout_s(self, row: Command, call: Call) -> float:
        wait_s = float(call.args[3]) if row.name == "ws" else 0.0
        return wait_s + (self.timeout_s if row.line_timeout_s <= QUICK_S else max(self.timeout_s, row.line_timeout_s))

    # before an exchange

    def _resynchronize(self, row: Command, request: bytes) -> None:
        """Make sure that no outstanding reply can be taken for the next one, and that its format is certain."""
        assert row.line_type is not None
        # 1. A stop is sent at once; its second copy, after the flush, has the reply that is evaluated.
        if self._line.expects(row.line_type) and row.name in _URGENT:
            self._line.send(row.line_type, request)
        # 2. Outstanding replies of this type.
        self._flush_pending_reply(row, row)
        # 3. Repeat ct and conf_ls where it is uncertain whether the robot received them.
        for name in sorted(self._unconfirmed - {row.name}, key=_FORMAT_COMMANDS.index):
            call, format_row = self._format_calls[name], codec.find_command(name)
            self._flush_pending_reply(format_row, row)
            self._request(format_row, call, _encode(call, self.wire_state.model))

    def _flush_pending_reply(self, row: Command, for_row: Command) -> None:
        """Exchange something of another type while a reply like this row's is outstanding; then none can come."""
        # It may have arrived already.
        if self._line.expects(row.line_type):
            self._line.clear_input()
        if not self._line.expects(row.line_type):
            return
        # Otherwise a probe of a type that is not outstanding; if all types are, only silence helps.
        probes = (codec.find_command(name) for name in _PROBES)
        probe = next((probe for probe in probes if not self._line.expects(probe.line_type)), None)
        try:
            if probe is None:
                self._line.drain()
            else:
                self._exchange(probe, _encode(Call(probe.name), self.wire_state.model), self.timeout_s)
                self._line.record_latency()
        except ReplyTimeout as error:
            raise ReplyTimeout(
                f"{for_row.name} was not sent, since a late reply could be taken for its own: {error}"
            ) from None

    # connecting, and the format of replies

    def _send_mask(self) -> Reply | None:
        """Send ct to an N200 and return its reply; N150 and Scout have a fixed mask."""
        if not self.wire_state.model.sends_mask:
            return None
        # The first request on a line is often lost: an open port starts with noise.
        mask = Call("ct", EVERYTHING.smask)
        for _ in range(_CT_ATTEMPTS - 1):
            with contextlib.suppress(ReplyTimeout, RobotRefused):
                return self.execute(mask)
        try:
            return self.execute(mask)
        except ReplyTimeout as error:
            raise ReplyTimeout(f"{error}; {self._mismatch_hint()}") from None
        except RobotRefused:
            raise RobotRefused("ct", None, f"NAK; {self._mismatch_hint()}") from None

    def _mismatch_hint(self) -> str:
        return model_mismatch_hint(self.wire_state.model)

    def _receive_handshake(self) -> None:
        data = self._line.receive_raw(HANDSHAKE_SIZE, self._line.deadline(HANDSHAKE_S))
        if len(data) < HANDSHAKE_SIZE:
            raise ReplyTimeout(f"an n200 sends {HANDSHAKE_SIZE} bytes first, and {len(data)} came; "
                               f"{self._mismatch_hint()}")
        apply_handshake(read_handshake(data), self.wire_state)
        self._laser_mode_is_certain = True
        self._format_calls["ct"] = Call("ct", self.wire_state.mask.smask)

    def _update_format(self, call: Call) -> Callable[[], None]:
        """Update the format of replies before a call is sent, which may take effect even if no reply arrives.

        Returns a function that reverts the change, for a call that was refused.
        """
        if self._validator:
            self._validator.update_from_request(call)
        if call.name not in _FORMAT_COMMANDS:
            return lambda: None
        before, calls = self.wire_state.copy(), dict(self._format_calls)
        codec.update_from_request(call, self.wire_state)
        self._format_calls[call.name] = call
        self._unconfirmed.add(call.name)

        def revert() -> None:
            self.wire_state, self._format_calls = before, calls
            self._unconfirmed.discard(call.name)

        return revert


@lru_cache(maxsize=256)
def _encode(call: Call, model: Model) -> bytes:
    """Return the bytes of a request, cached: programs repeat the same few, and the bytes depend on the model alone."""
    return codec.encode_serial_request(call, serial_wire_state(model))


def send_emergency_stop(stream: ByteStream, timeout_s: float, clock: Callable[[], float],
                        on_sent: Callable[[], object]) -> SerialFrame:
    """Send st as the first bytes of a session, before handshake and mask.

    The bytes of st and the type of its reply are the same for every model and mask: a robot can be stopped even if
    its replies cannot be decoded.

    Parameters
    ----------
    stream
        A newly opened line.
    timeout_s
        Maximum time for each of at most three replies, in seconds.
    clock
        Seconds.
    on_sent
        Called before each st.

    Returns
    -------
    SerialFrame
        A frame of st's reply type with a valid checksum.

    Raises
    ------
    ReplyTimeout, ConnectionLost
        If no such frame arrives.
    """
    line_type = codec.find_command("st").line_type
    assert line_type is not None
    request = codec.encode_serial_request(Call("st"), serial_wire_state(N150))
    for _ in range(STOP_ATTEMPTS):
        on_sent()
        # A new link each time: for it, a late reply to an earlier st is a reply.
        link = SerialLink(stream, LinkStatistics(), clock)
        try:
            frame = link.request(line_type, request, timeout_s)
        except ReplyTimeout:
            continue
        if frame.type != NAK_TYPE:
            return frame
    raise ReplyTimeout(f"st was not answered within {timeout_s:g} s, {STOP_ATTEMPTS} times")
