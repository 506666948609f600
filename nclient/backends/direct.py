"""Questions and answers on a robot's line, which numbers neither: whose answer is it that comes?

    owed:  gs get_rv pr          a get_rv comes: it is that one's, the gs is lost; a gs comes: the gs was only late

Rules: a robot answers in the order in which it was asked, and a line never changes an order. So a frame is laid to
the earliest question of its type that is still owed an answer, and whatever was asked before that is lost; the last
question has its answer when nothing is owed any more. Bytes and types only; what they mean is direct.py's.

A robot on its own line: the direct language over a stream of bytes, which is never clean.

    ct, or the hello of a N200 over TCP ──> command ──> the answer of its type, a NAK, or silence ──> command ...

Rules: a command goes out once, after the input was emptied. A bad answer or none is ReplyTimeout, and the
conversation stays usable, as with the C library. But a late answer is never taken for another command's
(docs/decisions/017): while an answer of a command's type is owed, a question of another type is asked first, and
once that is answered nothing of before can come. What a model's line does not have is refused here and not sent.

st as the very first bytes of a conversation on a robot's line: before its hello, its mask, or anything else.

    open ──> st ──> a frame of st's type with a good checksum, whatever it holds ──> hello, ct, gs ...

Rules: the bytes of st are the same for every model and mask, and so is the type of its answer: a robot that cannot be
understood can still be stopped. Nothing is known of the robot here, and nothing is learned but what the frame holds.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from functools import lru_cache

from nclient.backends.base import LinkStatistics, in_pieces, is_wait
from nclient.backends.validation import Plausibility
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol import codec
from nclient.protocol.client_state import HANDSHAKE_SIZE, apply_handshake, read_handshake
from nclient.protocol.codec import BYTE_HIGHEST
from nclient.protocol.commands import NAK_TYPE, Call, Command, exists_on_serial
from nclient.protocol.decode import guess_model, model_mismatch_hint
from nclient.protocol.replies import LINE_STATE, Reply
from nclient.protocol.serial_framing import SMALLEST_FRAME, SerialFrame, SerialFramer
from nclient.protocol.types import EVERYTHING, N150, Model
from nclient.protocol.wire_state import DEFAULT_LASER_MODE, LINES, WireState, serial_wire_state
from nclient.transports.stream import ByteStream, Deadline

GAP_S = 0.25
"""Silence within an answer after which no more of it comes: bytes are 0.3 ms apart, a radio modem's bursts 0.1 s."""
QUIET_S = 2.0
"""Silence after which a late answer comes no more, where there is no other way to know."""
_LONGEST_QUIET_S = 10.0
_FLUSHES = 64
"""Pieces of input thrown away before a question; a line that babbles on is asked all the same."""


