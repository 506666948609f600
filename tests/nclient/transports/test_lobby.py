"""Who waits at a port: whose turn it is, who is closed, and who is told of."""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from nclient.transports.listener import CROWDED, MOST_WAITING, TcpDoor
from nclient.transports.stream import Deadline

Call = Callable[..., socket.socket]


@pytest.fixture(name="told")
def _told() -> list[tuple[str, str]]:
    return []


@pytest.fixture(name="reasons")
def _reasons() -> dict[str, str]:
    """Why an address may not come in."""
    return {}


@pytest.fixture(name="door")
def _door(told: list[tuple[str, str]], reasons: dict[str, str]) -> Iterator[TcpDoor]:
    door = TcpDoor("127.0.0.1", 0, lambda host, _at: reasons.get(host, ""), lambda *what: told.append(what))
    yield door
    door.close()


@pytest.fixture(name="call")
def _call(door: TcpDoor) -> Iterator[Call]:
    with ExitStack() as open_ones:
        def call(saying: bytes = b"") -> socket.socket:
            caller = open_ones.enter_context(socket.create_connection(("127.0.0.1", door.port), 10))
            caller.sendall(saying)
            return caller

        yield call


def until(happens: Callable[[], bool]) -> None:
    """What was sent is there a moment later."""
    deadline = Deadline.after(10)
    while not happens():
        assert deadline.remaining()
        time.sleep(0.001)


def first_word(door: TcpDoor) -> bytes:
    """Of whose turn it is; his turn is over then."""
    peer = door.peer()
    try:
        return peer.receive(Deadline.after(10))
    finally:
        peer.close()


def is_closed(caller: socket.socket) -> bool:
    try:
        return caller.recv(1) == b""
    except ConnectionResetError:
        return True


def test_who_says_nothing_is_not_asked_for_and_comes_in_where_nobody_else_is(door: TcpDoor, call: Call) -> None:
    assert not door.wanted()
    first = call()
    assert not door.wanted()
    peer = door.peer()
    first.sendall(b"first")
    assert peer.receive(Deadline.after(10)) == b"first"
    peer.close()


def test_where_nobody_waits_it_waits_for_somebody(door: TcpDoor, call: Call) -> None:
    comes = threading.Timer(0.05, call, (b"here I am",))
    comes.start()
    peer = door.peer()
    comes.join()
    assert peer.receive(Deadline.after(10)) == b"here I am"
    peer.close()


def test_who_says_something_is_asked_for_and_comes_before_those_that_do_not(door: TcpDoor, call: Call) -> None:
    call(), call(), call(b"one"), call(b"two")
    until(door.wanted)
    for word in (b"one", b"two"):
        assert first_word(door) == word
    assert not door.wanted()


def test_who_leaves_without_a_word_is_forgotten(door: TcpDoor, call: Call) -> None:
    left, broke = call(), call()
    assert not door.wanted()
    left.close()
    broke.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    broke.close()
    assert not door.wanted()
    last = call()
    peer = door.peer()
    last.sendall(b"last")
    assert peer.receive(Deadline.after(10)) == b"last"
    peer.close()


def test_who_may_not_come_in_is_closed_at_once_and_told_of(
    door: TcpDoor, call: Call, told: list[tuple[str, str]], reasons: dict[str, str]
) -> None:
    reasons["127.0.0.1"] = "because"
    outsiders = [call(b"let me in") for _ in range(2)]
    until(lambda: not door.wanted() and len(told) == 2)
    assert all(map(is_closed, outsiders))
    assert told == [("127.0.0.1", "because")] * 2
    reasons.clear()
    call(b"mine")
    assert first_word(door) == b"mine"


def test_a_crowd_of_silent_ones_keeps_nobody_out_who_speaks(
    door: TcpDoor, call: Call, told: list[tuple[str, str]]
) -> None:
    crowd = [call() for _ in range(MOST_WAITING)]
    assert not door.wanted()
    call(b"stop")
    until(door.wanted)
    assert is_closed(crowd[0])
    assert told == [("127.0.0.1", CROWDED)]
    assert first_word(door) == b"stop"


def test_where_all_who_wait_have_spoken_the_newcomer_is_turned_away(
    door: TcpDoor, call: Call, told: list[tuple[str, str]]
) -> None:
    for _ in range(MOST_WAITING):
        call(b"I")
        until(door.wanted)
    last = call(b"me, too")
    until(lambda: door.wanted() and bool(told))
    assert is_closed(last)
    assert told == [("127.0.0.1", CROWDED)]


def test_a_door_that_closes_sends_everybody_away(door: TcpDoor, call: Call) -> None:
    waiting = call()
    assert not door.wanted()
    door.close()
    assert is_closed(waiting)
