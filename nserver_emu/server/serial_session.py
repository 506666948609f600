"""A session on a robot's own serial line, without I/O: bytes in, bytes out (docs/protocol.md, On a serial line).

    receive(bytes) -> framer -> queue -> answer(call, context) -> state packets, replies of get_ commands, NAK
                                               `- deferred (ws, zr, arm): tick() polls until the reply exists

The line belongs to one robot, so there is no CONNECT. Mask and laser mode belong to the robot too: they stay in force
when a host disconnects and apply to all its lines. Commands that the model lacks, wrong data and refused commands get a
NAK; bytes that form no frame get no reply, and the host repeats its request.

A host sends one request at a time. A new request during a deferred reply means that the host gave up on that reply, so
it is cancelled; `st` therefore works during `ws` (project decision: no source says what the original does).
"""

from collections.abc import Callable
from typing import Final

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import HOST_LIMIT, SerialFrame, SerialFramer
from nclient.protocol.types import BUMPER_SLOT, Model, Stamp
from nclient.protocol.wire_state import WireState, serial_wire_state
from nserver_emu.server.session import Answer, BaseSession, ConnectionContext

# Seconds after its first byte within which a frame must be complete: half of a host's timeout, and twice the duration
# of a host's longest frame at 9600 baud. After that its bytes are searched for frames inside it.
FRAME_TIMEOUT_S: Final = 0.5
# Decoded requests cached by their bytes: most hosts repeat the same few requests.
MAX_CACHED_CALLS: Final = 256
NAK: Final = Reply("nak")
_POSITION_SLOTS: Final = (34, 35)
# Limits of sign-magnitude numbers of two and four bytes.
_MAX_SHORT, _MAX_LONG = 0x7FFF, 0x7FFFFFFF


class SerialSession(BaseSession[SerialFrame]):
    """A session with one host on the line of a robot.

    Parameters
    ----------
    answer
        Executes calls.
    robot_id, model
        The robot of this line.
    clock
        Monotonic seconds of any origin.
    name
        Name of the line in logs.
    wire_state
        Mask and laser mode in force on the robot's lines; None for those at power-on.
    """

    def __init__(
        self,
        answer: Answer,
        robot_id: int,
        model: Model,
        clock: Callable[[], float],
        name: str = "line",
        wire_state: WireState | None = None,
    ) -> None:
        super().__init__(answer, name, ConnectionContext(wire_state or serial_wire_state(model), robot_id))
        self.model = model
        self._clock = clock
        self._framer = SerialFramer(limit=HOST_LIMIT)
        # Time of the first byte of the incomplete frame; None if there is none.
        self._frame_start_s: float | None = None
        # Frames and skipped bytes when that time was taken: a change means that another frame is first now.
        self._progress = (0, 0)
        self._cached_calls: dict[SerialFrame, Call] = {}

    @property
    def greeting(self) -> bytes:
        """The handshake that a N200 sends when a host connects over TCP; empty for other models."""
        wire_state = self.context.wire_state
        return build_handshake(Handshake(wire_state.mask, wire_state.laser_mode)) if self.model.sends_mask else b""

    @property
    def unfinished(self) -> int:
        """Return the number of buffered bytes of an incomplete frame."""
        return self._framer.pending

    @property
    def skipped_bytes(self) -> int:
        """Number of bytes that belonged to no frame."""
        return self._framer.skipped_bytes

    @property
    def ready(self) -> bool:
        """Return True if a request can be answered now."""
        # A deferred reply does not block the next request: it is cancelled.
        return bool(self._queue) and not self.closing

    def receive(self, data: bytes) -> None:
        """Add bytes from the host, after dropping a frame that took too long."""
        if self.closing:
            return
        self._drop_expired_frame()
        self._queue.extend(self._framer.receive(data))
        if self._framer.pending or self._frame_start_s is not None:
            self._update_frame_start()

    def tick(self) -> bytes:
        """Return the deferred reply if it exists now; also drop an expired frame, which frees those behind it."""
        if self._framer.pending:
            self._drop_expired_frame()
        return super().tick()

    def _update_frame_start(self) -> None:
        """Take the time if an incomplete frame has become the first one."""
        progress = (self._framer.frames, self._framer.skipped_bytes)
        if self._framer.pending and (progress != self._progress or self._frame_start_s is None):
            self._frame_start_s = self._clock()
        elif not self._framer.pending:
            self._frame_start_s = None
        self._progress = progress

    def _drop_expired_frame(self) -> None:
        if self._frame_start_s is not None and self._clock() - self._frame_start_s > FRAME_TIMEOUT_S:
            self._queue.extend(self._framer.expire())
            self._update_frame_start()

    def _process_one(self, request: SerialFrame) -> bytes:
        self._deferred = None
        wire_state = self.context.wire_state
        call = self._cached_calls.get(request)
        if call is None:
            try:
                call = codec.decode_serial_request(request, wire_state)
            except WireError as error:
                self._count_refused(f"type {request.type}", str(error))
                return codec.encode_serial_reply(BY_NAME["gs"], NAK, wire_state)
            if len(self._cached_calls) < MAX_CACHED_CALLS:
                self._cached_calls[request] = call
        codec.update_from_request(call, wire_state)
        return self._reply_or_defer(call.name, self._answer(call, self.context))

    def _encode_anew(self, name: str, reply: Reply) -> bytes:
        if reply.kind == "error":
            reason = f"{name}: error {reply.values[0]}"
            self._count_refused(reason, reason)
            reply = NAK
        return codec.encode_serial_reply(BY_NAME[name], to_line_units(reply, self.model), self.context.wire_state)


def to_line_units(reply: Reply, model: Model) -> Reply:
    """Return the reply as a line carries it: bumper bits with their rest value, positions clamped to +-3276.7 in."""
    changed = {slot: _clamp(reply.slots[slot], _MAX_SHORT) for slot in _POSITION_SLOTS if slot in reply.slots}
    if BUMPER_SLOT in reply.slots:
        changed[BUMPER_SLOT] = reply.slots[BUMPER_SLOT] | model.bumper_rest
    if not changed and not reply.stamps:
        return reply
    stamps = {key: _clamp_stamp(stamp) for key, stamp in reply.stamps.items()}
    slots = {**reply.slots, **changed}
    return Reply(reply.kind, slots, reply.laser, stamps, reply.clock, reply.volts, reply.values)


def _clamp_stamp(stamp: Stamp) -> Stamp:
    return stamp._replace(x=_clamp(stamp.x, _MAX_LONG), y=_clamp(stamp.y, _MAX_LONG))


def _clamp(number: int, limit: int) -> int:
    return max(-limit, min(limit, number))