class Line:
    """One end of a line. `clock`: seconds, of which every wait and every latency is."""

    def __init__(self, stream: ByteStream, link: LinkStatistics, clock: Callable[[], float] = time.monotonic) -> None:
        self._stream = stream
        self._link = link
        self._clock = clock
        self._framer = SerialFramer()
        self._owed: list[int] = []
        self._asked_s = 0.0

    def deadline(self, seconds: float) -> Deadline:
        """So many seconds from now."""
        return Deadline.after(seconds, self._clock)

    def owes(self, frame_type: int | None) -> bool:
        """Whether an answer of this type may still come late."""
        return frame_type in self._owed

    def ask(self, frame_type: int, request: bytes, patience_s: float) -> SerialFrame:
        """Send a question and give the frame that answers it, or a NAK. Raises ReplyTimeout and ConnectionLost.

        Nothing of this type should be owed: else its late answer is waited for and dropped first.
        """
        self.empty_input()
        self._owed.append(frame_type)
        self._link.exchanges += 1
        self._asked_s = self._clock()
        self._stream.send(request)
        try:
            return self._answer(patience_s)
        finally:
            self._count()

    def took(self) -> None:
        """The last answer is believed: count it, and the time that it took."""
        self._link.took(self._clock() - self._asked_s)

    def send(self, frame_type: int, request: bytes) -> None:
        """Send something whose answer nobody waits for, and which stays owed."""
        self._owed.append(frame_type)
        self._stream.send(request)

    def receive_bare(self, size: int, deadline: Deadline) -> bytes:
        """So many bytes that are no frame; as many as there are at the deadline."""
        data = b""
        try:
            while len(data) < size:
                data += self._stream.receive(deadline)
        except ReplyTimeout:
            pass
        return data[:size]

    def empty_input(self) -> None:
        """Take what has come, so that it answers nothing that is asked from now on."""
        try:
            for _ in range(_FLUSHES):
                for frame in self._framer.receive(self._stream.receive(self.deadline(0))):
                    self._is_awaited(frame)
                    self._link.strays += 1
        except ReplyTimeout:
            pass
        self._framer.clear()
        self._count()

    def wait_for_quiet(self) -> None:
        """Wait until what is late comes no more; then nothing is owed. Raises ReplyTimeout on a line that babbles."""
        limit = self.deadline(_LONGEST_QUIET_S)
        while limit.remaining():
            try:
                self._stream.receive(self.deadline(QUIET_S))
            except ReplyTimeout:
                self._owed.clear()
                return
        raise ReplyTimeout("the line is never quiet")

    def close(self) -> None:
        """Let the stream go."""
        self._stream.close()

    def _answer(self, patience_s: float) -> SerialFrame:
        """The frame that answers the last question. Raises ReplyTimeout at the deadline, or at a gap behind rubbish."""
        deadline, over = self.deadline(patience_s), False
        while not over:
            rubbish = self._framer.skipped_bytes + self._framer.pending
            wait = self.deadline(min(GAP_S, deadline.remaining())) if rubbish >= SMALLEST_FRAME else deadline
            try:
                frames = self._framer.receive(self._stream.receive(wait))
            except ReplyTimeout:
                frames, over = self._framer.expire(), True
            for frame in frames:
                if self._is_awaited(frame):
                    return frame
                self._link.strays += 1
        raise ReplyTimeout(f"{rubbish} bytes came and no answer" if rubbish else f"no answer within {patience_s:g} s")

    def _is_awaited(self, frame: SerialFrame) -> bool:
        """Lay a frame to the earliest question that it can answer; whether that is the last one.

        While others are owed, a NAK may be any's, and counts as nobody's.
        """
        if frame.type in self._owed:
            del self._owed[: self._owed.index(frame.type) + 1]
        elif frame.type == NAK_TYPE and len(self._owed) == 1:
            self._owed.clear()
        else:
            return False
        return not self._owed

    def _count(self) -> None:
        """Take over what the framer has counted."""
        framer, link = self._framer, self._link
        link.frames += framer.frames
        link.skipped_bytes += framer.skipped_bytes
        link.checksum_errors += framer.bad_checksums
        framer.frames = framer.skipped_bytes = framer.bad_checksums = 0


QUICK_S = 1.0
"""How long a host waits for what a robot answers at once."""
HELLO_S = 5.0
_GREETINGS = 3
_PROBES = ("get_ra", "get_rv", "get_rc", "get_bp", "get_sn")
"""Questions that every model answers, each with a type of its own, the shortest first."""
_SHAPING = ("ct", "conf_ls")
"""Commands that change the shape of the answers after them."""
_AT_ONCE = frozenset({"st", "lp"})
_NO_ANSWER = Reply("none")
_LINE_MODE, _PIXEL_MODE = 33, DEFAULT_LASER_MODE


