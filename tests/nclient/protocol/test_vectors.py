"""Every recorded exchange: call to bytes and back, reply to the client's state and back."""

from __future__ import annotations

from typing import Any

import pytest

from nclient.protocol import codec
from nclient.protocol.client_state import ClientState
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds, request_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFramer
from nclient.protocol.types import (
    CPU_RANGE_V,
    EVERYTHING,
    MOTOR_RANGE_V,
    N200,
    WireState,
    serial_wire_state,
    tcp_wire_state,
    volts,
)
from tests.nclient.protocol.recorded import (
    LINE_SESSIONS,
    LP64,
    SERIAL,
    TCP,
    TCP_SESSIONS,
    Exchange,
    exchanges,
    model_of,
)

STAMP_NAMES = {f"pos_{key}": key for key in ("sonar_0", "sonar_15", "ir_0", "bumper", "laser", "compass")}


def with_leftovers_of(call: Call, built: bytes, request: bytes) -> bytes:
    """Clear words that the C client leaves undefined: the tail of a text, the end of motion_check."""
    # A line uses five words of eight: the last three words, 12 bytes, are whatever was in the client's buffer.
    if call.name == "motion_check" and call.args[0] == 0:
        return built[:-12] + request[-12:]
    # Over TCP (a first byte of 0) the last word holds the rest of the text and its NUL in its low bytes; the other
    # bytes are undefined.
    if call.name == "tk" and request[0] == 0:
        used = len(call.args[0]) % 4 + 1
        return built[:-4] + request[-4 : len(request) - used] + built[-used:]
    return built


def as_the_line_has_it(call: Call) -> Call:
    """Smask[41] is not sent on the line."""
    return Call("ct", (*call.args[:41], 1, *call.args[42:])) if call.name == "ct" else call


def check_held(held: ClientState, reply: Reply, decoded: dict[str, Any]) -> None:
    # The C library starts with zeros, where this client stores None.
    assert [value or 0 for value in held.slots] == decoded["State"]
    if "Laser" in decoded and held.laser is not None and held.laser[0]:
        # The C array still has readings of earlier replies behind the current ones.
        shown = min(len(held.laser), len(decoded["Laser"]))
        assert list(held.laser[:shown]) == decoded["Laser"][:shown]
    for name, key in STAMP_NAMES.items():
        if any(decoded.get(name, ())):
            assert list(held.stamps[key]) == decoded[name]
    if decoded.get("time"):
        assert held.clock == decoded["time"]
    if held.volts and "volt_cpu" in decoded:
        assert volts(held.volts[0], CPU_RANGE_V) == pytest.approx(decoded["volt_cpu"], abs=1e-5)
        assert volts(held.volts[1], MOTOR_RANGE_V) == pytest.approx(decoded["volt_motor"], abs=1e-5)
    check_values(reply, decoded)


def check_values(reply: Reply, decoded: dict[str, Any]) -> None:
    values = list(reply.values)
    if "obs" in decoded:
        assert values == decoded["obs"][: len(values)]
    if "pred_state" in decoded:
        # Entry 0 of the prediction is not sent as one: the C client leaves it 0.
        assert [0, *values[1:33]] == decoded["pred_state"][:33]
        assert list(reply.laser or ()) == decoded["pred_laser"]
    if "collide" in decoded:
        # Wire: hit, x and y in 1/100, normal in millionths.
        assert [values[1] / 100, values[2] / 100, values[3] / 1e6] == decoded["collide"]
    if "special" in decoded:
        assert values == decoded["special"][: len(values)]
        # The C buffer is longer than the packet, and zero behind it.
        assert not any(decoded["special"][len(values) :])
    if "arm" in decoded:
        # Four bytes of packet header, then an int32 result, and for wait the time that remains; low bytes first.
        assert int.from_bytes(bytes(values[4:8]), "little", signed=True) == decoded["arm"]
    if decoded.get("remain"):
        assert int.from_bytes(bytes(values[8:12]), "little") == decoded["remain"]


