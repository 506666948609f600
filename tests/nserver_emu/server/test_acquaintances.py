"""Second connections: whose they are, and what their first bytes tell."""

from __future__ import annotations

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from nserver_emu.server import session
from nserver_emu.server.client_registry import Acquaintances
from nserver_emu.server.session import Acquaintance

HOME, ELSEWHERE = "127.0.0.1", "10.0.0.7"


def guests(**met: Acquaintance) -> Acquaintances:
    made = Acquaintances()
    for guest, agreed in met.items():
        made.note(guest, HOME, agreed)
    return made


def test_the_oldest_that_was_silent_since_its_connect_goes_on_and_each_but_once() -> None:
    known = guests(
        talks=Acquaintance(1, wide=False),
        old=Acquaintance(2, wide=False, silent=True),
        young=Acquaintance(3, wide=False, silent=True),
        last=Acquaintance(4, wide=False),
    )
    found = [known.find(f"second {number}", HOME, None) for number in range(3)]
    assert [met.robot_id for met in found if met] == [2, 3, 4]
    assert known.find("other", ELSEWHERE, None) is None


def test_a_width_that_shows_leaves_out_the_others() -> None:
    known = guests(narrow=Acquaintance(1, wide=False, silent=True), wide=Acquaintance(2, wide=True))
    assert known.find("x", HOME, True) == Acquaintance(2, wide=True)
    assert known.find("y", HOME, False) == Acquaintance(1, wide=False, silent=True)
    known.leave("wide")
    assert known.find("z", HOME, True) is None


def test_who_speaks_is_no_longer_silent_and_who_agreed_nothing_is_nobody() -> None:
    known = guests(a=Acquaintance(1, wide=False, silent=True), b=Acquaintance(2, wide=False, silent=True))
    known.note("a", HOME, Acquaintance(1, wide=False))
    assert known.find("x", HOME, None) == Acquaintance(2, wide=False, silent=True)
    known.note("b", HOME, None)
    known.note("never", HOME, None)
    assert known.find("y", HOME, None) == Acquaintance(1, wide=False)


def test_the_gone_are_forgotten_and_a_disconnect_counts_for_both_connections() -> None:
    known = guests(a=Acquaintance(1, wide=False, silent=True), b=Acquaintance(2, wide=False, silent=True))
    assert known.find("a again", HOME, None)
    assert known.find("b again", HOME, None)
    known.note("a again", HOME, Acquaintance(1, wide=False))
    known.leave("b again")
    assert len(known) == 3
    known.leave("a again", disconnected=True)
    assert known.find("stranger", HOME, None) == Acquaintance(2, wide=False, silent=True)
    known.leave("b", disconnected=True)
    assert len(known) == 0
    assert known.find("late", HOME, None) is None


def test_the_first_may_close_before_the_second_speaks() -> None:
    known = guests(a=Acquaintance(1, wide=False, silent=True))
    for guest in ("second", "silent for ever"):
        known.arrive(guest, HOME)
    known.arrive("far away", ELSEWHERE)
    known.leave("a")
    assert known.find("second", HOME, None) == Acquaintance(1, wide=False, silent=True)
    known.leave("silent for ever")
    assert len(known) == 0


def test_a_disconnect_is_not_waited_after() -> None:
    known = guests(a=Acquaintance(1, wide=False, silent=True))
    known.arrive("stranger", HOME)
    known.leave("a", disconnected=True)
    assert known.find("stranger", HOME, None) is None


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
    for width, told in ((False, narrow), (True, wide)):
        message = codec.tcp_request(call, wide=width)
        size = next(size for size in range(1, len(message) + 1) if session.enough(message[:size]))
        assert session.width(message[:size]) is told
        assert session.width(message) is told
        assert not session.connects(message)


@pytest.mark.parametrize("head", [b"GE", b"\x03\xe7", b"\x00\x66", b"\x00\x0c\x00\x02", b"\x00\x0f\x00\x00"])
def test_nobody_waits_for_what_need_not_come(head: bytes) -> None:
    assert session.enough(head)
    assert not session.enough(head[:1])
    assert session.connects(head) == (head == b"\x00\x66")
