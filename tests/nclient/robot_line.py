"""A robot on its own line that says what a test tells it to, built on the protocol room alone, in this process.

    ScriptedLine(answers)    send, receive, close: what MemoryStream wants; `calls` are the commands that came
    RecordedRobot(session)   the same, of the recorded sessions: it insists on the C library's bytes

An answer is a Reply, bytes as they are, None for silence, or Late(reply): it comes only when the next command has.
A list of answers is used up one a command; then the dull one comes. Rules: no emulator, no clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from nclient.backends.direct import DirectBackend
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFramer
from nclient.protocol.types import EVERYTHING, N150, Model
from nclient.protocol.wire_state import serial_wire_state
from nclient.transports.memory import MemoryStream
from tests.nclient.protocol.recorded import SERIAL, exchanges, model_of

NAK = Reply("nak")
SONARS = {slot: 40 + slot for slot in range(17, 33)}


@dataclass(frozen=True)
class Late:
    """An answer that comes after the next command was heard, before that one's own."""

    reply: Reply | None = None
    """None: the dull one."""


Answer = Reply | bytes | Late | None


class ScriptedLine:
    """Answers each command as told, else in the dullest way that fits. `slots`: what State is; the clock goes on."""

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
            self.clock += 16
            self.out += self._late
            self._late = b""
            self._answer(call)

    def receive(self) -> bytes:
        data, self.out = bytes(self.out), bytearray()
        return data

    def close(self) -> None:
        self.closed += 1

    def names(self) -> list[str]:
        """The C names of the commands that came, in order."""
        return [call.name for call in self.calls]

    def state(self) -> Reply:
        """The state packet as things are."""
        return Reply("state", dict(self.slots), self.laser, clock=self.clock, volts=self.volts)

    def frame(self, name: str, reply: Reply | None = None) -> bytes:
        """The bytes of an answer to a command, the dull one by itself."""
        return codec.encode_serial_reply(BY_NAME[name], reply or self._dull(name), self.wire_state)

    def _answer(self, call: Call) -> None:
        told = self.answers.get(call.name, self._dull(call.name))
        if isinstance(told, list):
            told = told.pop(0) if told else self._dull(call.name)
        if told is not None and told != NAK:
            codec.update_from_request(call, self.wire_state)
        if isinstance(told, Late):
            self._late += self.frame(call.name, told.reply)
        elif isinstance(told, Reply):
            self.out += self.frame(call.name, told)
        elif told:
            self.out += told

    def _dull(self, name: str) -> Reply:
        layout = BY_NAME[name].line_reply
        if layout.kind == "special":
            return Reply("special", values=(12, 0, 0, 40, 1, 0, 0, 0, 2, 0, 0, 0))
        if name == "conf_cp":
            return Reply("compass", values=(1, 2, 3))
        if name == "get_ra":
            return Reply("velocity")
        return replace(self.state(), kind=layout.kind)


def direct_on(robot: ScriptedLine, *, hello: bool = False) -> DirectBackend:
    """A direct backend whose robot the script is."""
    return DirectBackend(MemoryStream(robot), robot.model, hello=hello)


def spoiled(frame: bytes, at: int = 6) -> bytes:
    """The frame with one byte changed."""
    return frame[:at] + bytes((frame[at] ^ 0x10,)) + frame[at + 1 :]


class RecordedRobot:
    """The robot of a recorded session: its bytes for the host's, in order. Closed before the end is a failure."""

    def __init__(self, session: str) -> None:
        self.exchanges = list(exchanges(SERIAL[session], model_of(session)))
        self.out = build_handshake(Handshake(EVERYTHING, 51)) if session == "n200_tcp" else b""
        self._position = 0

    def send(self, data: bytes) -> None:
        exchange = self.exchanges[self._position]
        assert data == exchange.request, exchange.call
        self.out += exchange.reply
        self._position += 1

    def receive(self) -> bytes:
        data, self.out = self.out, b""
        return data

    def close(self) -> None:
        assert self._position == len(self.exchanges)