@pytest.mark.parametrize("session", TCP_SESSIONS)
def test_tcp_session_in_both_directions(session: str) -> None:
    # One framer and one state for the whole session: mask and laser mode carry over from call to call.
    wire_state, held = tcp_wire_state(N200), ClientState()
    requests, answers = TcpFramer(request_bounds), TcpFramer(reply_bounds, wide=False)
    count = 0
    for exchange in exchanges(TCP[session], model=None):
        # 1. The call is encoded to the recorded bytes.
        built = codec.encode_tcp_request(exchange.call)
        assert with_leftovers_of(exchange.call, built, exchange.request) == exchange.request, exchange.call
        # 2. A server reads the same call from these bytes.
        (frame,) = requests.receive(exchange.request)
        assert isinstance(frame, TcpFrame)
        assert codec.decode_tcp_request(frame) == exchange.call
        # 3. The reply is decoded under the mask and laser mode after this request, and encoded to the recorded bytes
        # again.
        codec.update_from_request(exchange.call, wire_state)
        if exchange.reply:
            check_tcp_reply(exchange, answers, wire_state, held)
        count += 1
    # A 32-bit client was recognized by its CONNECT.
    assert requests.wide is False
    # A session without exchanges would pass.
    assert count > 20


def check_tcp_reply(exchange: Exchange, answers: TcpFramer, wire_state: WireState, held: ClientState) -> None:
    row = BY_NAME[exchange.call.name]
    (frame,) = answers.receive(exchange.reply)
    assert isinstance(frame, TcpFrame)
    reply = codec.decode_tcp_reply(row, frame, wire_state)
    held.apply_reply(reply)
    if exchange.decoded:
        check_held(held, reply, exchange.decoded)
    assert codec.encode_tcp_reply(row, reply, wire_state) == exchange.reply


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_serial_session_in_both_directions(session: str) -> None:
    model = model_of(session)
    wire_state, held = serial_wire_state(model), ClientState()
    host, robot = SerialFramer(), SerialFramer()
    count = 0
    for exchange in exchanges(SERIAL[session], model):
        # 1. The call is encoded to the recorded bytes, and a robot reads it from them.
        assert codec.encode_serial_request(exchange.call, wire_state) == exchange.request, exchange.call
        (frame,) = host.receive(exchange.request)
        assert codec.decode_serial_request(frame, wire_state) == as_the_line_has_it(exchange.call)
        codec.update_from_request(exchange.call, wire_state)
        # 2. The reply is decoded under the mask and laser mode after this request.
        (answer,) = robot.receive(exchange.reply)
        reply = codec.decode_serial_reply(answer, wire_state)
        # The recording program printed "Nak" where the robot refused.
        assert (reply.kind == "nak") == ("Nak" in exchange.prints)
        held.apply_reply(reply)
        if exchange.decoded:
            check_held(held, reply, exchange.decoded)
        # 3. The decoded reply is encoded to the recorded bytes again.
        assert codec.encode_serial_reply(BY_NAME[exchange.call.name], reply, wire_state) == exchange.reply
        count += 1
    assert count > 4


def test_64_bit_session_in_both_directions() -> None:
    wire_state, held = tcp_wire_state(N200), ClientState(wide=True)
    wire_state.wide = True
    requests, answers = TcpFramer(request_bounds), TcpFramer(reply_bounds, wide=True)
    wire = [(bytes.fromhex(e["request"]), bytes.fromhex(e.get("reply", ""))) for e in LP64["exchanges"]]
    calls = [
        Call("connect_robot", (1, 0x5C2A)),
        Call("ct", EVERYTHING.smask),
        Call("vm", (100, -50, 0)),
        Call("gs"),
        Call("disconnect_robot", (1, 0x5C2A)),
    ]
    decoded = [None, LP64["decoded"][0], *LP64["decoded"][1:]]
    for call, (request, answer), after in zip(calls, wire, decoded, strict=True):
        assert codec.encode_tcp_request(call, wide=True) == request
        (frame,) = requests.receive(request)
        assert isinstance(frame, TcpFrame)
        assert codec.decode_tcp_request(frame) == call
        if answer:
            (frame,) = answers.receive(answer)
            assert isinstance(frame, TcpFrame)
            reply = codec.decode_tcp_reply(BY_NAME[call.name], frame, wire_state)
            held.apply_reply(reply)
            assert codec.encode_tcp_reply(BY_NAME[call.name], reply, wire_state) == answer
        if after:
            assert [value or 0 for value in held.slots] == after["State"]
            assert held.clock == after["time"]
    assert requests.wide is True
