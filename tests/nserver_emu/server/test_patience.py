"""How long a connection is put up with, on a clock of the test's own."""

from __future__ import annotations

import pytest

from nserver_emu.server.admission import Patience


def test_the_idle_end_and_who_is_heard_does_not() -> None:
    patience = Patience(10.0, 0.0, 100.0)
    assert not patience.overdue(109.9, 3, stuck=False)
    assert "said nothing for 10 s" in patience.overdue(110.0, 3, stuck=False)
    patience.heard(110.0)
    assert not patience.overdue(119.0, 3, stuck=False)


def test_the_stuck_end_though_they_are_heard() -> None:
    patience = Patience(0.0, 4.0, 0.0)
    for now in range(4):
        patience.heard(now)
        assert not patience.overdue(now + 1.0, 7, stuck=True)
    assert "for 4 s" in patience.overdue(5.0, 7, stuck=True)


def test_who_gets_on_is_not_stuck() -> None:
    patience = Patience(0.0, 4.0, 0.0)
    assert not any(patience.overdue(float(now), now, stuck=True) for now in range(50))
    assert not patience.overdue(60.0, 49, stuck=False)
    assert not patience.overdue(61.0, 49, stuck=True)


@pytest.mark.parametrize(("idle", "stall", "look"), [(0, 0, None), (8, 0, 2.0), (8, 4, 1.0)])
def test_it_is_looked_at_within_the_shortest(idle: float, stall: float, look: float | None) -> None:
    assert Patience(idle, stall, 0.0).look_s == look
    assert idle or stall or not Patience(idle, stall, 0.0).overdue(1e9, 0, stuck=True)
