"""The conversation apart from who answers: order, refusals, later answers, 64-bit clients."""

from __future__ import annotations

import logging
import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING
from nserver_emu.server.session import ClientIdentity, ConnectionContext, DeferredReply, Session, error_reply

CONNECT = codec.encode_tcp_request(Call("connect_robot", (1, 7)))
GS = codec.encode_tcp_request(Call("gs"))


def answer(call: Call, context: ConnectionContext) -> Reply | DeferredReply:
    """A robot that says hello and then always the same."""
    if call.name == "connect_robot":
        context.robot_id = call.args[0]
        return Reply("simple", values=(7019,))
    if call.name == "tk":
        return Reply("simple", values=(0,))
    if call.name in ("get_ir", "get_cp"):
        return error_reply(4)
    return Reply("state", {36: 900}, clock=5, volts=(1, 2))


def types(data: bytes, wide: bool = False) -> list[int]:
    frames = TcpFramer(reply_bounds, wide=wide).receive(data)
    return [frame.type for frame in frames if isinstance(frame, TcpFrame)]


def error_codes(data: bytes) -> list[int]:
    frames = TcpFramer(reply_bounds, wide=False).receive(data)
    return [frame.payload[-1] for frame in frames if isinstance(frame, TcpFrame) and frame.type == 91]


def connected() -> Session:
    session = Session(answer)
    session.receive(CONNECT)
    assert types(session.process_requests(max_requests=5)) == [82]
    return session


def test_replies_come_one_a_request_in_order() -> None:
    session = connected()
    session.receive(GS + codec.encode_tcp_request(Call("tk", ("hi",))) + GS)
    # Types of replies: 82 simple, 80 state, 91 error.
    assert types(session.process_requests(max_requests=10)) == [80, 82, 80]


def test_no_more_than_asked_are_answered_at_a_time() -> None:
    session = connected()
    session.receive(GS * 5)
    # Two of five requests per call, so that other connections get their turn in between.
    assert types(session.process_requests(max_requests=2)) == [80, 80]
    assert session.ready
    assert types(session.process_requests(max_requests=9)) == [80, 80, 80]
    assert not session.ready


@given(st.lists(st.integers(1, 40), max_size=8))
@settings(max_examples=40)
def test_any_cuts_give_the_same_replies(cuts: list[int]) -> None:
    stream = CONNECT + GS + codec.encode_tcp_request(Call("vm", (1, -2, 3))) + GS
    session, replies = Session(answer), b""
    # TCP may cut the stream anywhere; a cut of 1 byte separates the bytes of a header.
    for cut in [*cuts, len(stream)]:
        session.receive(stream[:cut])
        stream = stream[cut:]
        replies += session.process_requests(max_requests=10)
    assert types(replies) == [82, 80, 80, 80]


