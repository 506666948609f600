"""Recorded traffic as plain dictionaries, one per line: the output of `nomad wire decode`.

    > hex    to the robot   {"to": "robot", "call": C name, "args": [...]}, and pid, mask or packet_type where sent
    < hex    from it        {"to": "host", "reply": kind, "State": [45], "Laser", "positions", "clock", "volt_cpu",
                             "volt_motor"}, as the client stores them after it, and values that only this reply has
    anything else           {"error": what is wrong}, also for empty lines and comments; changes no state

A valid request changes mask and laser layout at once, as at both ends.

Also here: guessing the robot's model from a state packet that does not fit, for error messages.

    N200              the length of its full mask, with pixels or lines    N150, Scout    their fixed length
    N150 or Scout     the four bits of the first bumper byte that always read 1 on a N150
"""

import contextlib
import struct
from collections import deque
from typing import Any

from nclient.errors import WireError
from nclient.protocol import client_state, codec, serial_framing, types
from nclient.protocol import replies as shape
from nclient.protocol.client_state import STATE_SIZE, ClientState, zero_extend
from nclient.protocol.codec import TcpFrame, reply_bounds, request_bounds
from nclient.protocol.commands import BY_LINE_TYPE, BY_NAME, ERROR_TYPE, REPLY_TYPES, Call, Command
from nclient.protocol.replies import LINE_STATE, Reply, TcpLayout
from nclient.protocol.types import N150, N200, SCOUT, Model, WireState, serial_wire_state, tcp_wire_state, volts

WIRES = ("tcp", "tcp64", "serial")
"""Protocols: Nserver's for 32-bit and 64-bit clients, and the robot's own serial line."""
TO_ROBOT, TO_HOST = ">", "<"
# Requests of old recordings may have no replies: the oldest are forgotten.
MAX_OUTSTANDING = 256

SAME_SHAPE = {81: 80, 90: 89}
"""Reply types of old servers (moved, acceleration) with the layout of another type."""
BY_REPLY_TYPE: dict[int, tuple[TcpLayout, ...]] = {
    80: (shape.STATE,), 82: (shape.SIMPLE_LIST,), 83: (shape.INFRARED,), 84: (shape.SONAR,),
    85: (shape.LASER, shape.SEGMENTS), 86: (shape.COMPASS,), 87: (shape.BUMPER,), 88: (shape.CONFIGURATION,),
    89: (shape.VELOCITY,), ERROR_TYPE: (shape.ERROR,), 300: (shape.SPECIAL,), 1000: (shape.TRUTH,),
    1001: (shape.CONTROL,),
}
"""Layouts by reply type over TCP, tried in this order if the request was not seen."""
# Slots of the State vector of predict_sensors that hold a prediction: infrared and sonar.
_PREDICTED = range(1, 33)
_FLOAT32 = struct.Struct("<f")


class WireDecoder:
    """Decoder of the traffic of one connection, in both directions.

    Over TCP a reply belongs to the first outstanding request whose type and layout it fits, and earlier ones are
    discarded; a reply that fits none is read by its type. `tcp64` shows numbers unsigned, as that client stores them.

    Parameters
    ----------
    wire
        One of WIRES.
    model
        The robot's model.
    """

    def __init__(self, wire: str, model: Model) -> None:
        if wire not in WIRES:
            raise WireError(f"no line {wire!r}; there are {', '.join(WIRES)}")
        wide = wire == "tcp64"
        self._ends: _Ends = _LineEnds(model) if wire == "serial" else _TcpEnds(model, wide)
        self._wide = wide
        self.client_state = ClientState(wide)

    @property
    def wire_state(self) -> WireState:
        """Return the current state of the connection; it may be changed."""
        return self._ends.wire_state

    def set_wire_state(self, wire_state: WireState) -> None:
        """Replace the connection's state, for a connection whose beginning was not recorded."""
        self._ends.wire_state = wire_state.copy()

    def read(self, line: str) -> dict[str, Any]:
        """Decode one line of text: `>` or `<`, then one frame in hex; blanks are ignored."""
        direction, digits = line.strip()[:1], line.strip()[1:]
        if direction not in (TO_ROBOT, TO_HOST):
            return {"error": "a line starts with > (to the robot) or < (from it), then hex"}
        try:
            data = bytes.fromhex(digits)
        except ValueError:
            return {"error": "what follows > or < is not hex: two digits a byte"}
        return self.request(data) if direction == TO_ROBOT else self.reply(data)

    def expect(self, name: str) -> None:
        """Expect a reply to the command of that C name next, as if its request had been decoded."""
        self._ends.expect(codec.find_command(name))

    def request(self, data: bytes) -> dict[str, Any]:
        """Decode one frame to the robot."""
        try:
            call = self._ends.call(data)
        except WireError as error:
            return {"error": str(error)}
        # Mask and laser mode apply to the reply of this very request.
        codec.update_from_request(call, self.wire_state)
        self._ends.expect(BY_NAME[call.name])
        return describe_call(call)

    def reply(self, data: bytes) -> dict[str, Any]:
        """Decode one frame from the robot."""
        try:
            answer = self._ends.answer(data)
        except WireError as error:
            return {"error": str(error)}
        # 1. The handshake of an N200 is no reply to a request.
        if isinstance(answer, client_state.Handshake):
            mask = list(answer.mask.smask)
            return {"to": "host", "reply": "hello", "mask": mask, "laser_mode": answer.laser_mode}
        # 2. A reply changes the client's state, which is shown as a whole.
        reply, name = answer
        self.client_state.apply_reply(reply)
        # A 64-bit client stores words without sign extension.
        shown = zero_extend(reply) if self._wide else reply
        fields = describe_client_state(self.client_state) | _reply_values(shown, name)
        return {"to": "host", "reply": reply.kind} | fields


