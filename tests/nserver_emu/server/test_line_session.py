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

GS, ST, CONF_CP, GET_CP, CT, PA = 7, 9, 16, 24, 6, 4
NAK = bytes.fromhex("010200080b5c")
GS_REQUEST = bytes.fromhex("010200070a5c")
POSE, VELOCITIES, COMPASS, MOTORS, CLOCK = 19, 27, 33, 35, 36
"""Offsets in the state packet of an N150 or a Scout: 16 sonars, 3 bumper bytes, 7 numbers, compass."""
PACKET_SIZE = 42


def pose_only(*more: int) -> Mask:
    """A mask that lets the pose through and what is named."""
    return Mask(tuple(int(slot in (*range(34, 38), *more)) if slot else 0 for slot in range(44)))


# What the packets hold


@pytest.mark.parametrize(("model", "bumpers"), [("n150", "f00000"), ("scout", "000000")])
def test_the_fixed_packet_of_a_model_without_mask(model: str, bumpers: str) -> None:
    start = StartPose(0.0, 0.0, 0.0, math.radians(33.0 if model == "n150" else 0.0))
    emulator = emulated(model, start)
    host, _ = meet_on_line(emulator)
    host.ask("dp", -50, 1234)
    emulator.simulation.step(0.5)
    data = host.frame("gs").data
    assert len(data) == PACKET_SIZE
    assert tuple(data[:16]) == emulator.simulation.robots[1].sonar.readings_in
    assert data[16:19].hex() == bumpers
    assert data[POSE : POSE + 4].hex() == "3280d204"
    assert data[COMPASS : COMPASS + 2].hex() == ("4a01" if model == "n150" else "0000")
    assert int.from_bytes(data[CLOCK : CLOCK + 4], "little") == 500
    assert volts(data[-2], CPU_RANGE_V) == pytest.approx(12.0, abs=0.6)
    assert volts(data[-1], MOTOR_RANGE_V) == pytest.approx(12.0, abs=0.9)


def test_velocities_are_sign_magnitude_and_motors_are_flagged() -> None:
    host, _ = meet_on_line(emulated())
    data = host.frame("vm", 100, -50, 0).data
    assert data[VELOCITIES : VELOCITIES + 6].hex() == "640032800000"
    assert data[MOTORS] == 0b011
    data = host.frame("st").data
    assert data[VELOCITIES : VELOCITIES + 6] == bytes(6)
    assert data[MOTORS] == 0


def test_the_clock_of_a_measured_robot_has_coarse_steps() -> None:
    emulator = emulated(setup=MEASURED)
    host, _ = meet_on_line(emulator)
    emulator.simulation.step(0.1)
    assert host.ask("gs").clock == 98


@pytest.mark.parametrize(("model", "order"), [("n150", (2, 1, 0)), ("n200", (2, 1, 0)), ("scout", (0, 1, 2))])
def test_the_bumper_bits_of_a_robot_that_touches(model: str, order: tuple[int, int, int]) -> None:
    """Byte by byte: b0 = 16..19 with its high half set, b1 = 8..15, b2 = 0..7; the Scout in the reverse order."""
    emulator = emulated(model)
    host, _ = meet_on_line(emulator)
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
    state = host.ask("gs")
    assert (state.slots[34], state.slots[35]) == (-32767, 32767)
    stamp = host.ask("get_bp").stamps["bumper"]
    assert (stamp.x, stamp.y) == (-2147483647, 4000000)


# The mask of the N200


def test_the_mask_selects_slots_but_not_time_voltage_motors() -> None:
    host, _ = meet_on_line(emulated("n200"))
    assert set(host.ask("ct", *pose_only().smask).slots) == {34, 35, 36, 37, 41}
    assert len(host.frame("gs").data) == 8 + 1 + 4 + 2
    assert set(host.ask("ct", *pose_only(1, 3, 17, 43).smask).slots) == {1, 3, 17, 34, 35, 36, 37, 41, 43}
    assert len(host.frame("gs").data) == 1 + 1 + 8 + 2 + 1 + 4 + 2


def test_infrareds_are_nibbles_low_half_first() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    readings = emulator.simulation.robots[1].infrared
    assert readings is not None
    seen = list(readings.readings)
    assert seen[7:9] == [4, 3]
    data = host.frame("get_ir").data
    assert [half for byte in data[:8] for half in (byte & 15, byte >> 4)] == seen
    host.ask("ct", *pose_only(8, 9, 10).smask)
    assert host.frame("gs").data[:2] == bytes((seen[7] | seen[8] << 4, seen[9]))


