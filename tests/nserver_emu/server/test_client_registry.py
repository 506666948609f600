"""The client registry, and the first bytes of second connections."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.server import session
from nserver_emu.server.session import ClientIdentity, ClientRegistry

HOME, ELSEWHERE = "127.0.0.1", "10.0.0.7"


def registry_with(**identities: ClientIdentity) -> ClientRegistry:
    made = ClientRegistry()
    for connection, identity in identities.items():
        made.register(connection, HOME, identity)
    return made


# Of three entries two are silent: a second connection continues the silent ones first.
def test_a_silent_client_is_continued_once() -> None:
    registry = registry_with(
        talks=ClientIdentity(1, wide=False),
        old=ClientIdentity(2, wide=False, silent=True),
        young=ClientIdentity(2, wide=False, silent=True),
    )
    found = [registry.lookup(f"second {number}", HOME, None) for number in range(3)]
    # Both silent entries are of robot 2, so it does not matter which is continued; the third gets robot 1.
    assert [[identity.robot_id for identity in each] for each in found] == [[2], [2], [1]]
    assert registry.lookup("other", ELSEWHERE, None) == []


@pytest.mark.parametrize("silent", [False, True])
@pytest.mark.parametrize("other", [ClientIdentity(2, wide=False), ClientIdentity(1, wide=True)])
def test_clients_that_differ_are_ambiguous(silent: bool, other: ClientIdentity) -> None:
    first, second = ClientIdentity(1, wide=False, silent=silent), other._replace(silent=silent)
    registry = registry_with(first=first, second=second)
    # Several identities: ambiguous. Looking up once must not resolve it for the next.
    assert registry.lookup("x", HOME, None) == [first, second]
    assert registry.lookup("y", HOME, None) == [first, second]
    registry.remove("first", disconnected=True)
    assert registry.lookup("z", HOME, None) == [second]


def test_programs_started_one_after_another_are_not_ambiguous() -> None:
    registry = ClientRegistry()
    for robot_id in (1, 2, 3):
        identity = ClientIdentity(robot_id, wide=False)
        registry.register(f"first {robot_id}", HOME, identity)
        # Each second connection finds the one program that is not continued yet.
        assert registry.lookup(f"second {robot_id}", HOME, None) == [identity]
        registry.register(f"second {robot_id}", HOME, identity)


def test_a_width_that_shows_leaves_out_the_others() -> None:
    # The silent one would be preferred, but has another word size.
    registry = registry_with(narrow=ClientIdentity(1, wide=False, silent=True), wide=ClientIdentity(2, wide=True))
    assert registry.lookup("x", HOME, True) == [ClientIdentity(2, wide=True)]
    assert registry.lookup("y", HOME, False) == [ClientIdentity(1, wide=False, silent=True)]
    registry.remove("wide")
    assert registry.lookup("z", HOME, True) == []


def test_a_request_ends_silence_and_none_removes_an_entry() -> None:
    registry = registry_with(a=ClientIdentity(1, wide=False, silent=True), b=ClientIdentity(2, wide=False, silent=True))
    registry.register("a", HOME, ClientIdentity(1, wide=False))
    assert registry.lookup("x", HOME, None) == [ClientIdentity(2, wide=False, silent=True)]
    # None: CONNECT to a robot that does not exist.
    registry.register("b", HOME, None)
    registry.register("never", HOME, None)
    assert registry.lookup("y", HOME, None) == [ClientIdentity(1, wide=False)]


def test_a_disconnect_removes_both_connections() -> None:
    registry = registry_with(a=ClientIdentity(1, wide=False, silent=True))
    # 1. Two programs with two connections each.
    assert registry.lookup("a again", HOME, None)
    registry.register("b", HOME, ClientIdentity(2, wide=False, silent=True))
    assert registry.lookup("b again", HOME, None)
    registry.register("a again", HOME, ClientIdentity(1, wide=False))
    # 2. The second connection of b closes without DISCONNECT: no effect on b itself.
    registry.remove("b again")
    assert len(registry) == 3
    # 3. DISCONNECT over the second connection of a removes both of a.
    registry.remove("a again", disconnected=True)
    assert registry.lookup("other", HOME, None) == [ClientIdentity(2, wide=False, silent=True)]
    registry.remove("b", disconnected=True)
    assert len(registry) == 0
    assert registry.lookup("late", HOME, None) == []


def test_the_first_may_close_before_the_second_speaks() -> None:
    # 1. Two connections of the address have sent nothing yet.
    registry = registry_with(a=ClientIdentity(1, wide=False, silent=True))
    for connection in ("second", "silent for ever"):
        registry.add_pending(connection, HOME)
    registry.add_pending("far away", ELSEWHERE)
    # 2. The first connection closes; its entry stays, as one of them may continue it.
    registry.remove("a")
    assert registry.lookup("second", HOME, None) == [ClientIdentity(1, wide=False, silent=True)]
    # 3. The last pending connection closes, so the entry ends.
    registry.remove("silent for ever")
    assert len(registry) == 0


def test_a_disconnect_is_not_waited_after() -> None:
    registry = registry_with(a=ClientIdentity(1, wide=False, silent=True))
    registry.add_pending("other", HOME)
    registry.remove("a", disconnected=True)
    assert registry.lookup("other", HOME, None) == []


# The mask has bits in its first word; vm with zeros at even places, and gs without words, show nothing.
MASK, TURN, GS = Call("ct", EVERYTHING.smask), Call("vm", (0, 100, 0)), Call("gs")


@pytest.mark.parametrize(
    ("call", "narrow", "wide"),
    [
        (MASK, False, True),
        (Call("vm", (100, 0, 0)), False, None),
        (Call("vm", (0, 0, 7)), False, None),
        (TURN, None, None),
        (GS, None, None),
    ],
)
def test_the_first_message_shows_the_word_size(call: Call, narrow: bool | None, wide: bool | None) -> None:
    for wide_words, expected in ((False, narrow), (True, wide)):
        message = codec.encode_tcp_request(call, wide=wide_words)
        # The fewest bytes that suffice must give the same result as the whole message.
        size = next(size for size in range(1, len(message) + 1) if session.has_header(message[:size]))
        assert session.sniff_word_size(message[:size]) is expected
        assert session.sniff_word_size(message) is expected
        assert not session.is_connect(message)


# Each is decided early: an unknown type, a CONNECT, a wrong count, a message without words.
@pytest.mark.parametrize("head", [b"GE", b"\x03\xe7", b"\x00\x66", b"\x00\x0c\x00\x02", b"\x00\x0f\x00\x00"])
def test_short_or_invalid_heads_are_complete(head: bytes) -> None:
    assert session.has_header(head)
    assert not session.has_header(head[:1])
    assert session.is_connect(head) == (head == b"\x00\x66")
