"""Requests whose bytes are not just their numbers: texts, obstacles, motion checks, packets, flags; and refusals."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame
from nclient.protocol.commands import Call
from nclient.protocol.serial_framing import SerialFrame
from nclient.protocol.types import N150, N200, SCOUT, serial_wire_state


def tcp(name: str, *args: Any) -> bytes:
    return codec.encode_tcp_request(Call(name, args))


def line(name: str, *args: Any) -> bytes:
    return codec.encode_serial_request(Call(name, args), serial_wire_state(N200))


def words(built: bytes) -> tuple[int, ...]:
    return struct.unpack(f">{len(built) // 4 - 1}i", built[4:])


@pytest.mark.parametrize(("text", "wire"), [
    # A C string in little-endian words that are sent big-endian: each group of four characters is reversed.
    ("hello", "6c6c6568" "0000006f"), ("four", "72756f66" "00000000"), ("a", "00000061"), ("", "00000000"),
])
def test_a_text_over_tcp_arrives_in_reversed_fours(text: str, wire: str) -> None:
    assert tcp("tk", text)[4:].hex() == wire


def test_what_follows_the_nul_of_a_text_is_rubbish() -> None:
    # The first word is "hell" reversed; in the second, NUL and "o" are the low bytes; what is after the NUL is
    # undefined.
    frame = TcpFrame(19, bytes.fromhex("6c6c6568" "dead006f" "deadbeef"))
    assert codec.decode_tcp_request(frame) == Call("tk", ("hello",))
    assert tcp("tk", "hello\0world") == tcp("tk", "hello")


def test_a_text_on_the_line_ends_with_a_nul() -> None:
    assert line("tk", "hi")[4:-2] == b"hi\0"
    with pytest.raises(WireError, match="tk"):
        codec.decode_serial_request(SerialFrame(11, b"no end"), serial_wire_state(N200))


# TCP: 64 words of 4 characters, less the NUL. Serial: a frame of 255 bytes, less 6 bytes of the frame and the NUL.
@pytest.mark.parametrize(("build", "longest"), [(tcp, 255), (line, 248)])
def test_the_longest_text(build: Any, longest: int) -> None:
    assert build("tk", "x" * longest)
    with pytest.raises(WireError, match="at most"):
        build("tk", "x" * (longest + 1))


@pytest.mark.parametrize("build", [tcp, line])
@pytest.mark.parametrize(("text", "wrong"), [("wo liegt Łódź?", "Latin-1"), (5, "a text is wanted, not 5")])
def test_texts_that_cannot_be_sent(build: Any, text: Any, wrong: str) -> None:
    with pytest.raises(WireError, match=wrong):
        build("tk", text)


@pytest.mark.parametrize("args", [
    # No count; a count of 0; 11 vertices, one too many; two vertices where three are announced; one number too many;
    # a negative count; a count that is no number.
    (), (0,), (11, *range(22)), (3, 1, 2, 3, 4), (1, 1, 2, 3), (-1,), ("one", 1, 2),
])
def test_obstacles_that_cannot_be(args: tuple[Any, ...]) -> None:
    with pytest.raises(WireError, match="add_obstacle"):
        tcp("add_obstacle", *args)
    with pytest.raises(WireError, match="move_obstacle"):
        tcp("move_obstacle", *args, 1, 2, 3)


@pytest.mark.parametrize(("kind", "payload"), [
    # Types 50 (add_obstacle) and 52 (move_obstacle): counts out of range, or other than the words that follow.
    (50, (0, 1, 2)), (50, (11, 1, 2)), (50, (2, 1, 2, 3)), (52, (1, 1, 2, 3)), (52, (1, 1, 2, 3, 4, 5)),
])
def test_obstacle_words_that_contradict_themselves(kind: int, payload: tuple[int, ...]) -> None:
    with pytest.raises(WireError, match=r"obstacle .*1\.\.10"):
        codec.decode_tcp_request(TcpFrame(kind, struct.pack(f">{len(payload)}i", *payload)))


def test_motion_checks_are_truncated_toward_zero() -> None:
    # Thousandths of a tenth of an inch are sent as hundredths: -12345 becomes -1234, and not -1235. The last three
    # words are unused.
    assert words(tcp("motion_check", 0, -12345, 12349, 9, -9)) == (0, -1234, 1234, 0, 0, 0, 0, 0)
    # Angles of 1/1000 rad are sent as 1/1000000.
    arc = words(tcp("motion_check", 1, 1000, -1000, 1570.7969, -0.0019, 5000, 0, 10))
    assert arc == (1, 100, -100, 1570796, -1, 500, 0, 1)


@settings(max_examples=60)
@given(st.integers(-7_000_000, 7_000_000))
def test_angles_survive_the_round_trip(angle: int) -> None:
    call = codec.decode_tcp_request(TcpFrame(400, struct.pack(">8i", 1, 0, 0, angle, 0, 0, 0, 0)))
    assert call.args[3] == pytest.approx(angle / 1000, abs=1e-12)
    assert words(codec.encode_tcp_request(call))[3] == angle


@pytest.mark.parametrize("args", [
    # Type 2 does not exist; a line has 4 numbers, an arc 7; NaN, infinity and 10^12 fit no word.
    (), (2, 0, 0, 0, 0), (0, 1, 2, 3), (0, 1, 2, 3, 4, 5), (1, 1, 2, 3, 4), (0, math.nan, 0, 0, 0),
    (0, math.inf, 0, 0, 0), (0, 10**12, 0, 0, 0), ("line", 0, 0, 0, 0),
])
def test_motion_checks_that_cannot_be(args: tuple[Any, ...]) -> None:
    with pytest.raises(WireError, match="motion_check"):
        tcp("motion_check", *args)


def test_a_motion_check_of_no_known_type() -> None:
    with pytest.raises(WireError, match=r"0 \(line\).* 1 \(arc\)"):
        codec.decode_tcp_request(TcpFrame(400, struct.pack(">8i", 2, *[0] * 7)))


def test_a_special_packet_counts_its_own_four_bytes() -> None:
    # Length 7 = 4 bytes of header + 3 of data, low byte first; serial number 0; packet type 200; data.
    assert line("special_request", 200, 1, 2, 250)[4:-2].hex() == "0700" "00" "c8" "0102fa"
    # The same bytes, one in each word.
    assert words(tcp("special_request", 200, 1, 2, 250)) == (7, 0, 0, 200, 1, 2, 250)


# Lengths one too large and one too small, a header that is cut off, no header.
@pytest.mark.parametrize("data", ["0800" "00" "c8" "0102fa", "0600" "00" "c8" "0102fa", "0700", ""])
def test_a_special_packet_of_another_length_than_it_says(data: str) -> None:
    raw = bytes.fromhex(data)
    with pytest.raises(WireError, match="special_request"):
        codec.decode_serial_request(SerialFrame(128, raw), serial_wire_state(N150))
    with pytest.raises(WireError, match="special_request"):
        codec.decode_tcp_request(TcpFrame(300, struct.pack(f">{len(raw)}i", *raw)))


# No type; a type above 255; bytes out of 0..255; 251 bytes, one too many; a fraction.
@pytest.mark.parametrize("args", [(), (256,), (1, -1), (1, 256), (1, *[0] * 251), (1, 1.5)])
def test_special_packets_that_cannot_be(args: tuple[Any, ...]) -> None:
    with pytest.raises(WireError, match="special_request"):
        tcp("special_request", *args)


def test_the_longest_special_packet() -> None:
    # A header of 4 bytes, then 4 words of packet header and 250 of data.
    assert len(tcp("special_request", 1, *[7] * 250)) == 4 + 4 * 254
    # 6 bytes of the frame, 4 of the packet header, 245 of data: the 255 bytes that a host's frame may have.
    assert len(line("special_request", 1, *[7] * 245)) == 255
    with pytest.raises(WireError, match="255 bytes, not 256"):
        line("special_request", 1, *[7] * 246)


def test_the_arms_packets() -> None:
    # Packet types 40, 41, 42 = 0x28, 0x29, 0x2a; all numbers low byte first.
    assert line("arm_zr", 1)[4:-2].hex() == "0600" "00" "28" "0100"
    assert line("arm_ws", 1, 2, 500)[4:-2].hex() == "0c00" "00" "29" "0100" "0200" "f4010000"
    # -300 in two's complement: the arm's packets are not sign-magnitude, as all else on the serial line is.
    assert line("arm_mv", 1, 2000, 2, -300)[4:-2].hex() == "1400" "00" "2a" "01000000" "d0070000" "02000000" "d4feffff"


def test_user_packet_with_an_arm_number_stays_a_user_packet() -> None:
    # Packet 41 is arm_ws, but three bytes are not its 8: the call must not be decoded as arm_ws.
    call = Call("special_request", (41, 1, 2, 3))
    frame = codec.encode_serial_request(call, serial_wire_state(N150))
    assert codec.decode_serial_request(SerialFrame(128, frame[4:-2]), serial_wire_state(N150)) == call
    built = codec.encode_tcp_request(call)
    assert codec.decode_tcp_request(TcpFrame(300, built[4:])) == call


def test_flags_are_0_or_1() -> None:
    # Any number other than 0 is sent as 1; the timeout stays.
    assert words(tcp("ws", 5, 0, -1, 20)) == (1, 0, 1, 20)
    assert line("ws", 5, 0, -1, 20)[4:-2].hex() == "01000114"
    assert codec.decode_serial_request(SerialFrame(31, b"\x05\x00\xff\x14"), serial_wire_state(N150)).args == (
        1,
        0,
        1,
        20,
    )


def test_a_history_of_more_than_10_is_sent_as_10_on_the_line() -> None:
    # The limit of 10 belongs to the serial line alone.
    assert line("conf_ir", 12, *range(16))[4] == 10
    assert words(tcp("conf_ir", 12, *range(16)))[0] == 12


def test_the_point_laser_is_35_on_the_line() -> None:
    assert line("conf_ls", 51, 20, 20, 20, 4)[4] == 35
    # num_data is a uint16: 20, 0.
    call = codec.decode_serial_request(SerialFrame(17, bytes((35, 20, 20, 20, 0, 4))), serial_wire_state(N200))
    assert call == Call("conf_ls", (51, 20, 20, 20, 4))


# Out of int16, out of sign-magnitude, a fraction, a text, too few, too many.
@pytest.mark.parametrize("args", [(40000, 0, 0), (0, -32768, 0), (1.5, 0, 0), ("1", 0, 0), (1, 2), (1, 2, 3, 4)])
def test_numbers_that_vm_cannot_carry_on_the_line(args: tuple[Any, ...]) -> None:
    with pytest.raises(WireError, match="vm"):
        line("vm", *args)


@pytest.mark.parametrize("args", [(2**31, 0, 0), (1.5, 0, 0), (None, 0, 0), (1, 2), ()])
def test_numbers_that_vm_cannot_carry_over_tcp(args: tuple[Any, ...]) -> None:
    with pytest.raises(WireError, match="vm"):
        tcp("vm", *args)


def test_wrong_argument_count_lists_the_names() -> None:
    with pytest.raises(WireError, match=r"dp .*2 .*\(x, y\), .*1"):
        tcp("dp", 1)
    with pytest.raises(WireError, match=r"gs .*0 .*\(nothing\), .*1"):
        tcp("gs", 1)


def test_masks_that_cannot_be_sent() -> None:
    for build in (tcp, line):
        with pytest.raises(WireError, match="a mask is"):
            build("ct", 32, *[0] * 43)


@pytest.mark.parametrize(("name", "args", "models"), [
    ("pa", (1, 2, 3), (N150, SCOUT)), ("conf_ser", (1, 9600), (N200,)), ("get_cp", (), (N150, SCOUT)),
    ("get_rpx", (), (N150, N200, SCOUT)), ("ct", (0,) * 44, (N150, SCOUT)), ("tk", ("hi",), (N150,)),
])
def test_what_a_models_line_does_not_have(name: str, args: tuple[Any, ...], models: tuple[Any, ...]) -> None:
    for model in models:
        with pytest.raises(WireError, match=f"{name} does not exist .* {model.name}"):
            codec.encode_serial_request(Call(name, args), serial_wire_state(model))


def test_what_tcp_does_not_have() -> None:
    with pytest.raises(WireError, match=r"conf_ser .*over TCP"):
        tcp("conf_ser", 1, 9600)
    with pytest.raises(WireError, match="no command 'fly'"):
        tcp("fly")


def test_the_arms_numbers_are_taken_signed_and_unsigned() -> None:
    # Bytes of the arm's packets are the same for 4000000000 and its two's complement.
    as_unsigned = codec.encode_tcp_request(Call("arm_mv", (1, 4_000_000_000, 2, 5)))
    assert as_unsigned == codec.encode_tcp_request(Call("arm_mv", (1, 4_000_000_000 - 2**32, 2, 5)))
    with pytest.raises(WireError):
        codec.encode_tcp_request(Call("arm_mv", (1, 2**32, 2, 5)))