def describe_call(call: Call) -> dict[str, Any]:
    """Return a call as a dictionary: `args` as in the C call, other arguments by name.

    connect_robot, disconnect_robot, create_robot: pid; ct: mask, 44 numbers; special_request: packet_type.
    """
    # Arguments that the C call does not have are taken out of the list and shown by name.
    args, extra = list(call.args), {}
    row = BY_NAME[call.name]
    if row.extra_arguments:
        name, place = row.extra_arguments
        values = args[place]
        del args[place]
        extra[name] = values if len(values) > 1 else values[0]
    return {"to": "robot", "call": call.name, "args": args} | extra


def describe_client_state(client_state: ClientState) -> dict[str, Any]:
    """Return the client's state as a dictionary, None where unset. Volts as single-precision floats, as in C."""
    cpu, motors = client_state.volts or (None, None)
    return {
        "State": list(client_state.slots), "Laser": None if client_state.laser is None else list(client_state.laser),
        "positions": {name: list(stamp) for name, stamp in client_state.stamps.items()}, "clock": client_state.clock,
        "volt_cpu": _shown_volts(cpu, types.CPU_RANGE_V), "volt_motor": _shown_volts(motors, types.MOTOR_RANGE_V),
    }  # fmt: skip


def _shown_volts(raw: int | None, full_range_v: float) -> float | None:
    if raw is None:
        return None
    return round(_single(volts(raw, _single(full_range_v))), 5)


def _single(value: float) -> float:
    """Round to single precision. The C client stores volts and the voltage ranges in floats."""
    (single,) = _FLOAT32.unpack(_FLOAT32.pack(value))
    return float(single)


def _reply_values(reply: Reply, name: str | None) -> dict[str, Any]:
    """Return the plain numbers of a reply, also by the names of the C call's results."""
    values = list(reply.values)
    if not values:
        return {}
    fields: dict[str, Any] = {"values": values}
    match reply.kind, name:
        case "error", _:
            fields["code"] = values[0]
        case "prediction", _:
            fields["pred_state"] = [values[k] if k in _PREDICTED else 0 for k in range(STATE_SIZE)]
            fields["pred_laser"] = list(reply.laser or ())
        case "special", _:
            fields |= {"special": values} | _arm_values(values, name)
        case _, "get_rpx" | "move_obstacle" | "get_robot_conf":
            fields["obs"] = values
        case _, "motion_check":
            fields["collide"] = [values[1] / 100, values[2] / 100, values[3] / 1e6]
    return fields


def _arm_values(values: list[int], name: str | None) -> dict[str, int]:
    data = bytes(value & 255 for value in values)
    fields: dict[str, int] = {}
    # Four bytes of packet header, then an int32 result, for arm_ws followed by the remaining time.
    if name in ("arm_zr", "arm_ws", "arm_mv") and len(data) >= 8:
        fields["arm"] = int.from_bytes(data[4:8], "little", signed=True)
    if name == "arm_ws" and len(data) >= 12:
        fields["remain"] = int.from_bytes(data[8:12], "little")
    return fields


