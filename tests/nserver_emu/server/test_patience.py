"""How long a connection is put up with, on a clock of the test's own."""

from __future__ import annotations

import pytest

from nserver_emu.server.admission import ConnectionTimeouts


def test_the_idle_end_and_who_is_heard_does_not() -> None:
    patience = ConnectionTimeouts(10.0, 0.0, 100.0)
    assert not patience.timeout_reason(109.9, 3, stuck=False)
    assert "said nothing for 10 s" in patience.timeout_reason(110.0, 3, stuck=False)
    patience.heard(110.0)
    assert not patience.timeout_reason(119.0, 3, stuck=False)


def test_the_stuck_end_though_they_are_heard() -> None:
    patience = ConnectionTimeouts(0.0, 4.0, 0.0)
    for now in range(4):
        patience.heard(now)
        assert not patience.timeout_reason(now + 1.0, 7, stuck=True)
    assert "for 4 s" in patience.timeout_reason(5.0, 7, stuck=True)


def test_who_gets_on_is_not_stuck() -> None:
    patience = ConnectionTimeouts(0.0, 4.0, 0.0)
    assert not any(patience.timeout_reason(float(now), now, stuck=True) for now in range(50))
    assert not patience.timeout_reason(60.0, 49, stuck=False)
    assert not patience.timeout_reason(61.0, 49, stuck=True)


@pytest.mark.parametrize(("idle", "stall", "look"), [(0, 0, None), (8, 0, 2.0), (8, 4, 1.0)])
def test_it_is_looked_at_within_the_shortest(idle: float, stall: float, look: float | None) -> None:
    assert ConnectionTimeouts(idle, stall, 0.0).check_interval_s == look
    assert idle or stall or not ConnectionTimeouts(idle, stall, 0.0).timeout_reason(1e9, 0, stuck=True)
