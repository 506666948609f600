"""Requests and replies leave nothing that holds itself: a daemon would keep it until it looks for garbage."""

from __future__ import annotations

import gc
from collections.abc import Callable

import pytest
from construct import Construct, Int8ub, Sequence, Struct
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import WireError
from nclient.protocol import codec, layouts, serial_framing
from nclient.protocol.client_state import Handshake, build_handshake, read_handshake
from nclient.protocol.commands import Command
from nclient.protocol.replies import STATE, Reply
from nclient.protocol.types import EVERYTHING, N150, Model, serial_wire_state, tcp_wire_state
from tests.nclient.protocol.strategies import LINE_CASE_NAMES, LINE_CASES, TCP_ROWS, calls

few = settings(max_examples=3)


def garbage_of(act: Callable[[], object]) -> int:
    """Return the number of objects of a second call that only the garbage collector frees."""
    # The first call fills caches, which stay referenced. Objects that exist by then are exempt from the collection,
    # so that only what the second call leaves is counted.
    act()
    gc.disable()
    gc.freeze()
    try:
        act()
        return gc.collect()
    finally:
        gc.unfreeze()
        gc.enable()


@pytest.mark.parametrize("row", TCP_ROWS, ids=lambda row: row.name)
@few
@given(data=st.data())
def test_a_request_over_tcp(row: Command, data: st.DataObject) -> None:
    call = data.draw(calls(row, line=False))

    def there_and_back() -> None:
        frame = codec.parse_single_frame(codec.encode_tcp_request(call), codec.request_bounds, False)
        assert codec.decode_tcp_request(frame) == call

    assert garbage_of(there_and_back) == 0


@pytest.mark.parametrize(("row", "model"), LINE_CASES, ids=LINE_CASE_NAMES)
@few
@given(data=st.data())
def test_a_request_on_the_line(row: Command, model: Model, data: st.DataObject) -> None:
    call, wire_state = data.draw(calls(row, line=True)), serial_wire_state(model)

    def there_and_back() -> None:
        assert (
            codec.decode_serial_request(
                serial_framing.parse_single_frame(codec.encode_serial_request(call, wire_state)), wire_state
            )
            == call
        )

    assert garbage_of(there_and_back) == 0


def test_a_reply() -> None:
    wire_state, captured = (
        tcp_wire_state(N150),
        Reply("state", slots=dict.fromkeys(range(1, 45), 0), laser=(0,), clock=1),
    )

    def there_and_back() -> None:
        codec.parse_tcp_payload(STATE, codec.build_tcp_payload(STATE, captured, wire_state), wire_state)

    assert garbage_of(there_and_back) == 0


def test_a_hello() -> None:
    assert garbage_of(lambda: read_handshake(build_handshake(Handshake(EVERYTHING, 51)))) == 0


def test_bytes_that_are_no_request() -> None:
    def refused() -> None:
        with pytest.raises(WireError):
            # The traceback of an exception refers to frames, and their variables may refer to the exception: a cycle.
            codec.decode_tcp_request(codec.TcpFrame(codec.find_command("vm").tcp_type or 0, b"12345"))

    assert garbage_of(refused) == 0


@pytest.mark.parametrize("layout", [Int8ub, Sequence(Int8ub, Int8ub), Struct("a" / Struct("b" / Int8ub))])
def test_it_says_what_construct_says(layout: Construct) -> None:
    data = bytes(range(layout.sizeof()))
    value = layout.parse(data)
    assert layouts.parse(layout, data) == value
    assert layouts.build(layout, value) == layout.build(value) == data