class _TcpEnds:
    """Nserver over TCP: replies do not name their request, so the outstanding requests are queued."""

    def __init__(self, model: Model, wide: bool) -> None:
        self.wire_state = tcp_wire_state(model)
        self.wire_state.wide = wide
        self._outstanding: deque[tuple[Command, WireState]] = deque(maxlen=MAX_OUTSTANDING)

    def call(self, data: bytes) -> Call:
        return codec.decode_tcp_request(codec.parse_single_frame(data, request_bounds, self.wire_state.wide))

    def expect(self, row: Command) -> None:
        if row.has_tcp_reply and row.tcp_type is not None:
            self._outstanding.append((row, self.wire_state.copy()))

    def answer(self, data: bytes) -> tuple[Reply, str | None]:
        """Return a reply, and the C name of its request if that is certain."""
        # 1. One frame.
        frame = codec.parse_single_frame(data, reply_bounds, self.wire_state.wide)
        # 2. The first outstanding request that fits; earlier ones got no reply and are discarded.
        for place, (row, wire_state) in enumerate(self._outstanding):
            reply = _fitting(row, frame, wire_state)
            if reply:
                for _ in range(place + 1):
                    self._outstanding.popleft()
                return reply, row.name
        # 3. No outstanding request fits: the type alone decides.
        return self._by_type(frame), None

    def _by_type(self, frame: TcpFrame) -> Reply:
        *others, last = BY_REPLY_TYPE[SAME_SHAPE.get(frame.type, frame.type)]
        for layout in others:
            with contextlib.suppress(WireError):
                return codec.parse_tcp_payload(layout, frame.payload, self.wire_state)
        return codec.parse_tcp_payload(last, frame.payload, self.wire_state)


def _fitting(row: Command, frame: TcpFrame, wire_state: WireState) -> Reply | None:
    frame_type = SAME_SHAPE.get(frame.type, frame.type)
    if frame_type not in (ERROR_TYPE, REPLY_TYPES[row.tcp_reply]):
        return None
    try:
        return codec.decode_tcp_reply(row, frame, wire_state)
    except WireError:
        return None


class _LineEnds:
    """Serial line: a reply has the type of its command; only those of the arm's packets need the request."""

    def __init__(self, model: Model) -> None:
        self.wire_state = serial_wire_state(model)
        self._request: Command | None = None
        self._handshake_allowed = model.sends_mask

    def call(self, data: bytes) -> Call:
        return codec.decode_serial_request(serial_framing.parse_single_frame(data, serial_framing.HOST_LIMIT),
                                           self.wire_state)

    def expect(self, row: Command) -> None:
        self._request = row

    def answer(self, data: bytes) -> tuple[Reply, str | None] | client_state.Handshake:
        try:
            frame = serial_framing.parse_single_frame(data)
            reply = codec.decode_serial_reply(frame, self.wire_state)
        except WireError:
            # The handshake has no frame and no checksum: it is recognized by its length, and only as the first bytes.
            framed = data[:1] + data[-1:] == bytes((serial_framing.START, serial_framing.END))
            if not self._handshake_allowed or len(data) != client_state.HANDSHAKE_SIZE or framed:
                raise
            self._handshake_allowed = False
            handshake = client_state.read_handshake(data)
            client_state.apply_handshake(handshake, self.wire_state)
            return handshake
        self._handshake_allowed = False
        # Packets of the arm share one type, so the request distinguishes them.
        row = BY_LINE_TYPE.get(frame.type)
        if self._request and self._request.line_type == frame.type:
            row = self._request
        return reply, row.name if row else None


_Ends = _TcpEnds | _LineEnds


# A laser mode whose readings are lines: an N200's state is longer with it.
_LINE_MODE = 1


def guess_model(data: bytes) -> Model | None:
    """Return the model that sends a state packet like this one, None if it fits no model."""
    # An N150 and a Scout send packets of the same length; the bumper bits differ.
    fixed = _read(data, N150)
    if fixed is not None:
        return N150 if fixed.slots[types.BUMPER_SLOT] & N150.bumper_rest == N150.bumper_rest else SCOUT
    return N200 if _read(data, N200) or _read(data, N200, _LINE_MODE) else None


def model_mismatch_hint(model: Model, data: bytes | None = None) -> str:
    """Return what to try instead of this model: the one guessed from a state packet, else the other models."""
    guess = guess_model(data) if data is not None else None
    # No guess: name the other models.
    if guess is None:
        others = " or ".join(f"model={name}" for name in types.MODELS if name != model.name)
        return f"is it a {model.name}? Else write {others} in the address"
    if guess is model:
        return ""
    return f"it looks like a {guess.name}'s: write model={guess.name} in the address"


def _read(data: bytes, model: Model, laser_mode: int | None = None) -> Reply | None:
    wire_state = serial_wire_state(model)
    if laser_mode is not None:
        wire_state.set_laser_mode(laser_mode)
    try:
        return LINE_STATE.parse(data, wire_state)
    except WireError:
        return None
