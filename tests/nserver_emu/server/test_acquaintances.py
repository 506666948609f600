"""Second connections: whose they are, and what their first bytes tell."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.server import session
from nserver_emu.server.client_registry import ClientRegistry
from nserver_emu.server.session import ClientIdentity

HOME, ELSEWHERE = "127.0.0.1", "10.0.0.7"


def guests(**met: ClientIdentity) -> ClientRegistry:
    made = ClientRegistry()
    for guest, agreed in met.items():
        made.register(guest, HOME, agreed)
    return made


def test_the_oldest_that_was_silent_since_its_connect_goes_on_and_each_but_once() -> None:
    known = guests(
        talks=ClientIdentity(1, wide=False),
        old=ClientIdentity(2, wide=False, silent=True),
        young=ClientIdentity(3, wide=False, silent=True),
        last=ClientIdentity(4, wide=False),
    )
    found = [known.lookup(f"second {number}", HOME, None) for number in range(3)]
    assert [met.robot_id for met in found if met] == [2, 3, 4]
    assert known.lookup("other", ELSEWHERE, None) is None


def test_a_width_that_shows_leaves_out_the_others() -> None:
    known = guests(narrow=ClientIdentity(1, wide=False, silent=True), wide=ClientIdentity(2, wide=True))
    assert known.lookup("x", HOME, True) == ClientIdentity(2, wide=True)
    assert known.lookup("y", HOME, False) == ClientIdentity(1, wide=False, silent=True)
    known.remove("wide")
    assert known.lookup("z", HOME, True) is None


def test_who_speaks_is_no_longer_silent_and_who_agreed_nothing_is_nobody() -> None:
    known = guests(a=ClientIdentity(1, wide=False, silent=True), b=ClientIdentity(2, wide=False, silent=True))
    known.register("a", HOME, ClientIdentity(1, wide=False))
    assert known.lookup("x", HOME, None) == ClientIdentity(2, wide=False, silent=True)
    known.register("b", HOME, None)
    known.register("never", HOME, None)
    assert known.lookup("y", HOME, None) == ClientIdentity(1, wide=False)


def test_the_gone_are_forgotten_and_a_disconnect_counts_for_both_connections() -> None:
    known = guests(a=ClientIdentity(1, wide=False, silent=True), b=ClientIdentity(2, wide=False, silent=True))
    assert known.lookup("a again", HOME, None)
    assert known.lookup("b again", HOME, None)
    known.register("a again", HOME, ClientIdentity(1, wide=False))
    known.remove("b again")
    assert len(known) == 3
    known.remove("a again", disconnected=True)
    assert known.lookup("stranger", HOME, None) == ClientIdentity(2, wide=False, silent=True)
    known.remove("b", disconnected=True)
    assert len(known) == 0
    assert known.lookup("late", HOME, None) is None


def test_the_first_may_close_before_the_second_speaks() -> None:
    known = guests(a=ClientIdentity(1, wide=False, silent=True))
    for guest in ("second", "silent for ever"):
        known.add_pending(guest, HOME)
    known.add_pending("far away", ELSEWHERE)
    known.remove("a")
    assert known.lookup("second", HOME, None) == ClientIdentity(1, wide=False, silent=True)
    known.remove("silent for ever")
    assert len(known) == 0


def test_a_disconnect_is_not_waited_after() -> None:
    known = guests(a=ClientIdentity(1, wide=False, silent=True))
    known.add_pending("stranger", HOME)
    known.remove("a", disconnected=True)
    assert known.lookup("stranger", HOME, None) is None


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
def test_what_the_first_message_tells_of_its_words(call: Call, narrow: bool | None, wide: bool | None) -> None:
    for sniff_word_size, told in ((False, narrow), (True, wide)):
        message = codec.encode_tcp_request(call, wide=sniff_word_size)
        size = next(size for size in range(1, len(message) + 1) if session.has_header(message[:size]))
        assert session.sniff_word_size(message[:size]) is told
        assert session.sniff_word_size(message) is told
        assert not session.is_connect(message)


@pytest.mark.parametrize("head", [b"GE", b"\x03\xe7", b"\x00\x66", b"\x00\x0c\x00\x02", b"\x00\x0f\x00\x00"])
def test_nobody_waits_for_what_need_not_come(head: bytes) -> None:
    assert session.has_header(head)
    assert not session.has_header(head[:1])
    assert session.is_connect(head) == (head == b"\x00\x66")
