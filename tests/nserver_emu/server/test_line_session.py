"""The robot's own line: the bytes of its answers, its refusals, its silences, and the recorded robot's shapes."""

from __future__ import annotations

import logging
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.protocol import codec
from nclient.protocol.client_state import apply_handshake, read_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFrame, SerialFramer, build_frame, parse_single_frame
from nclient.protocol.types import (
    CPU_RANGE_V,
    EVERYTHING,
    MODELS,
    MOTOR_RANGE_V,
    N150,
    N200,
    Mask,
    Position,
    serial_wire_state,
    volts,
)
from nserver_emu.server.serial_session import FRAME_TIMEOUT_S, SerialSession
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.server.session import ConnectionContext
from nserver_emu.simulation.models import MODELS as SIMULATED
from nserver_emu.simulation.noise import MEASURED
from tests.nclient.protocol.recorded import LINE_SESSIONS, SERIAL, exchanges, model_of
from tests.nserver_emu.server.line_host import LineHost, emulated, meet_on_line
from worlds.world import StartPose

# Types of frames on the serial line (docs/protocol.md).
GS, ST, CONF_CP, GET_CP, CT, PA = 7, 9, 16, 24, 6, 4
# A frame: 01, length 2 (type and checksum), type, checksum modulo 256, 5c. 01+02+00+08 = 0b; 01+02+00+07 = 0a.
NAK = bytes.fromhex("010200080b5c")
GS_REQUEST = bytes.fromhex("010200070a5c")
POSE, VELOCITIES, COMPASS, MOTORS, CLOCK = 19, 27, 33, 35, 36
"""Offsets in the state packet of an N150 or a Scout: 16 sonars, 3 bumper bytes, 7 numbers, compass."""
# 16 sonar bytes, 3 bumper bytes, 7 numbers of 2 bytes, 2 of compass, motor bits, 4 of clock, 2 of voltages.
PACKET_SIZE = 42


def pose_only(*more: int) -> Mask:
    """A mask that lets the pose through and what is named."""
    return Mask(tuple(int(slot in (*range(34, 38), *more)) if slot else 0 for slot in range(44)))


# What the packets hold


@pytest.mark.parametrize(("model", "bumpers"), [("n150", "f00000"), ("scout", "000000")])
def test_the_fixed_packet_of_a_model_without_mask(model: str, bumpers: str) -> None:
    # The turret is turned by 33 deg, which the compass shows; a Scout has no compass.
    start = StartPose(0.0, 0.0, 0.0, math.radians(33.0 if model == "n150" else 0.0))
    emulator = emulated(model, start)
    host, _ = meet_on_line(emulator)
    host.ask("dp", -50, 1234)
    emulator.simulation.step(0.5)
    data = host.frame("gs").data
    assert len(data) == PACKET_SIZE
    assert tuple(data[:16]) == emulator.simulation.robots[1].sonar.readings_in
    assert data[16:19].hex() == bumpers
    # Sign-magnitude, low byte first: -50 = 8032, 1234 = 04d2.
    assert data[POSE : POSE + 4].hex() == "3280d204"
    # 330 tenths of a degree = 014a.
    assert data[COMPASS : COMPASS + 2].hex() == ("4a01" if model == "n150" else "0000")
    assert int.from_bytes(data[CLOCK : CLOCK + 4], "little") == 500
    assert volts(data[-2], CPU_RANGE_V) == pytest.approx(12.0, abs=0.6)
    assert volts(data[-1], MOTOR_RANGE_V) == pytest.approx(12.0, abs=0.9)


def test_velocities_are_sign_magnitude_and_motors_are_flagged() -> None:
    host, _ = meet_on_line(emulated())
    data = host.frame("vm", 100, -50, 0).data
    # 100 = 0064 and, with the sign bit set, -50 = 8032.
    assert data[VELOCITIES : VELOCITIES + 6].hex() == "640032800000"
    assert data[MOTORS] == 0b011
    data = host.frame("st").data
    assert data[VELOCITIES : VELOCITIES + 6] == bytes(6)
    assert data[MOTORS] == 0


def test_the_clock_of_a_measured_robot_has_coarse_steps() -> None:
    emulator = emulated(setup=MEASURED)
    host, _ = meet_on_line(emulator)
    # The robot's clock advances by 16.4 ms: after 100 ms it shows 6 x 16.4 = 98.4, truncated.
    emulator.simulation.step(0.1)
    assert host.ask("gs").clock == 98