def test_stamps_follow_the_mask_and_are_complete_in_get_replies() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    emulator.simulation.step(1.0)
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
    columns = (host.ask("gs").laser or (0,))[0]
    assert columns == 482
    state = host.ask("conf_ls", 33, 20, 20, 20, 4)
    assert state.laser is not None
    assert len(state.laser) == 1 + 4 * state.laser[0]
    segments = host.ask("get_sg").laser
    assert segments == state.laser
    pixels = host.ask("get_ls").laser
    assert pixels is not None
    assert pixels[0] == len(pixels) - 1 == 482
    assert host.ask("conf_ls", 32, 20, 20, 20, 4).laser == (0,)


def test_conf_ls_goes_by_another_number_for_points() -> None:
    host, session = meet_on_line(emulated("n200"))
    host.ask("conf_ls", 33, 20, 20, 20, 4)
    session.receive(build_frame(17, bytes((35, 20, 20, 20, 0, 4))))
    session.process_requests(1)
    assert session.context.wire_state.laser_mode == 51


def test_conf_cp_is_answered_by_scores_that_a_turn_makes_better() -> None:
    emulator = emulated("n200", setup=MEASURED)
    host, _ = meet_on_line(emulator)
    frame = host.frame("conf_cp", 2)
    assert (frame.type, frame.data) == (CONF_CP, bytes(3))
    host.ask("pr", 0, 0, 3700)
    for _ in range(100):
        emulator.simulation.step(0.1)
    assert host.frame("conf_cp", 1).data == bytes((9, 9, 1))


def test_the_small_answers() -> None:
    emulator = emulated("n200")
    host, _ = meet_on_line(emulator)
    assert host.frame("get_ra").data == b""
    assert host.ask("tk", "hello").slots.keys() >= {34, 35}
    assert [utterance.text for utterance in emulator.transcript] == ["hello"]
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
    assert bytes(host.ask("arm_mv", 2, 500, 0, 0).values) == bytes.fromhex("0800002a01000000")
    waits = codec.encode_serial_request(Call("arm_ws", (1, 1, 9000)), host.wire_state)
    assert host.raw(waits) == []
    assert session.waiting
    emulator.simulation.step(3.0)
    answer = codec.decode_serial_reply(parse_single_frame(session.tick()), host.wire_state)
    assert answer.values[:8] == (12, 0, 0, 41, 1, 0, 0, 0)
    assert not session.waiting


@pytest.mark.long
def test_ws_and_zr_are_answered_when_they_are_over() -> None:
    emulator = emulated()
    host, session = meet_on_line(emulator)
    host.ask("pr", 100, 0, 0)
    assert host.raw(codec.encode_serial_request(Call("ws", (1, 1, 1, 20)), host.wire_state)) == []
    emulator.simulation.step(30.0)
    frame = parse_single_frame(session.tick())
    assert frame.type == 31
    assert frame.data[POSE : POSE + 2] == bytes((100, 0))
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
        session.receive(build_frame(row.line_type, data))
        (frame,) = SerialFramer().receive(session.process_requests(1))
        assert frame.type == (row.line_type if model in row.line_models else 8), row.name
    assert session.refused > 0


def test_the_n150_line_has_the_compass_in_the_state_only() -> None:
    host, _ = meet_on_line(emulated())
    assert host.raw(build_frame(GET_CP)) == [SerialFrame(8, b"")]
    assert 43 in host.ask("gs").slots