class DirectBackend:
    """A conversation with a robot on its own line. `hello`: it says eleven bytes first (a N200 over TCP).

    `timeout_s`: for what is answered at once, 1 s where None; zr 120 s, ws its own time more, special packets 30 s.
    `checks`: answers that cannot be true count as corrupt. `clock`: seconds, by which all waiting goes, that of a
    simulation too. Raises ReplyTimeout or ConnectionLost when greeting fails.
    """

    def __init__(
        self,
        stream: ByteStream,
        model: Model,
        *,
        hello: bool = False,
        timeout_s: float | None = None,
        checks: bool = True,
        link: LinkStatistics | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.timeout_s = QUICK_S if timeout_s is None else timeout_s
        self._link = link or LinkStatistics()
        self._line = Line(stream, self._link, clock)
        self._wire_state = serial_wire_state(model)
        self._plausible = Plausibility(model) if checks else None
        self._shaped: dict[str, Call] = {}
        self._doubtful_shapes: set[str] = set()
        self._laser_mode_said = False
        self._understood = False
        self._over: str | None = None
        try:
            if hello:
                self._adopt_hello()
            self._greeting = None if hello else self._send_mask()
        except BaseException:
            self._finish("connecting failed")
            raise

    @property
    def wire_state(self) -> WireState:
        """Model, mask and laser mode of this conversation."""
        return self._wire_state

    @property
    def greeting(self) -> Reply | None:
        """The state that a N200 answered to its mask; the others are not asked anything."""
        return self._greeting

    @property
    def port(self) -> int:
        """What connect_robot of the C library gives back."""
        return 1

    @property
    def closed(self) -> bool:
        """Whether the conversation is over."""
        return self._over is not None

    @property
    def link(self) -> LinkStatistics:
        """What the line has been through."""
        return self._link

    def execute(self, call: Call) -> Reply:
        """The answer to a call. Raises ReplyTimeout, RobotRefused, WireError and stays usable, or ConnectionLost."""
        if self._over is not None:
            raise ConnectionLost(f"{call.name}: {self._over}; connect again")
        row = codec.find_command(call.name)
        if row.name == "place_robot":
            x, y, steering, turret = call.args
            self.execute(Call("dp", (x, y)))
            return self.execute(Call("da", (steering, turret)))
        if row.name == "disconnect_robot":
            self.close()
            return _NO_ANSWER
        if is_wait(call) and call.args[3] > BYTE_HIGHEST:
            return in_pieces(call, BYTE_HIGHEST, self.execute)
        self._refuse(row)
        request = _request(call, self._wire_state.model)
        try:
            self._settle(row, request)
            return self._ask(row, call, request)
        except ConnectionLost as error:
            self._finish(str(error))
            raise ConnectionLost(f"{row.name}: {self._over}") from error

    def close(self) -> None:
        """Leave; there is no word for it. What is in `execute` on another thread gets ConnectionLost."""
        self._finish("this side closed the line")

    def _finish(self, why: str) -> None:
        if self._over is None:
            self._over = why
            self._line.close()

    # one exchange

    def _refuse(self, row: Command) -> None:
        """What this model's line does not have is not sent."""
        model = self._wire_state.model
        if row.line_type is None:
            raise RobotRefused(row.name, None, "exists only on an Nserver, not on a robot's own line")
        if not exists_on_serial(row, model):
            raise RobotRefused(row.name, None, f"a {model.name} does not have it on its own line")

    def _ask(self, row: Command, call: Call, request: bytes) -> Reply:
        undo = self._agree(call)
        frame = self._exchange(row, request, self._patience_s(row, call))
        if frame.type == NAK_TYPE:
            self._link.naks += 1
            self._line.took()
            undo()
            raise RobotRefused(row.name, None)
        reply = self._believed(row, frame)
        self._doubtful_shapes.discard(row.name)
        self._line.took()
        return reply

    def _exchange(self, row: Command, request: bytes, patience_s: float) -> SerialFrame:
        assert row.line_type is not None
        try:
            return self._line.ask(row.line_type, request, patience_s)
        except ReplyTimeout as error:
            raise self._failed(f"{row.name}: {error}") from None

    def _believed(self, row: Command, frame: SerialFrame) -> Reply:
        """The reply in a frame. Raises ReplyTimeout for one that does not fit, or that cannot be true."""
        try:
            reply = self._read(frame)
        except WireError as error:
            self._link.misfits += 1
            self._doubtful_shapes.update(self._shaped)
            why = f"{row.name} was answered by what does not fit it: {error}"
            raise self._failed(why + self._of_another_model(row, frame)) from None
        doubt = self._plausible.doubt(reply) if self._plausible else ""
        if doubt:
            self._link.implausible += 1
            raise self._failed(f"{row.name}: the answer cannot be true, {doubt}; checks=0 turns such checks off")
        self._understood = True
        return reply

    def _read(self, frame: SerialFrame) -> Reply:
        """The reply. A laser that an earlier client left in another mode shows by the length, until conf_ls is said."""
        try:
            return codec.decode_serial_reply(frame, self._wire_state)
        except WireError:
            if self._laser_mode_said or "conf_ls" in self._shaped or not self._wire_state.model.has_laser:
                raise
            other = self._wire_state.copy()
            other.set_laser_mode(_PIXEL_MODE if other.laser_width == LINES else _LINE_MODE)
            with contextlib.suppress(WireError):
                reply = codec.decode_serial_reply(frame, other)
                self._wire_state = other
                return reply
            raise

    def _of_another_model(self, row: Command, frame: SerialFrame) -> str:
        """A hint, where nothing was understood yet and the answer looks like another model's."""
        like = guess_model(frame.data) if row.line_reply is LINE_STATE and not self._understood else None
        if like is None or like is self._wire_state.model:
            return ""
        return "; " + model_mismatch_hint(self._wire_state.model, frame.data)

    def _failed(self, why: str) -> ReplyTimeout:
        self._link.timeouts += 1
        return ReplyTimeout(why)

    def _patience_s(self, row: Command, call: Call) -> float:
        own_s = float(call.args[3]) if row.name == "ws" else 0.0
        return own_s + (self.timeout_s if row.line_timeout_s <= QUICK_S else max(self.timeout_s, row.line_timeout_s))

    # before it

    def _settle(self, row: Command, request: bytes) -> None:
        """See to it that no answer owed to an earlier command can pass for this one's, and what shape answers have."""
        assert row.line_type is not None
        if self._line.owes(row.line_type) and row.name in _AT_ONCE:
            self._line.send(row.line_type, request)
        self._see_off(row, row)
        for name in sorted(self._doubtful_shapes - {row.name}, key=_SHAPING.index):
            again, shaping = self._shaped[name], codec.find_command(name)
            self._see_off(shaping, row)
            self._ask(shaping, again, _request(again, self._wire_state.model))

    def _see_off(self, row: Command, wanted: Command) -> None:
        """While an answer like this row's is owed, ask something of a type that is not; after that none can come."""
        if self._line.owes(row.line_type):
            self._line.empty_input()
        if not self._line.owes(row.line_type):
            return
        probes = (codec.find_command(name) for name in _PROBES)
        probe = next((probe for probe in probes if not self._line.owes(probe.line_type)), None)
        try:
            if probe is None:
                self._line.wait_for_quiet()
            else:
                self._exchange(probe, _request(Call(probe.name), self._wire_state.model), self.timeout_s)
                self._line.took()
        except ReplyTimeout as error:
            raise ReplyTimeout(
                f"{wanted.name} was held back, since a late answer could have passed for its own: {error}"
            ) from None

    # what is agreed

    def _send_mask(self) -> Reply | None:
        """ct to a N200; N150 and Scout have a fixed mask and are told nothing."""
        if not self._wire_state.model.sends_mask:
            return None
        mask = Call("ct", EVERYTHING.smask)
        for _ in range(_GREETINGS - 1):
            with contextlib.suppress(ReplyTimeout, RobotRefused):
                return self.execute(mask)
        try:
            return self.execute(mask)
        except ReplyTimeout as error:
            raise ReplyTimeout(f"{error}; {self._is_it_another()}") from None
        except RobotRefused:
            raise RobotRefused("ct", None, f"NAK; {self._is_it_another()}") from None

    def _is_it_another(self) -> str:
        return model_mismatch_hint(self._wire_state.model)

    def _adopt_hello(self) -> None:
        data = self._line.receive_bare(HANDSHAKE_SIZE, self._line.deadline(HELLO_S))
        if len(data) < HANDSHAKE_SIZE:
            raise ReplyTimeout(
                f"a N200 says {HANDSHAKE_SIZE} bytes first, and {len(data)} came; {self._is_it_another()}"
            )
        apply_handshake(read_handshake(data), self._wire_state)
        self._laser_mode_said = True
        self._shaped["ct"] = Call("ct", self._wire_state.mask.smask)

    def _agree(self, call: Call) -> Callable[[], None]:
        """A call is about to go out: what it changes, it may change though no answer comes. How to take it back."""
        if self._plausible:
            self._plausible.note(call)
        if call.name not in _SHAPING:
            return _nothing
        before, shaped = self._wire_state.copy(), dict(self._shaped)
        codec.update_from_request(call, self._wire_state)
        self._shaped[call.name] = call
        self._doubtful_shapes.add(call.name)

        def undo() -> None:
            self._wire_state, self._shaped = before, shaped
            self._doubtful_shapes.discard(call.name)

        return undo


@lru_cache(maxsize=256)
def _request(call: Call, model: Model) -> bytes:
    """Programs ask the same few things again and again; on a line their bytes hang on the model alone."""
    return codec.encode_serial_request(call, serial_wire_state(model))


def _nothing() -> None:
    """Nothing was agreed."""


ATTEMPTS = 3
"""How often st is said before the conversation is given up for a new one."""


def say_stop(
    stream: ByteStream, patience_s: float, clock: Callable[[], float], told: Callable[[], object]
) -> SerialFrame:
    """The frame that answers st; `told` is called for each st said. Raises ReplyTimeout, ConnectionLost."""
    line_type = codec.find_command("st").line_type
    assert line_type is not None
    request = codec.encode_serial_request(Call("st"), serial_wire_state(N150))
    for _ in range(ATTEMPTS):
        told()
        line = Line(stream, LinkStatistics(), clock)  # a new one: the late answer to an earlier st is one to this
        try:
            frame = line.ask(line_type, request, patience_s)
        except ReplyTimeout:
            continue
        if frame.type != NAK_TYPE:
            return frame
    raise ReplyTimeout(f"st was not answered within {patience_s:g} s, {ATTEMPTS} times")