@pytest.mark.parametrize(("model", "order"), [("n150", (2, 1, 0)), ("n200", (2, 1, 0)), ("scout", (0, 1, 2))])
def test_the_bumper_bits_of_a_robot_that_touches(model: str, order: tuple[int, int, int]) -> None:
    """Byte by byte: b0 = 16..19 with its high half set, b1 = 8..15, b2 = 0..7; the Scout in the reverse order."""
    emulator = emulated(model)
    host, _ = meet_on_line(emulator)
    # Backwards against the wall, 12 in behind the robot; a Scout's second axis is its other wheel.
    host.ask("vm", -200, 0 if model != "scout" else -200, 0)
    emulator.simulation.step(2.0)
    bits = emulator.simulation.robots[1].bumpers
    assert bits
    whole = bits | (0 if model == "scout" else 0xF00000)
    data = host.frame("get_bp").data
    assert list(data[:3]) == [whole >> 8 * place & 255 for place in order]
    assert host.ask("gs").slots[33] == whole


def test_positions_beyond_the_line_range_are_clamped() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    emulator.simulation.robots[1].define_position(-1e9, 4e5)
    host.ask("ct", *pose_only().with_position(Position.BUMPER).smask)
    # 1. State: numbers of two bytes, at most 7fff = 32767 tenths.
    state = host.ask("gs")
    assert (state.slots[34], state.slots[35]) == (-32767, 32767)
    # 2. Stamp: numbers of four bytes. -1e10 tenths is clamped to -7fffffff, 4e5 in = 4,000,000 tenths fits.
    stamp = host.ask("get_bp").stamps["bumper"]
    assert (stamp.x, stamp.y) == (-2147483647, 4000000)


# The mask of the N200


def test_the_mask_selects_slots_but_not_time_voltage_motors() -> None:
    host, _ = meet_on_line(emulated("n200"))
    # 1. x, y, steering and turret: 8 bytes. Motor bits (1), clock (4) and voltages (2) have no mask.
    assert set(host.ask("ct", *pose_only().smask).slots) == {34, 35, 36, 37, 41}
    assert len(host.frame("gs").data) == 8 + 1 + 4 + 2
    # 2. Infrareds 1 and 3 share a byte; sonar 17 has one, the pose 8, the compass 2; then 1 + 4 + 2 as before.
    assert set(host.ask("ct", *pose_only(1, 3, 17, 43).smask).slots) == {1, 3, 17, 34, 35, 36, 37, 41, 43}
    assert len(host.frame("gs").data) == 1 + 1 + 8 + 2 + 1 + 4 + 2


def test_infrareds_are_nibbles_low_half_first() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    readings = emulator.simulation.robots[1].infrared
    assert readings is not None
    # Neighbours that differ, so that a wrong order of the halves is detected.
    seen = list(readings.readings)
    assert seen[7:9] == [4, 3]
    data = host.frame("get_ir").data
    assert [half for byte in data[:8] for half in (byte & 15, byte >> 4)] == seen
    # Only selected infrareds are packed: 8 and 9 in the first byte, 10 in the second.
    host.ask("ct", *pose_only(8, 9, 10).smask)
    assert host.frame("gs").data[:2] == bytes((seen[7] | seen[8] << 4, seen[9]))


def test_stamps_follow_the_mask_and_are_complete_in_get_replies() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    emulator.simulation.step(1.0)
    # The mask selects sonar 0 (slot 17) and bumpers (33); a stamp is sent for each selected sensor.
    state = host.ask("ct", *pose_only(17, 33).with_position(Position.SONAR | Position.BUMPER).smask)
    assert set(state.stamps) == {"sonar_0", "bumper"}
    answer = host.ask("get_sn")
    assert set(answer.stamps) == {f"sonar_{number}" for number in range(16)}
    assert answer.stamps["sonar_0"] == state.stamps["sonar_0"]
    assert 0 < state.stamps["sonar_0"].sensor_time <= 1000
    assert host.ask("get_cp").stamps == {}


# What each command answers


