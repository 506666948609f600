"""A conversation on a robot's own line, without I/O: bytes in, bytes out, in the direct language (PROTOCOL.md, 2).

    receive(bytes) ──> framer ──> queue ──> answer(call, visit) ──> state packets, answers of get_, NAK
                                                └─ later (ws, zr, the arm): tick() asks again until there is one

Rules: the line is the robot's, so there is no CONNECT; who writes to it drives that robot. Mask and laser mode are the
robot's too: they stay in force when a host leaves, and hold on all its lines. What the model's line does
not have, wrong data and what the robot refuses get a NAK; what is no frame gets silence, and the host asks again.
A frame that is not whole `EXPIRY_S` after it began is given up, so that it hides those behind it no longer.
A host asks one thing at a time: one that asks while an answer is outstanding has given up on that answer, and does
not get it any more (decision of ours: so that st is heard during ws).
"""

from __future__ import annotations

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

EXPIRY_S: Final = 0.5
"""A frame must be whole so long after its first byte: half the time that a host waits, and twice what the longest
frame of a host takes at 9600 baud."""
MOST_KNOWN: Final = 256
"""Different requests of a host that are kept with what they mean: most hosts ask the same all the time."""
NAK: Final = Reply("nak")
_POSITION_SLOTS: Final = (34, 35)
_SHORT, _LONG = 0x7FFF, 0x7FFFFFFF
"""The farthest that sign-magnitude numbers of two and of four bytes go."""


class SerialSession(BaseSession[SerialFrame]):
    """One host on the line of robot `robot_id`. `clock`: seconds that only grow, of any beginning; `terms`: what is in
    force on that robot's lines, None: as at power-on."""

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
        self._begun_s: float | None = None
        self._progress = (0, 0)
        self._known: dict[SerialFrame, Call] = {}
        self._told: tuple[Reply | None, dict[str, bytes]] = (None, {})

    @property
    def greeting(self) -> bytes:
        """What the robot says first when it is reached over TCP: the hello of a N200, of others nothing."""
        wire_state = self.context.wire_state
        return build_handshake(Handshake(wire_state.mask, wire_state.laser_mode)) if self.model.sends_mask else b""

    @property
    def unfinished(self) -> int:
        return self._framer.pending

    @property
    def skipped_bytes(self) -> int:
        """Bytes that belonged to no frame."""
        return self._framer.skipped_bytes

    @property
    def ready(self) -> bool:
        return bool(self._queue) and not self.closing

    def receive(self, data: bytes) -> None:
        if self.closing:
            return
        self._expire()
        self._queue.extend(self._framer.receive(data))
        if self._framer.pending or self._begun_s is not None:
            self._note_beginning()

    def tick(self) -> bytes:
        """What time brings: the answer that was to come later, and those to frames behind one that is given up."""
        if self._framer.pending:
            self._expire()
        return super().tick()

    def _note_beginning(self) -> None:
        """A frame that has now come to the front began now, or since then: nobody looked before."""
        progress = (self._framer.frames, self._framer.skipped_bytes)
        if self._framer.pending and (progress != self._progress or self._begun_s is None):
            self._begun_s = self._clock()
        elif not self._framer.pending:
            self._begun_s = None
        self._progress = progress

    def _expire(self) -> None:
        if self._begun_s is not None and self._clock() - self._begun_s > EXPIRY_S:
            self._queue.extend(self._framer.expire())
            self._note_beginning()

    def _answer_one(self, request: SerialFrame) -> bytes:
        self._later = None
        wire_state = self.context.wire_state
        call = self._known.get(request)
        if call is None:
            try:
                call = codec.decode_serial_request(request, wire_state)
            except WireError as error:
                self._count_refusal(str(error))
                return codec.encode_serial_reply(BY_NAME["gs"], NAK, wire_state)
            if len(self._known) < MOST_KNOWN:
                self._known[request] = call
        codec.update_from_request(call, wire_state)
        return self._say(call.name, self._answer(call, self.context))

    def _encode(self, name: str, reply: Reply) -> bytes:
        if reply.kind == "error":
            self._count_refusal(f"{name}: error {reply.values[0]}")
            reply = NAK
        if reply.kind == "state":
            return self._state_frame(name, reply)
        return codec.encode_serial_reply(BY_NAME[name], as_the_line_has_it(reply, self.model), self.context.wire_state)

    def _state_frame(self, name: str, reply: Reply) -> bytes:
        """A state packet; the one reply that is told again and again between two steps is built once a command."""
        told, frames = self._told
        if told is not reply:
            frames = {}
            self._told = (reply, frames)
        if name not in frames:
            frames[name] = codec.encode_serial_reply(
                BY_NAME[name], as_the_line_has_it(reply, self.model), self.context.wire_state
            )
        return frames[name]


def as_the_line_has_it(reply: Reply, model: Model) -> Reply:
    """The reply in numbers that the line can carry: bumper bits as they rest, positions no farther than 3276.7 in."""
    changed = {slot: _within(reply.slots[slot], _SHORT) for slot in _POSITION_SLOTS if slot in reply.slots}
    if BUMPER_SLOT in reply.slots:
        changed[BUMPER_SLOT] = reply.slots[BUMPER_SLOT] | model.bumper_rest
    if not changed and not reply.stamps:
        return reply
    stamps = {key: _fitting(stamp) for key, stamp in reply.stamps.items()}
    slots = {**reply.slots, **changed}
    return Reply(reply.kind, slots, reply.laser, stamps, reply.clock, reply.volts, reply.values)


def _fitting(stamp: Stamp) -> Stamp:
    return stamp._replace(x=_within(stamp.x, _LONG), y=_within(stamp.y, _LONG))


def _within(number: int, farthest: int) -> int:
    return max(-farthest, min(farthest, number))
