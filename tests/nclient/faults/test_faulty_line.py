"""One connection under a plan: frames get their commands' names, on the line and over TCP, and keep their order."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.faults.inject import (
    LINE_NAK,
    DelayQueue,
    Delivery,
    FaultyLine,
    Injector,
    Language,
    LineLanguage,
    TcpLanguage,
)
from nclient.faults.plan import Delay, Direction, Drop, DropByte, Fault, Nak, Plan, Rule, When
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import build_frame
from nclient.protocol.types import N150, serial_wire_state, tcp_wire_state

REQUEST, REPLY = Direction.REQUEST, Direction.REPLY


def faulty(
    fault: Fault, command: str, spoken: Language, direction: Direction = REPLY, when: When | None = None
) -> FaultyLine:
    rule = Rule("it", (fault,), when or When(), (command,), frozenset({direction}))
    injector = Injector(Plan((rule,)), "serial:1")
    return FaultyLine(spoken, lambda: injector)


def reported(deliveries: list[Delivery]) -> bytes:
    return b"".join(delivery.data for delivery in deliveries)


def drained(transit: DelayQueue, now_s: float) -> list[int]:
    found = []
    while arrived := transit.take(now_s):
        at_s, delivery = arrived
        assert at_s <= now_s
        found.append(delivery.data[0])
    return found


def line_request(name: str, *args: int) -> bytes:
    return codec.encode_serial_request(Call(name, args), serial_wire_state(N150))


def tcp_reply(kind: str = "simple", wide: bool = False) -> bytes:
    wire_state = tcp_wire_state(N150)
    wire_state.wide = wide
    row = BY_NAME["place_robot" if kind == "simple" else "gs"]
    return codec.encode_tcp_reply(row, Reply(kind, values=(0,)), wire_state)


# 1. A rule for the requests of gs: a request that arrives in pieces is forwarded when it is whole.
def test_on_the_line_a_request_and_a_reply_name_their_command() -> None:
    line = faulty(Drop(), "gs", LineLanguage(), REQUEST)
    vm, gs = line_request("vm", 1, 2, 3), line_request("gs")
    assert reported(line.request(vm[:4], 0.0)) == b""
    assert reported(line.request(vm[4:] + gs + vm, 0.0)) == vm + vm
    # 2. A rule for the replies of get_rc, type 21; the reply of get_bp, type 27, and bytes of no frame pass.
    line = faulty(Drop(), "get_rc", LineLanguage())
    pose, bumper = build_frame(21, bytes(8)), build_frame(27, bytes(7))
    assert reported(line.reply(pose + b"dirt" + bumper, 0.0)) == b"dirt" + bumper


# A NAK has a type of its own, 8, for all commands: it belongs to the last request.
def test_on_the_line_a_nak_answers_what_was_asked_last() -> None:
    line = faulty(Drop(), "gs", LineLanguage())
    line.request(line_request("vm", 1, 2, 3), 0.0)
    assert reported(line.reply(LINE_NAK, 0.0)) == LINE_NAK
    line.request(line_request("gs"), 0.0)
    assert line.reply(LINE_NAK, 0.0) == []


def test_a_greeting_has_a_name_of_its_own() -> None:
    line = faulty(Drop(), "hello", LineLanguage(has_handshake=True))
    frame = build_frame(7)
    # Eleven bytes without a frame are the handshake, which rules name "hello".
    assert reported(line.reply(bytes(11) + frame, 0.0)) == frame


def test_tcp_replies_belong_to_delivered_requests() -> None:
    spoken = TcpLanguage(wide=False)
    # Requests of vm are dropped, and so are replies of gs. Replies have no command's name over TCP.
    rules = (Rule("lost", (Drop(),), When(), ("vm",), frozenset({REQUEST})), Rule("it", (Drop(),), When(), ("gs",)))
    injector = Injector(Plan(rules), "nserver")
    line = FaultyLine(spoken, lambda: injector)
    for name, args in (("st", ()), ("vm", (1, 2, 3)), ("gs", ()), ("lp", ())):
        line.request(codec.encode_tcp_request(Call(name, args)), 0.0)
    # The first reply belongs to st, the second one to gs, since vm was never delivered, and the third one to lp.
    answered = [line.reply(tcp_reply(), 0.0) for _ in range(3)]
    assert [bool(found) for found in answered] == [True, False, True]
    # Another reply belongs to no request: no rule applies.
    assert reported(line.reply(tcp_reply(), 0.0)) == tcp_reply()
    # Type 999, which does not exist: it is forwarded, as the far end must reject it.
    unknown = b"\x03\xe7\x00\x00"
    assert reported(line.request(unknown, 0.0)) == unknown


def test_over_tcp_a_nak_is_an_error_reply_as_wide_as_the_client() -> None:
    for wide in (False, True):
        line = faulty(Nak(), "vm", TcpLanguage(), REQUEST)
        # The word size of the error reply must be that of the client, which only its CONNECT shows.
        connect = codec.encode_tcp_request(Call("connect_robot", (1, 77)), wide=wide)
        assert reported(line.request(connect, 0.0)) == connect
        (refusal,) = line.request(codec.encode_tcp_request(Call("vm", (1, 2, 3)), wide=wide), 0.0)
        assert refusal.to_sender
        (frame,) = TcpFramer(reply_bounds, wide).receive(refusal.data)
        # Error 5: refused by the setup.
        assert frame == TcpFrame(91, (5).to_bytes(4, "big"))
        # The request was not delivered, so that the next reply does not belong to it.
        assert reported(line.reply(tcp_reply(wide=wide), 0.0)) == tcp_reply(wide=wide)


def test_incomplete_frame_is_buffered_until_flushed() -> None:
    line = faulty(DropByte(0), "gs", LineLanguage())
    request = line_request("gs")
    assert line.request(request[:-1], 0.0) == []
    saved = [line.has_partial_request]
    # After the gap the rest of a frame is forwarded as it is, since a far end must see what a line would deliver.
    assert reported(line.flush_request(0.0)) == request[:-1]
    assert [*saved, line.has_partial_request] == [True, False]
    # 0.25 s of silence end a frame on a serial line. TCP delivers all bytes, so that there is no such limit.
    assert (line.partial_timeout_s, faulty(Drop(), "gs", TcpLanguage()).partial_timeout_s) == (0.25, None)
    assert reported(line.request(request[:-1], 0.0, whole=True)) == request[:-1]
    assert line.reply(request[:-1], 0.0) == []
    assert reported(line.flush_reply(0.0)) == request[:-1]
    assert line.flush_reply(0.0) == []


def test_a_delay_is_handed_on() -> None:
    line = faulty(Delay(2.0), "gs", LineLanguage())
    assert line.reply(build_frame(7), 0.0) == [Delivery(2.0, build_frame(7))]


@settings(max_examples=80)
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 3.0)), max_size=20))
def test_nothing_overtakes_and_nothing_comes_early(steps: list[tuple[float, float]]) -> None:
    transit, now_s = DelayQueue(), 0.0
    due: list[float] = []
    came: list[int] = []
    for number, (pause_s, delay_s) in enumerate(steps):
        now_s += pause_s
        came += drained(transit, now_s)
        transit.add([Delivery(delay_s, bytes((number,)))], now_s)
        # A frame is due after its own delay, and not before any frame that was sent earlier.
        due.append(max([now_s + delay_s, *due]))
        assert transit.next_s == (due[len(came)] if len(came) <= number else None)
        assert all(due[k] <= now_s for k in came)
    assert transit.size == len(steps) - len(came)
    came += drained(transit, 10_000.0)
    assert transit.size == 0
    assert came == list(range(len(steps)))
    assert transit.next_s is None