def test_the_laser_mode_selects_pixels_or_lines() -> None:
    host, _ = meet_on_line(emulated("n200"))
    # 1. Pixel mode by default: one word per column.
    columns = (host.ask("gs").laser or (0,))[0]
    assert columns == 482
    # 2. Line mode 33: a count and four words (x1 y1 x2 y2) per line.
    state = host.ask("conf_ls", 33, 20, 20, 20, 4)
    assert state.laser is not None
    assert len(state.laser) == 1 + 4 * state.laser[0]
    segments = host.ask("get_sg").laser
    assert segments == state.laser
    # 3. In a line mode get_ls has the columns.
    pixels = host.ask("get_ls").laser
    assert pixels is not None
    assert pixels[0] == len(pixels) - 1 == 482
    # 4. Bit 0 of the mode switches the laser; 32 has it cleared.
    assert host.ask("conf_ls", 32, 20, 20, 20, 4).laser == (0,)


def test_conf_ls_goes_by_another_number_for_points() -> None:
    host, session = meet_on_line(emulated("n200"))
    host.ask("conf_ls", 33, 20, 20, 20, 4)
    # Type 17 is conf_ls. Byte 35 stands for mode 51 on the serial line.
    session.receive(build_frame(17, bytes((35, 20, 20, 20, 0, 4))))
    session.process_requests(1)
    assert session.context.wire_state.laser_mode == 51


def test_conf_cp_is_answered_by_scores_that_a_turn_makes_better() -> None:
    emulator = emulated("n200", setup=MEASURED)
    host, _ = meet_on_line(emulator)
    frame = host.frame("conf_cp", 2)
    assert (frame.type, frame.data) == (CONF_CP, bytes(3))
    # 370 deg, more than the full turn of the turret that a calibration needs; at 45 deg/s it takes 8.2 s of these 10.
    host.ask("pr", 0, 0, 3700)
    for _ in range(100):
        emulator.simulation.step(0.1)
    # Quality 9, surroundings 9, one calibration.
    assert host.frame("conf_cp", 1).data == bytes((9, 9, 1))


def test_the_small_answers() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    assert host.frame("get_ra").data == b""
    assert host.ask("tk", "hello").slots.keys() >= {34, 35}
    assert [utterance.text for utterance in emulator.transcript] == ["hello"]
    # Headings are sent as 0..3599: -900 becomes 2700.
    host.ask("da", -900, 450)
    assert host.ask("get_rc").slots == {34: 0, 35: 0, 36: 2700, 37: 450}
    host.ask("vm", 0, -100, 20)
    assert host.ask("get_rv").slots == {38: 0, 39: -100, 40: 20}
    assert host.ask("get_cp").slots == {43: 0}
    other, _ = meet_on_line(emulated())
    assert other.ask("conf_ser", 1, 9600).kind == "state"


def test_the_arm_of_an_n200_answers_in_packets_when_it_is_done() -> None:
    emulator = emulated("n200")
    host, session = meet_on_line(emulator)
    # Length 8 (the header included), serial 0, type 42 (2a), then the result 1 as four bytes, low first.
    assert bytes(host.ask("arm_mv", 2, 500, 0, 0).values) == bytes.fromhex("0800002a01000000")
    waits = codec.encode_serial_request(Call("arm_ws", (1, 1, 9000)), host.wire_state)
    assert host.raw(waits) == []
    assert session.waiting
    # The lift moves 5 in at 5 in/s with ramps of 0.5 s: 1.5 s, less than these 3 s.
    emulator.simulation.step(3.0)
    answer = codec.decode_serial_reply(parse_single_frame(session.tick()), host.wire_state)
    # Length 12, serial 0, type 41, result 1; the time left follows.
    assert answer.values[:8] == (12, 0, 0, 41, 1, 0, 0, 0)
    assert not session.waiting


@pytest.mark.long
def test_ws_and_zr_are_answered_when_they_are_over() -> None:
    emulator = emulated()
    host, session = meet_on_line(emulator)
    host.ask("pr", 100, 0, 0)
    # No frame yet: the reply is deferred until the robot has moved its 10 in.
    assert host.raw(codec.encode_serial_request(Call("ws", (1, 1, 1, 20)), host.wire_state)) == []
    emulator.simulation.step(30.0)
    frame = parse_single_frame(session.tick())
    assert frame.type == 31
    assert frame.data[POSE : POSE + 2] == bytes((100, 0))
    # A reply is sent once; the next poll has nothing.
    assert session.tick() == b""
    host.ask("pr", 0, 900, 0)
    emulator.simulation.step(0.5)
    assert host.raw(codec.encode_serial_request(Call("zr"), host.wire_state)) == []
    emulator.simulation.step(60.0)
    assert parse_single_frame(session.tick()).type == 13


# Refusals