@pytest.mark.parametrize(
    "request_bytes",
    [
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
    for cut in [*cuts, len(rubbish)]:
        session.receive(rubbish[:cut])
        rubbish = rubbish[cut:]
        session.process_requests(99)
    emulator.simulation.step(FRAME_TIMEOUT_S + 0.1)
    session.tick()
    session.process_requests(99)
    session.receive(GS_REQUEST)
    frames = SerialFramer().receive(session.process_requests(99))
    assert [frame.type for frame in frames] == [GS]
    assert session.unfinished == 0


def test_a_frame_with_a_wrong_checksum_is_met_with_silence() -> None:
    _, session = meet_on_line(emulated())
    session.receive(GS_REQUEST[:4] + b"\x0b" + GS_REQUEST[5:])
    assert session.process_requests(9) == b""
    assert session.skipped_bytes == 6
    assert session.refused == 0


def test_an_incomplete_frame_expires() -> None:
    now_s = [100.0]
    session = SerialSession(emulated().answer, 1, N150, lambda: now_s[0])
    session.receive(b"\x01\xf0\x00\x05")
    for _ in range(3):
        now_s[0] += FRAME_TIMEOUT_S / 4
        session.receive(GS_REQUEST)
        assert session.process_requests(9) == session.tick() == b""
    assert session.unfinished == 4 + 3 * 6
    now_s[0] += FRAME_TIMEOUT_S / 4 + 0.001
    assert session.tick() == b""
    assert session.unfinished == 0
    assert [frame.type for frame in SerialFramer().receive(session.process_requests(9))] == [GS] * 3
    session.receive(GS_REQUEST[:3])
    now_s[0] += 2 * FRAME_TIMEOUT_S
    session.receive(GS_REQUEST)
    assert [frame.type for frame in SerialFramer().receive(session.process_requests(9))] == [GS]


def test_a_slow_frame_is_not_dropped_before_its_timeout() -> None:
    now_s = [0.0]
    session = SerialSession(emulated().answer, 1, N150, lambda: now_s[0])
    session.receive(GS_REQUEST + GS_REQUEST[:2])
    assert parse_single_frame(session.process_requests(9)).type == GS
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
    assert host.raw(codec.encode_serial_request(Call("ws", (1, 1, 1, 200)), host.wire_state)) == []
    assert host.frame("st").type == ST
    assert not session.waiting
    emulator.simulation.step(1.0)
    assert session.tick() == b""


def test_in_lockstep_time_moves_with_each_exchange_on_a_line_too() -> None:
    host, _ = meet_on_line(emulated(pace=SimulationClock(lockstep_s=0.1)))
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
    assert session.greeting.hex() == "ffffffffff0101" + "33" + "000000"
    assert read_handshake(session.greeting) == (EVERYTHING, 51)
    assert meet_on_line(emulated())[1].greeting == b""
    assert session.identity is None


def test_mask_and_laser_mode_are_the_robots_and_outlive_a_host() -> None:
    emulator = emulated("n200")
    host, session = meet_on_line(emulator)
    few = pose_only()
    host.ask("ct", *few.smask)
    host.ask("conf_ls", 1, 20, 20, 20, 4)
    emulator.on_disconnect(session.context)
    again, session = meet_on_line(emulator)
    hello = read_handshake(session.greeting)
    assert hello == (Mask((*few.smask[:41], 1, *few.smask[42:])), 1)
    apply_handshake(hello, again.wire_state)
    slots = again.ask("gs").slots
    assert {34, 35, 36, 37} <= set(slots)
    assert not set(range(1, 34)) & set(slots)
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
    count = 0
    for exchange in exchanges(SERIAL[session_name], model):
        codec.update_from_request(exchange.call, wire_state)
        reply = codec.decode_serial_reply(parse_single_frame(exchange.reply), wire_state)
        replies.append(reply)
        session.receive(exchange.request)
        expected = exchange.reply
        if 33 in reply.slots:
            rested = reply._replace(slots={**reply.slots, 33: reply.slots[33] | model.bumper_rest})
            expected = codec.encode_serial_reply(BY_NAME[exchange.call.name], rested, wire_state)
        assert session.process_requests(1) == expected, exchange.call
        count += expected == exchange.reply
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
        while not frames:
            emulator.simulation.step(0.1)
            frames = SerialFramer().receive(session.tick())
        (frame,) = frames
        lacking = exchange.call.name == "special_request" or (exchange.call.name == "arm_zr" and model is not N200)
        if lacking or recorded.type == 8:
            assert lacking == (frame.type == 8)
            continue
        ours, theirs = (codec.decode_serial_reply(each, host.wire_state) for each in (frame, recorded))
        assert (frame.type, ours.slots.keys(), ours.stamps.keys()) == (
            recorded.type, theirs.slots.keys(), theirs.stamps.keys())  # fmt: skip
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

    def answer(_call: Call, scenario: ConnectionContext) -> Reply:
        seen.append(scenario)
        return Reply("state")

    session = SerialSession(answer, 7, N150, lambda: 0.0)
    session.receive(GS_REQUEST)
    session.process_requests(1)
    assert [scenario.robot_id for scenario in seen] == [7]
    assert seen[0].wire_state.line
