"""Recorded conversations line by line: every recorded session, and by hand what no session shows."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.decode import WireDecoder
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import build_frame
from nclient.protocol.types import EVERYTHING, N150, N200, SCOUT, Model, serial_wire_state, tcp_wire_state
from tests.nclient.protocol.recorded import LINE_SESSIONS, LP64, SERIAL, TCP, TCP_SESSIONS, exchanges, model_of

# gs: type 15 without words. vm: type 12 with the three words 100, -50 and 0.
GS, VM = "> 000f0000", "> 000c000300000064ffffffce00000000"
# Which kind of reply each recorded call has, after the tables of docs/protocol.md.
KINDS = {
    "get_ir": "infrared", "get_sn": "sonar", "get_rc": "configuration", "get_robot_conf": "configuration",
    "get_rv": "velocity", "get_ra": "velocity", "get_cp": "compass", "get_bp": "bumper", "get_ls": "laser",
    "get_sg": "laser", "predict_sensors": "prediction", "special_request": "special", "arm_zr": "special",
    "arm_ws": "special", "arm_mv": "special",
}
TCP_SIMPLE = {
    "tk", "get_rpx", "add_obstacle", "delete_obstacle", "move_obstacle", "new_world", "draw_robot", "draw_line",
    "draw_arc", "quit_server", "real_robot", "simulated_robot", "place_robot", "motion_check", "connect_robot",
}


def expected_kind(case: dict[str, Any], name: str, over_tcp: bool) -> str:
    if "Nak" in case.get("prints", ()):
        return "nak"
    # The C function returned 0: over TCP the recorded server had sent an error reply.
    if case["decoded"]["return"] == 0:
        return "error"
    simple = over_tcp and (name in TCP_SIMPLE or name.startswith("refresh_"))
    # On the serial line conf_cp answers with three calibration scores.
    on_line = {"conf_cp": "compass"} if not over_tcp else {}
    return (KINDS | on_line).get(name, "simple" if simple else "state")


def check_call(found: dict[str, Any], name: str, case: dict[str, Any]) -> None:
    assert (found["to"], found["call"]) == ("robot", name)
    if name == "ct":
        assert (found["args"], len(found["mask"])) == ([], 44)
    # One C call may make several requests, such as connect_robot and ct; arguments are compared where the names
    # agree.
    elif case["call"] == name:
        args = case["args"] if isinstance(case["args"], list) else [case["args"]]
        flags = [int(bool(arg)) for arg in args[:3]]
        assert found["args"] == (flags + args[3:] if name == "ws" else args)


def check_held(found: dict[str, Any], decoded: dict[str, Any]) -> None:
    # The C library starts with zeros, where the decoder shows null.
    assert [value or 0 for value in found["State"]] == decoded["State"]
    laser = found["Laser"] or [0]
    if "Laser" in decoded and laser[0]:
        shown = min(len(laser), len(decoded["Laser"]))
        assert laser[:shown] == decoded["Laser"][:shown]
    for name in ("sonar_0", "sonar_15", "ir_0", "bumper", "laser", "compass"):
        if any(decoded.get(f"pos_{name}", ())):
            assert found["positions"][name] == decoded[f"pos_{name}"]
    if decoded.get("time"):
        assert found["clock"] == decoded["time"]
    if found["volt_cpu"] is not None:
        assert [found["volt_cpu"], found["volt_motor"]] == [decoded["volt_cpu"], decoded["volt_motor"]]


def check_fields(found: dict[str, Any], decoded: dict[str, Any]) -> None:
    for name in ("obs", "special"):
        if name in decoded:
            assert found[name] == decoded[name][: len(found[name])]
            # The C buffers are longer than the reply, and zero behind it.
            assert not any(decoded[name][len(found[name]) :])
    for name in ("pred_state", "pred_laser", "collide", "arm"):
        if name in decoded:
            assert found[name] == decoded[name]
    if decoded.get("remain"):
        assert found["remain"] == decoded["remain"]


def follow(cases: list[dict[str, Any]], transcript: WireDecoder, model: Model | None) -> int:
    count = 0
    for case in (case for case in cases if case["exchanges"]):
        # Only the last reply of a case is compared with the C client's state, which was recorded after the whole
        # call.
        found: dict[str, Any] = {}
        for exchange in case["exchanges"]:
            asked = transcript.read(f"> {exchange['request']}")
            check_call(asked, asked["call"], case)
            count += 1
            if exchange.get("reply"):
                found = transcript.read(f"< {exchange['reply']}")
                assert found["reply"] == expected_kind(case, asked["call"], model is None)
        if found:
            check_held(found, case["decoded"])
            check_fields(found, case["decoded"])
    return count


@pytest.mark.parametrize("session", TCP_SESSIONS)
def test_a_recorded_tcp_session(session: str) -> None:
    assert follow(TCP[session], WireDecoder("tcp", N150), None) == sum(1 for _ in exchanges(TCP[session], None))


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_a_recorded_session_on_the_robots_own_line(session: str) -> None:
    model = model_of(session)
    assert follow(SERIAL[session], WireDecoder("serial", model), model) > 4


def test_the_recorded_64_bit_client() -> None:
    transcript, after = WireDecoder("tcp64", N150), []
    for exchange in LP64["exchanges"]:
        assert "error" not in transcript.read(f"> {exchange['request']}")
        if exchange.get("reply"):
            after.append(transcript.read(f"< {exchange['reply']}"))
    states = [found for found in after if found["reply"] == "state"]
    assert len(states) == 3
    for found, decoded in zip(states, LP64["decoded"], strict=False):
        assert found["State"] == decoded["State"]
        assert found["clock"] == decoded["time"]
    # The 64-bit client stored a negative coordinate, -200, without its sign.
    assert 2**32 - 200 in states[0]["State"]


@pytest.mark.parametrize("line", [
    "", "   ", "# a comment", "000f0000", "= 000f0000", ">", "> 000", "> 0x0f", "> 00 0f 00 zz", "< ", "hello",
])
@pytest.mark.parametrize("wire", ["tcp", "tcp64", "serial"])
def test_lines_that_are_no_frame(wire: str, line: str) -> None:
    transcript = WireDecoder(wire, N200)
    assert list(transcript.read(line)) == ["error"]
    # A line that is no frame changes no state.
    assert transcript.wire_state.mask == EVERYTHING


def test_blanks_and_capitals_in_hex() -> None:
    transcript = WireDecoder("tcp", N150)
    for line in ("> 000f0000", ">000F0000\n", "  > 00 0f 00 00 \r\n", ">\t000f 0000"):
        assert transcript.read(line) == {"to": "robot", "call": "gs", "args": []}


@pytest.mark.parametrize(("line", "wrong"), [
    # A header of 3 words with only 3 bytes behind it; bytes and a whole message behind the first; type 9999.
    ("> 000c0003000000", "truncated"), (GS + "00", "behind"), (GS + "000f0000", "behind"), ("> 270f0000", "unknown"),
    # Too few words for vm; a reply of type 9999; a state reply without words.
    ("> 000c0002" + "00" * 8, "takes 3 words"), ("< 270f0001" + "00" * 4, "unknown"), ("< 00500000", "takes 1 to"),
    # A count of 49 words with 48 behind it; 5 words, which is no state reply.
    ("< 00500031" + "00" * 192, "truncated"), ("< 00500005" + "00" * 20, "no state reply of this shape"),
    # add_obstacle with 11 vertices, where 10 are the maximum.
    ("> 00320003" + "0000000b" + "00" * 8, "obstacle"),
])
def test_what_is_wrong_with_a_line_over_tcp(line: str, wrong: str) -> None:
    transcript = WireDecoder("tcp", N150)
    assert wrong in transcript.read(line)["error"]
    # A bad line leaves the decoder usable for the next one.
    assert transcript.read(VM)["args"] == [100, -50, 0]


@pytest.mark.parametrize(("line", "wrong"), [
    # Checksum 25 instead of 24; a frame that is cut off; a byte behind it; tk (type 11), which only a N200 has.
    ("> 01080005640032800000255c", "checksum"), ("> 0108000564003280", "truncated"),
    ("> 01080005640032800000245c00", "behind"), ("> 0102000b0e5c", "does not exist on the line of a n150"),
    # A state packet without data; a reply that is cut off; `<` in the middle of the hex; a wrong first byte.
    ("< 01020007 0a5c", "no state reply"), ("< 01020009", "truncated"), ("< 00" * 2, "hex"), ("< ff00", "starts with"),
])
def test_what_is_wrong_with_a_line_of_a_robot(line: str, wrong: str) -> None:
    assert wrong in WireDecoder("serial", N150).read(line)["error"]


@settings(max_examples=80)
@given(st.lists(st.tuples(st.sampled_from("<>"), st.binary(max_size=40)), max_size=6),
       st.sampled_from(["tcp", "tcp64", "serial"]), st.sampled_from([N150, N200, SCOUT]))
def test_whatever_comes_there_is_an_object_a_line(lines: list[tuple[str, bytes]], wire: str, model: Model) -> None:
    transcript = WireDecoder(wire, model)
    for direction, data in lines:
        found = transcript.read(f"{direction} {data.hex()}")
        assert set(found) == {"error"} or found["to"] in ("robot", "host")


def test_what_the_c_call_does_not_name_stands_beside() -> None:
    transcript = WireDecoder("tcp", N150)
    mask = EVERYTHING.with_position(2)
    sent = {
        "connect_robot": (1, 4711), "create_robot": (2, 99), "ct": mask.smask, "special_request": (200, 1, 2),
        "tk": ("Grüß",), "arm_mv": (1, -2, 3, -4),
    }
    found = [transcript.request(codec.encode_tcp_request(Call(name, args))) for name, args in sent.items()]
    assert found == [
        {"to": "robot", "call": "connect_robot", "args": [1], "pid": 4711},
        {"to": "robot", "call": "create_robot", "args": [2], "pid": 99},
        {"to": "robot", "call": "ct", "args": [], "mask": list(mask.smask)},
        {"to": "robot", "call": "special_request", "args": [1, 2], "packet_type": 200},
        {"to": "robot", "call": "tk", "args": ["Grüß"]},
        {"to": "robot", "call": "arm_mv", "args": [1, -2, 3, -4]},
    ]


def answered(transcript: WireDecoder, name: str, reply: Reply) -> dict[str, Any]:
    """The object for the answer to that call, laid out as the terms now are."""
    return transcript.reply(codec.encode_tcp_reply(BY_NAME[name], reply, transcript.wire_state))


def asked(transcript: WireDecoder, name: str, *args: Any) -> None:
    found = transcript.request(codec.encode_tcp_request(Call(name, args), wide=transcript.wire_state.wide))
    assert found["call"] == name


def test_at_first_the_client_holds_nothing() -> None:
    # Type 82, one word, 0: no state in it.
    found = WireDecoder("tcp", N150).read("< 0052000100000000")
    assert found == {
        "to": "host", "reply": "simple", "State": [None] * 45, "Laser": None, "positions": {}, "clock": None,
        "volt_cpu": None, "volt_motor": None, "values": [0],
    }


def test_an_answer_goes_to_the_first_request_that_it_fits() -> None:
    transcript = WireDecoder("tcp", N150)
    for name in ("gs", "tk", "get_rpx", "get_sn"):
        asked(transcript, name, *(["hi"] if name == "tk" else []))
    # n = 1, then x, y, heading. tk and gs cannot have this reply: they got none and are dropped.
    found = answered(transcript, "get_rpx", Reply("simple", values=(1, 10, 20, 30)))
    assert found["obs"] == [1, 10, 20, 30]
    # The late reply to gs is no longer expected, and is read by its type.
    late = answered(transcript, "gs", Reply("state", {34: 5}))
    assert (late["reply"], late["State"][34]) == ("state", 5)
    assert answered(transcript, "get_sn", Reply("sonar", {17: 6}, clock=3))["State"][17] == 6


def test_each_answer_is_read_by_the_terms_of_its_request() -> None:
    transcript = WireDecoder("tcp", N150)
    stamped = EVERYTHING.with_position(31)
    asked(transcript, "ct", *stamped.smask)
    # The stamps are in force when the first ct is sent, and no more when its reply arrives after the second ct.
    then = transcript.wire_state.copy()
    asked(transcript, "ct", *EVERYTHING.smask)
    with_stamps = transcript.reply(codec.encode_tcp_reply(BY_NAME["ct"], Reply("state", clock=1), then))
    assert (len(with_stamps["positions"]), with_stamps["clock"]) == (35, 1)
    assert answered(transcript, "ct", Reply("state", clock=2))["clock"] == 2


def test_laser_shapes_follow_the_questions() -> None:
    transcript = WireDecoder("tcp", N150)
    lines, points = (1, 1, 2, 3, 4), (1, -5, 6)
    # get_sg sets line shape for its own reply and for later state replies, until conf_ls.
    asked(transcript, "get_sg")
    assert answered(transcript, "get_sg", Reply("laser", laser=lines))["Laser"] == list(lines)
    asked(transcript, "gs")
    assert answered(transcript, "gs", Reply("state", laser=lines))["Laser"] == list(lines)
    asked(transcript, "conf_ls", 51, 0, 0, 0, 0)
    assert answered(transcript, "conf_ls", Reply("state", laser=points))["Laser"] == list(points)


@pytest.mark.parametrize(("name", "reply", "kind"), [
    ("gs", Reply("state", clock=1), "state"), ("get_rc", Reply("configuration", {34: 1}), "configuration"),
    ("get_rv", Reply("velocity", {38: 1}), "velocity"), ("get_ir", Reply("infrared", {1: 1}), "infrared"),
    ("get_sn", Reply("sonar", {17: 1}), "sonar"), ("get_bp", Reply("bumper", {33: 1}), "bumper"),
    ("get_cp", Reply("compass", {43: 1}), "compass"), ("get_ls", Reply("laser", laser=(1, 2, 3)), "laser"),
    ("get_sg", Reply("laser", laser=(1, 2, 3, 4, 5)), "laser"), ("tk", Reply("simple", values=(0,)), "simple"),
    ("special_request", Reply("special", values=(4, 0, 0, 1)), "special"),
    ("sim_truth", Reply("truth", values=(1,) * 8), "truth"),
    ("sim_control", Reply("control", values=(1,) * 4), "control"), ("vm", Reply("error", values=(2,)), "error"),
])
def test_reply_without_request_is_read_by_its_type(name: str, reply: Reply, kind: str) -> None:
    found = answered(WireDecoder("tcp", N150), name, reply)
    assert found["reply"] == kind


@pytest.mark.parametrize(("old", "new"), [(81, 80), (90, 89)])
# 81 (moved) has the layout of the state reply 80, and 90 (acceleration) that of the velocity reply 89.
def test_types_of_old_servers(old: int, new: int) -> None:
    name, reply = ("gs", Reply("state", clock=9)) if new == 80 else ("get_ra", Reply("velocity", {38: 9}))
    # The same payload under the old type: the first two bytes are the type.
    built = struct.pack(">h", old) + codec.encode_tcp_reply(BY_NAME[name], reply, tcp_wire_state(N150))[2:]
    unseen, seen = WireDecoder("tcp", N150), WireDecoder("tcp", N150)
    asked(seen, name)
    assert unseen.reply(built) == seen.reply(built)
    assert 9 in (unseen.client_state.clock, unseen.client_state.slots[38])


def test_an_error_shows_its_code_and_leaves_the_rest() -> None:
    transcript = WireDecoder("tcp", N150)
    asked(transcript, "gs")
    before = answered(transcript, "gs", Reply("state", {34: 7}, volts=(255, 0)))
    asked(transcript, "predict_sensors", 1, 2, 3, 4)
    found = answered(transcript, "predict_sensors", Reply("error", values=(4,)))
    assert (found["reply"], found["code"], found["values"]) == ("error", 4, [4])
    assert found["State"] == [*before["State"][:44], 4]
    # The raw bytes 255 and 0: the whole range of 12 V, and 2/5 of 12.85 V.
    assert (found["volt_cpu"], found["volt_motor"]) == (12.0, 5.14)


def test_a_disconnect_is_not_answered() -> None:
    transcript = WireDecoder("tcp", N150)
    asked(transcript, "disconnect_robot", 1, 2)
    # Were a reply to disconnect_robot expected, this simple reply would be taken for it and would have no "obs".
    asked(transcript, "get_rpx")
    assert answered(transcript, "get_rpx", Reply("simple", values=(0,)))["obs"] == [0]


def test_a_prediction_is_held_nowhere() -> None:
    transcript = WireDecoder("tcp", N150)
    asked(transcript, "predict_sensors", 1, 2, 3, 4)
    found = answered(transcript, "predict_sensors", Reply("prediction", values=tuple(range(44)), laser=(1, 7, 8)))
    assert found["reply"] == "prediction"
    assert (found["State"], found["Laser"]) == ([None] * 45, None)
    # Only words 1 to 32, infrared and sonar, are a prediction.
    assert found["pred_state"] == [0, *range(1, 33), *[0] * 12]
    assert found["pred_laser"] == [1, 7, 8]


def test_the_arms_answers_by_what_was_asked() -> None:
    # A packet header of 12 bytes and type 41; int32 -2, low byte first; int32 256.
    answer = Reply("special", values=(12, 0, 0, 41, 0xFE, 255, 255, 255, 0, 1, 0, 0))
    seen = []
    for name, args in (("arm_zr", (1,)), ("arm_ws", (1, 1, 9)), ("special_request", (41, 1))):
        transcript = WireDecoder("tcp", N150)
        asked(transcript, name, *args)
        found = answered(transcript, name, answer)
        seen.append((found.get("arm"), found.get("remain")))
    # arm_zr has a result, arm_ws has a result and a remaining time, a user packet has neither.
    assert seen == [(-2, None), (-2, 256), (None, None)]
    # A packet without the result of four bytes.
    transcript = WireDecoder("tcp", N150)
    asked(transcript, "arm_ws", 1, 1, 9)
    assert "arm" not in answered(transcript, "arm_ws", Reply("special", values=(4, 0, 0, 41)))


def test_a_64_bit_client_holds_numbers_without_a_sign() -> None:
    transcript = WireDecoder("tcp64", N150)
    asked(transcript, "ct", *EVERYTHING.with_position(4).smask)
    found = answered(transcript, "ct", Reply("state", {34: -200}, laser=(1, -1, 2)))
    assert (found["State"][34], found["Laser"]) == (2**32 - 200, [1, 2**32 - 1, 2])
    asked(transcript, "get_rpx")
    assert answered(transcript, "get_rpx", Reply("simple", values=(-3,)))["obs"] == [2**32 - 3]


def test_what_a_caller_knows_beforehand() -> None:
    transcript = WireDecoder("tcp", N150)
    transcript.expect("get_rpx")
    assert answered(transcript, "get_rpx", Reply("simple", values=(5,)))["obs"] == [5]
    transcript.expect("conf_ser")
    assert "obs" not in answered(transcript, "get_rpx", Reply("simple", values=(5,)))
    with pytest.raises(WireError, match="no command 'fly'"):
        transcript.expect("fly")


def test_no_such_line() -> None:
    with pytest.raises(WireError, match=r"'usb'.* tcp, tcp64, serial"):
        WireDecoder("usb", N150)


def packet(reply: Reply, hello: Handshake) -> bytes:
    wire_state = serial_wire_state(N200)
    wire_state.set_mask(hello.mask)
    wire_state.set_laser_mode(hello.laser_mode)
    return codec.encode_serial_reply(BY_NAME["gs"], reply, wire_state)


def test_the_hello_of_a_n200_sets_mask_and_laser_mode() -> None:
    hello = Handshake(EVERYTHING.with_position(4), 33)
    transcript = WireDecoder("serial", N200)
    found = transcript.reply(build_handshake(hello))
    assert found == {"to": "host", "reply": "hello", "mask": list(hello.mask.smask), "laser_mode": 33}
    # One line of four numbers in the mode 33 of the hello, and the stamp that its position bits select.
    after = transcript.reply(packet(Reply("state", {34: 3}, laser=(1, 1, -2, 3, -4)), hello))
    assert (after["State"][34], after["Laser"], list(after["positions"])) == (3, [1, 1, -2, 3, -4], ["bumper"])


def test_a_hello_comes_once_at_the_start_from_a_n200() -> None:
    hello = build_handshake(Handshake(EVERYTHING, 51))
    again = WireDecoder("serial", N200)
    again.reply(hello)
    after_a_frame = WireDecoder("serial", N200)
    after_a_frame.reply(build_frame(8))
    # The second hello, one behind a frame, and one of a model or a line that has none.
    for transcript in (again, after_a_frame, WireDecoder("serial", N150), WireDecoder("tcp", N200)):
        assert "error" in transcript.reply(hello)
    # A frame of 11 bytes, the length of a hello, with a wrong checksum: start and end show that it is a frame.
    spoilt = build_frame(7, bytes(5))[:-2] + b"\xee\x5c"
    assert len(spoilt) == len(hello)
    assert "checksum" in WireDecoder("serial", N200).reply(spoilt)["error"]


def test_refusals_and_the_arm_on_the_line() -> None:
    transcript = WireDecoder("serial", N150)
    asked_for = codec.encode_serial_request(Call("arm_ws", (1, 1, 9)), serial_wire_state(N150))
    assert transcript.request(asked_for)["call"] == "arm_ws"
    assert transcript.reply(build_frame(8))["reply"] == "nak"
    data = bytes((12, 0, 0, 41)) + struct.pack("<iI", -2, 256)
    found = transcript.reply(build_frame(128, data))
    assert (found["reply"], found["arm"], found["remain"], found["special"]) == ("special", -2, 256, list(data))
    # Without the request a packet of type 128 may be any user packet: no result is shown.
    unseen = WireDecoder("serial", N150).reply(build_frame(128, data))
    assert "arm" not in unseen


def test_what_the_line_never_sets_stays_null() -> None:
    transcript = WireDecoder("serial", N150)
    built = codec.encode_serial_reply(BY_NAME["gs"], Reply("state", {34: -5}), serial_wire_state(N150))
    found = transcript.reply(built)
    # 0, 42 and 44 are never sent on the serial line, and a N150 sends no infrared.
    assert [slot for slot, value in enumerate(found["State"]) if value is None] == [0, *range(1, 17), 42, 44]
    assert (found["State"][34], found["Laser"]) == (-5, None)


def test_the_point_laser_on_the_line_reads_51() -> None:
    call = Call("conf_ls", (51, 20, 20, 20, 4))
    found = WireDecoder("serial", N200).request(codec.encode_serial_request(call, serial_wire_state(N200)))
    assert found["args"] == [51, 20, 20, 20, 4]