@pytest.mark.parametrize("model", MODELS)
def test_commands_that_the_model_lacks_get_a_nak(model: str) -> None:
    _, session = meet_on_line(emulated(model))
    arguments = {"ct": EVERYTHING.smask, "tk": ("x",), "conf_sn": (15, *range(16)), "conf_ir": (0, *range(16))}
    for row in BY_NAME.values():
        if row.line_type is None or row.name in ("ws", "zr") or row.packet_type or row.any_length:
            continue
        data = row.line_request.build(arguments.get(row.name, (0,) * len(row.arguments)))
        # 1. Any valid data for each command.
        session.receive(build_frame(row.line_type, data))
        (frame,) = SerialFramer().receive(session.process_requests(1))
        # 2. The reply has the type of the command if the model has it, else 8 (NAK).
        assert frame.type == (row.line_type if model in row.line_models else 8), row.name
    assert session.refused > 0


def test_the_n150_line_has_the_compass_in_the_state_only() -> None:
    host, _ = meet_on_line(emulated())
    assert host.raw(build_frame(GET_CP)) == [SerialFrame(8, b"")]
    assert 43 in host.ask("gs").slots


@pytest.mark.parametrize(
    "request_bytes",
    [
        # Unknown type; vm with two numbers; gs with data; a user packet that no robot has, and one of a wrong length;
        # mv in mode 7.
        build_frame(200, b"abc"),
        build_frame(5, b"\x64\x00\x32\x80"),
        build_frame(GS, b"\0"),
        build_frame(128, b"\x04\x00\x00\xc8"),
        build_frame(128, b"\x09\x00\x00\xc8"),
        build_frame(43, bytes((7, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))),
    ],
)
def test_invalid_requests_get_a_single_nak(request_bytes: bytes) -> None:
    _, session = meet_on_line(emulated())
    session.receive(request_bytes + GS_REQUEST)
    answers = session.process_requests(9)
    assert answers.startswith(NAK)
    assert parse_single_frame(answers[len(NAK) :]).type == GS
    assert session.refused == 1


def test_each_kind_of_refusal_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    _, session = meet_on_line(emulated())
    with caplog.at_level(logging.WARNING):
        session.receive(build_frame(200) * 3 + build_frame(43, bytes((7, *[0] * 11))))
        assert session.process_requests(9) == NAK * 4
    assert ["type 200 does not exist on the line of a n150" in text for text in caplog.messages] == [True, False]


# A line that is never clean


@given(st.binary(max_size=300), st.lists(st.integers(1, 60), max_size=6))
@settings(max_examples=80)
def test_a_request_after_garbage_and_a_pause_is_answered(rubbish: bytes, cuts: list[int]) -> None:
    emulator = emulated()
    _, session = meet_on_line(emulator)
    # 1. Garbage in pieces: it may contain the begin of a frame that announces up to 255 bytes.
    for cut in [*cuts, len(rubbish)]:
        session.receive(rubbish[:cut])
        rubbish = rubbish[cut:]
        session.process_requests(99)
    # 2. After the timeout such a frame is given up, and the bytes in it are searched for frames.
    emulator.simulation.step(FRAME_TIMEOUT_S + 0.1)
    session.tick()
    session.process_requests(99)
    # 3. The line is clean again: one request, one reply.
    session.receive(GS_REQUEST)
    frames = SerialFramer().receive(session.process_requests(99))
    assert [frame.type for frame in frames] == [GS]
    assert session.unfinished == 0


def test_a_frame_with_a_wrong_checksum_is_met_with_silence() -> None:
    _, session = meet_on_line(emulated())
    # Byte 4 is the checksum: 0b instead of 0a. The six bytes are skipped, and the host repeats its request.
    session.receive(GS_REQUEST[:4] + b"\x0b" + GS_REQUEST[5:])
    assert session.process_requests(9) == b""
    assert session.skipped_bytes == 6
    assert session.refused == 0