def test_a_request_behind_a_later_answer_waits_its_turn() -> None:
    promised: list[Reply] = []

    def slow(call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        if call.name == "ws":
            return lambda: promised.pop() if promised else None
        return answer(call, context)

    session = Session(slow)
    session.receive(CONNECT)
    session.process_requests(max_requests=1)
    # tk behind ws would be answered at once, if it did not have to wait.
    session.receive(codec.encode_tcp_request(Call("ws", (1, 1, 1, 5))) + codec.encode_tcp_request(Call("tk", ("x",))))
    assert session.process_requests(max_requests=9) == b""
    assert session.waiting
    assert not session.ready
    assert session.tick() == b""
    promised.append(Reply("state", clock=1))
    assert types(session.tick()) == [80]
    assert types(session.process_requests(max_requests=9)) == [82]
    assert session.tick() == b""


@pytest.mark.parametrize(
    ("request_bytes", "code"),
    [
        # An unknown type 999 (03e7); vm (000c) with two words instead of three; add_obstacle (0032) with 99 corners.
        (b"\x03\xe7\x00\x01abcd", 1),
        (b"\x00\x0c\x00\x02" + bytes(8), 2),
        (b"\x00\x32\x00\x03" + b"\x00\x00\x00\x63" * 3, 2),
    ],
)
def test_a_bad_request_gets_an_error_and_the_session_goes_on(request_bytes: bytes, code: int) -> None:
    session = connected()
    session.receive(request_bytes + GS)
    replies = session.process_requests(max_requests=9)
    assert types(replies) == [91, 80]
    assert error_codes(replies) == [code]
    assert not session.closing
    assert session.refused == 1


def test_a_stream_without_frames_gets_one_error_and_is_closed() -> None:
    session = connected()
    # "GE" is read as type 18245 with a count of 21536 ("T "): more than can be skipped, so synchronisation is lost.
    session.receive(b"GET / HTTP/1.1\r\nHost: example\r\n\r\n" + GS)
    assert error_codes(session.process_requests(max_requests=9)) == [1]
    assert session.closing
    session.receive(GS)
    assert session.process_requests(max_requests=9) == b""


def test_nothing_but_connect_is_answered_before_connect() -> None:
    session = Session(answer)
    session.receive(GS)
    assert error_codes(session.process_requests(max_requests=1)) == [3]


def test_disconnect_has_no_reply_and_closes() -> None:
    session = connected()
    session.receive(codec.encode_tcp_request(Call("disconnect_robot", (1, 7))))
    assert session.process_requests(max_requests=1) == b""
    assert session.closing


def test_a_64_bit_client_is_recognised_by_its_connect() -> None:
    session = Session(answer)
    session.receive(codec.encode_tcp_request(Call("connect_robot", (1, 7)), wide=True))
    reply = session.process_requests(max_requests=1)
    # Type 82 (0052), one word; a reply word of a 64-bit client is the value, 7019 = 1b6b, and four zero bytes.
    assert reply == bytes.fromhex("00520001") + bytes.fromhex("00001b6b00000000")
    # An invalid request of a 64-bit client is skipped with eight bytes per word.
    session.receive(b"\x00\x0c\x00\x02" + bytes(16) + codec.encode_tcp_request(Call("gs"), wide=True))
    assert types(session.process_requests(max_requests=2), wide=True) == [91, 80]


def test_each_kind_of_refusal_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    session = connected()
    with caplog.at_level(logging.WARNING):
        # Four invalid frames, two of each kind: only the first of each kind is logged.
        session.receive(2 * (b"\x00\x0c\x00\x02" + bytes(8) + b"\x03\xe7\x00\x00"))
        session.receive(2 * codec.encode_tcp_request(Call("get_ir")) + codec.encode_tcp_request(Call("get_cp")))
        session.process_requests(max_requests=9)
    # 2 + 2 invalid frames, get_ir twice, get_cp once.
    assert session.refused == 7
    assert [record.getMessage().split(" (")[0] for record in caplog.records] == [
        "client: refused: type 12 takes 3 words, not 2", "client: refused: unknown message type 999",
        "client: refused: get_ir: error 4", "client: refused: get_cp: error 4",
    ]  # fmt: skip


def test_ambiguous_client_is_refused_and_closed(caplog: pytest.LogCaptureFixture) -> None:
    # Robots and word sizes differ, so the connection could be given another program's robot.
    session = Session(answer, find_identity=lambda _: [ClientIdentity(1, wide=False), ClientIdentity(2, wide=True)])
    with caplog.at_level(logging.WARNING):
        session.receive(GS)
        assert error_codes(session.process_requests(max_requests=9)) == [3]
    assert session.closing
    assert session.identity is None
    assert "robot 1 (32-bit words) or robot 2 (64-bit words)" in caplog.text


@pytest.mark.parametrize("name", ["connect_robot", "create_robot"])
def test_connect_to_robot_0_with_32_bit_words(name: str, caplog: pytest.LogCaptureFixture) -> None:
    session = Session(lambda call, _: Reply("simple", values=(0 if call.args[0] == 0 else 7019,)))
    # For a 64-bit client the first word would be four zero bytes, so the session waits for more.
    session.receive(codec.encode_tcp_request(Call(name, (0, 4711))))
    assert not session.ready
    assert session.may_have_32_bit_words
    with caplog.at_level(logging.WARNING):
        # The connection calls this after CONNECT_WAIT_S without the rest.
        session.assume_32_bit_words()
    assert session.process_requests(max_requests=1) == bytes.fromhex("0052000100000000")
    assert "connects to robot 0" in caplog.text


def test_incomplete_connect_with_64_bit_words_is_completed() -> None:
    session = Session(answer)
    request = codec.encode_tcp_request(Call("connect_robot", (1, 7)), wide=True)
    found = []
    # After twelve bytes the message could be a whole CONNECT to robot 0 with 32-bit words; the rest decides.
    for part in (request[:12], request[12:]):
        session.receive(part)
        found.append(session.may_have_32_bit_words)
    session.assume_32_bit_words()
    assert found == [True, False]
    assert types(session.process_requests(max_requests=1), wide=True) == [82]


@pytest.mark.parametrize("layout", [">i4x", "<i4x"])
def test_64_bit_words_of_another_layout_are_logged(layout: str, caplog: pytest.LogCaptureFixture) -> None:
    # Type 102 (0066) with two words, but the value in the first half of each eight bytes.
    session = Session(answer)
    words = struct.pack(layout, 1) + struct.pack(layout, 4711)
    with caplog.at_level(logging.WARNING):
        session.receive(b"\x00\x66\x00\x02" + words)
        assert error_codes(session.process_requests(max_requests=9)) == [2]
    assert session.closing
    assert "words of eight bytes with the value in front" in caplog.text


@given(st.binary(max_size=400))
@settings(max_examples=150)
def test_any_bytes_get_errors_or_nothing(data: bytes) -> None:
    session = connected()
    session.receive(data)
    while session.ready:
        replies = session.process_requests(max_requests=100)
        assert len(types(replies)) >= 1


def second_connection(wide: bool = False) -> Session:
    return Session(answer, find_identity=lambda _: [ClientIdentity(3, wide)])


@pytest.mark.parametrize("wide", [False, True])
def test_an_old_client_continues_without_connect(wide: bool) -> None:
    session = second_connection(wide)
    # Single bytes: the word size must be found from however many bytes have arrived.
    for byte in codec.encode_tcp_request(Call("tk", ("hi",)), wide=wide) + codec.encode_tcp_request(
        Call("gs"), wide=wide
    ):
        session.receive(bytes([byte]))
    assert types(session.process_requests(max_requests=5), wide=wide) == [82, 80]
    assert session.identity == ClientIdentity(3, wide)


def test_a_second_connection_with_connect_is_independent() -> None:
    session = second_connection(wide=True)
    assert session.identity is None
    session.receive(CONNECT + GS)
    assert types(session.process_requests(max_requests=5)) == [82, 80]
    assert session.identity == ClientIdentity(1, wide=False)


# A silent client has sent nothing but CONNECT and its sensor mask: its second connection is preferred.
def test_a_client_is_silent_until_a_request_after_connect() -> None:
    session = connected()
    assert session.identity == ClientIdentity(1, wide=False, silent=True)
    session.receive(codec.encode_tcp_request(Call("ct", EVERYTHING.smask)))
    session.process_requests(max_requests=1)
    assert session.identity == ClientIdentity(1, wide=False, silent=True)
    session.receive(GS)
    session.process_requests(max_requests=1)
    assert session.identity == ClientIdentity(1, wide=False)


@pytest.mark.parametrize(("pid", "seen"), [(b"\0\0\0\xff", False), (b"\0\0\0\0", True)])
def test_the_width_that_the_first_words_show_is_asked_for(pid: bytes, seen: bool) -> None:
    asked: list[bool | None] = []

    def find(wide: bool | None) -> list[ClientIdentity]:
        asked.append(wide)
        return []

    session = Session(answer, find_identity=find)
    # ct (type 16, seven words), byte by byte. The mask's first word is never 0: zeros there come from 64-bit words.
    for byte in b"\0\x10\0\x07" + pid + b"\0\0\0\xff" + bytes(20):
        assert session.unfinished <= 31
        session.receive(bytes([byte]))
    assert asked == [seen]
