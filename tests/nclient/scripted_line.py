"""A scripted robot on a serial line, in this process, built on nclient.protocol alone: no emulator, no clock.

    ScriptedLine(replies)    a peer for MemoryStream that replies by script; `calls` are the received commands
    RecordedRobot(session)   a peer that replays a recorded session and requires the C library's bytes

A scripted reply is a Reply, bytes, None for silence, or Late(reply), which arrives after the next command. A list is
consumed, one reply per command; after it the default reply is sent.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from nclient.backends.direct import DirectBackend
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFramer
from nclient.protocol.types import EVERYTHING, N150, Model, serial_wire_state
from nclient.transports.stream import MemoryStream
from tests.nclient.protocol.recorded import SERIAL, exchanges, model_of

NAK = Reply("nak")
# 57 to 72 in: each sonar has its own value, and none is that of an empty slot.
SONARS = {slot: 40 + slot for slot in range(17, 33)}


@dataclass(frozen=True)
class Late:
    """A reply that is sent after the next command was received, before the reply to that one."""

    reply: Reply | None = None
    """None: the default reply."""


Answer = Reply | bytes | Late | None


class ScriptedLine:
    """Replies by script, else with the default reply. `slots` is its State; its clock advances with each command."""

    def __init__(self, answers: Mapping[str, Answer | list[Answer]] | None = None, model: Model = N150) -> None:
        self.answers: dict[str, Answer | list[Answer]] = dict(answers or {})
        self.model = model
        self.slots: dict[int, int] = dict.fromkeys(range(1, 44), 0) | SONARS | {33: model.bumper_rest}
        self.clock = 1000
        self.volts = (200, 210)
        self.laser: tuple[int, ...] = (0,)
        self.calls: list[Call] = []
        self.requests = bytearray()
        self.closed = 0
        self.wire_state = serial_wire_state(model)
        self.out = bytearray()
        self._late = b""
        self._framer = SerialFramer()

    def send(self, data: bytes) -> None:
        self.requests += data
        for frame in self._framer.receive(data):
            call = codec.decode_serial_request(frame, self.wire_state)
            self.calls.append(call)
            # A robot's clock advances in steps of about 16 ms.
            self.clock += 16
            # What is late precedes the reply to the command that has just arrived: a line does not reorder.
            self.out += self._late
            self._late = b""
            self._answer(call)

    def receive(self) -> bytes:
        data, self.out = bytes(self.out), bytearray()
        return data

    def close(self) -> None:
        self.closed += 1

    def names(self) -> list[str]:
        """Return the C names of the received commands, in order."""
        return [call.name for call in self.calls]

    def state(self) -> Reply:
        """Return the current state packet."""
        return Reply("state", dict(self.slots), self.laser, clock=self.clock, volts=self.volts)

    def frame(self, name: str, reply: Reply | None = None) -> bytes:
        """Return the bytes of a reply to a command, by default of the default reply."""
        return codec.encode_serial_reply(BY_NAME[name], reply or self._default_reply(name), self.wire_state)

    def _answer(self, call: Call) -> None:
        reply = self.answers.get(call.name, self._default_reply(call.name))
        if isinstance(reply, list):
            reply = reply.pop(0) if reply else self._default_reply(call.name)
        # A robot that received and accepted the command changes the format of its replies.
        if reply is not None and reply != NAK:
            codec.update_from_request(call, self.wire_state)
        if isinstance(reply, Late):
            self._late += self.frame(call.name, reply.reply)
        elif isinstance(reply, Reply):
            self.out += self.frame(call.name, reply)
        elif reply:
            self.out += reply

    def _default_reply(self, name: str) -> Reply:
        layout = BY_NAME[name].line_reply
        if layout.kind == "special":
            # A packet header of 12 bytes and type 40, then the int32 values 1 and 2: a result and a remaining time.
            return Reply("special", values=(12, 0, 0, 40, 1, 0, 0, 0, 2, 0, 0, 0))
        if name == "conf_cp":
            return Reply("compass", values=(1, 2, 3))
        if name == "get_ra":
            return Reply("velocity")
        return self.state()._replace(kind=layout.kind)


def direct_on(robot: ScriptedLine, *, hello: bool = False) -> DirectBackend:
    """Return a direct backend on a scripted line."""
    return DirectBackend(MemoryStream(robot), robot.model, hello=hello)


def spoiled(frame: bytes, at: int = 6) -> bytes:
    """Return the frame with one byte changed."""
    # A bit in the middle of the byte, so that it does not become a start or an end byte.
    return frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :]


class RecordedRobot:
    """Replay a recorded session in order; closing before its end is a failure."""

    def __init__(self, session: str) -> None:
        self.exchanges = list(exchanges(SERIAL[session], model_of(session)))
        self.out = build_handshake(Handshake(EVERYTHING, 51)) if session == "n200_tcp" else b""
        self._position = 0

    def send(self, data: bytes) -> None:
        exchange = self.exchanges[self._position]
        # The client must send exactly the bytes that the C library sent.
        assert data == exchange.request, exchange.call
        self.out += exchange.reply
        self._position += 1

    def receive(self) -> bytes:
        data, self.out = self.out, b""
        return data

    def close(self) -> None:
        assert self._position == len(self.exchanges)