def test_an_incomplete_frame_expires() -> None:
    now_s = [100.0]
    session = SerialSession(emulated().answer, 1, N150, lambda: now_s[0])
    # A corrupt length: f0 = 240 bytes. Requests that follow look like its data until it expires.
    session.receive(b"\x01\xf0\x00\x05")
    for _ in range(3):
        # Three requests within 3/4 of the timeout get no reply.
        now_s[0] += FRAME_TIMEOUT_S / 4
        session.receive(GS_REQUEST)
        assert session.process_requests(9) == session.tick() == b""
    assert session.unfinished == 4 + 3 * 6
    # Once it is over, the three requests inside are found and answered.
    now_s[0] += FRAME_TIMEOUT_S / 4 + 0.001
    assert session.tick() == b""
    assert session.unfinished == 0
    assert [frame.type for frame in SerialFramer().receive(session.process_requests(9))] == [GS] * 3
    # The same with half a request, whose rest never comes; it expires when the next bytes arrive.
    session.receive(GS_REQUEST[:3])
    now_s[0] += 2 * FRAME_TIMEOUT_S
    session.receive(GS_REQUEST)
    assert [frame.type for frame in SerialFramer().receive(session.process_requests(9))] == [GS]


def test_a_slow_frame_is_not_dropped_before_its_timeout() -> None:
    now_s = [0.0]
    session = SerialSession(emulated().answer, 1, N150, lambda: now_s[0])
    # A whole request and two bytes of the next: the timeout of the second one starts here.
    session.receive(GS_REQUEST + GS_REQUEST[:2])
    assert parse_single_frame(session.process_requests(9)).type == GS
    # Four bytes, each after a fifth of the timeout: together less than all of it.
    for place in range(2, 6):
        now_s[0] += FRAME_TIMEOUT_S / 5
        session.tick()
        session.receive(GS_REQUEST[place : place + 1])
    assert parse_single_frame(session.process_requests(9)).type == GS


# Who drives, and time


def test_a_new_request_cancels_the_deferred_reply() -> None:
    emulator = emulated()
    host, session = meet_on_line(emulator)
    host.ask("vm", 100, 0, 0)
    # ws would wait 200 s; st arrives meanwhile, as from a host that gave up.
    assert host.raw(codec.encode_serial_request(Call("ws", (1, 1, 1, 200)), host.wire_state)) == []
    assert host.frame("st").type == ST
    assert not session.waiting
    emulator.simulation.step(1.0)
    assert session.tick() == b""


def test_in_lockstep_time_moves_with_each_exchange_on_a_line_too() -> None:
    host, _ = meet_on_line(emulated(pace=SimulationClock(lockstep_s=0.1)))
    # One step of 0.1 s per request, before its reply.
    assert [host.ask("gs").clock for _ in range(3)] == [100, 200, 300]


def test_the_robot_stops_when_the_host_on_its_line_leaves() -> None:
    emulator = emulated()
    host, session = meet_on_line(emulator)
    host.ask("vm", 100, 0, 0)
    emulator.on_disconnect(session.context)
    assert not any(emulator.simulation.robots[1].moving)


def test_a_closing_line_sends_and_receives_nothing() -> None:
    _, session = meet_on_line(emulated())
    session.closing = True
    session.receive(GS_REQUEST)
    assert not session.ready
    assert session.process_requests(9) == b""


def test_over_tcp_an_n200_first_sends_mask_and_laser_mode() -> None:
    _, session = meet_on_line(emulated("n200"))
    # Five bytes of mask bits, laser, compass; laser mode 51 = 33 hexadecimal; three bytes that are not used.
    assert session.greeting.hex() == "ffffffffff0101" + "33" + "000000"
    assert read_handshake(session.greeting) == (EVERYTHING, 51)
    assert meet_on_line(emulated())[1].greeting == b""
    assert session.identity is None


def test_mask_and_laser_mode_are_the_robots_and_outlive_a_host() -> None:
    emulator = emulated("n200")
    host, session = meet_on_line(emulator)
    # 1. A first host selects few sensors and laser mode 1, and disconnects.
    few = pose_only()
    host.ask("ct", *few.smask)
    host.ask("conf_ls", 1, 20, 20, 20, 4)
    emulator.on_disconnect(session.context)
    # 2. The next host gets both in the handshake. The line does not carry Smask[41], which reads 1.
    again, session = meet_on_line(emulator)
    hello = read_handshake(session.greeting)
    assert hello == (Mask((*few.smask[:41], 1, *few.smask[42:])), 1)
    # 3. It must use them to parse replies: sensors (1..33) are not in them.
    apply_handshake(hello, again.wire_state)
    slots = again.ask("gs").slots
    assert {34, 35, 36, 37} <= set(slots)
    assert not set(range(1, 34)) & set(slots)
    # 4. Settings of the second host are in force for a third one.
    again.ask("ct", *EVERYTHING.smask)
    again.ask("conf_ls", 51, 20, 20, 20, 4)
    assert read_handshake(meet_on_line(emulator)[1].greeting) == (EVERYTHING, 51)


def test_another_robot_has_a_mask_of_its_own() -> None:
    emulator = emulated("n200")
    emulator.simulation.add_robot(2, StartPose(60.0, 60.0, 0.0, 0.0), SIMULATED["n200"])
    meet_on_line(emulator)[0].ask("ct", *[0] * 44)
    assert read_handshake(meet_on_line(emulator, 2)[1].greeting) == (EVERYTHING, 51)


# The recorded robot


@pytest.mark.parametrize("session_name", LINE_SESSIONS)
def test_recorded_replies_are_encoded_to_the_same_bytes(session_name: str) -> None:
    """A robot in the recorded state, so to speak; its bumpers' high half reads 1111 where the model has it."""
    model = model_of(session_name)
    replies: list[Reply] = []
    session = SerialSession(lambda _call, _context: replies.pop(), 1, model, lambda: 0.0)
    wire_state = serial_wire_state(model)
    # The recorded reply is decoded, passed to the session as if a robot had returned it, and encoded again.
    count = 0
    for exchange in exchanges(SERIAL[session_name], model):
        codec.update_from_request(exchange.call, wire_state)
        reply = codec.decode_serial_reply(parse_single_frame(exchange.reply), wire_state)
        replies.append(reply)
        session.receive(exchange.request)
        expected = exchange.reply
        # A recorded robot may have bumper bits whose rest value differs; the expected frame is then encoded anew.
        if 33 in reply.slots:
            rested = reply._replace(slots={**reply.slots, 33: reply.slots[33] | model.bumper_rest})
            expected = codec.encode_serial_reply(BY_NAME[exchange.call.name], rested, wire_state)
        assert session.process_requests(1) == expected, exchange.call
        count += expected == exchange.reply
    # At least 20 of the Scout's replies must be equal without this correction.
    assert count >= (20 if session_name == "scout" else 0)


@pytest.mark.parametrize("session_name", LINE_SESSIONS)
def test_replies_have_the_recorded_frame_shape(session_name: str) -> None:
    """Same type and, but for the laser's readings, same length; no program here answers user packets, though."""
    model = model_of(session_name)
    emulator = emulated(model.name, StartPose(50.0, 50.0, 0.0, 0.0))
    host, session = meet_on_line(emulator)
    for exchange in exchanges(SERIAL[session_name], model):
        recorded = parse_single_frame(exchange.reply)
        codec.update_from_request(exchange.call, host.wire_state)
        frames = host.raw(exchange.request)
        # ws, zr and arm replies come later: time passes until there is one.
        while not frames:
            emulator.simulation.step(0.1)
            frames = SerialFramer().receive(session.tick())
        (frame,) = frames
        # The emulator lacks user packets and, without an arm, arm_zr: it sends NAK.
        lacking = exchange.call.name == "special_request" or (exchange.call.name == "arm_zr" and model is not N200)
        if lacking or recorded.type == 8:
            assert lacking == (frame.type == 8)
            continue
        ours, theirs = (codec.decode_serial_reply(each, host.wire_state) for each in (frame, recorded))
        assert (frame.type, ours.slots.keys(), ours.stamps.keys()) == (
            recorded.type, theirs.slots.keys(), theirs.stamps.keys())  # fmt: skip
        # The number of laser readings depends on the room, all other lengths on the mask alone.
        without_laser = [len(each.data) - _laser_octets(reply) for each, reply in ((frame, ours), (recorded, theirs))]
        if exchange.call.name not in ("get_ra", "arm_zr"):
            assert without_laser[0] == without_laser[1], exchange.call


def _laser_octets(reply: Reply) -> int:
    return 2 * (len(reply.laser) - 1) if reply.laser else 0


def test_the_host_of_these_tests_reads_only_whole_answers() -> None:
    """The tests above depend on this: stray bytes in a reply are detected."""
    host = LineHost(lambda _: b"x" + NAK, N150)
    with pytest.raises(AssertionError):
        host.ask("gs")


def test_a_line_drives_its_own_robot_only() -> None:
    seen: list[ConnectionContext] = []

    def answer(_call: Call, context: ConnectionContext) -> Reply:
        seen.append(context)
        return Reply("state")

    session = SerialSession(answer, 7, N150, lambda: 0.0)
    session.receive(GS_REQUEST)
    session.process_requests(1)
    assert [context.robot_id for context in seen] == [7]
    assert seen[0].wire_state.line
