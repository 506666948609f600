"""Idle and stall timeouts of a connection, on the test's clock."""

from __future__ import annotations

import pytest

from nserver_emu.server.admission import ConnectionTimeouts


def test_an_idle_connection_times_out() -> None:
    timeouts = ConnectionTimeouts(10.0, 0.0, 100.0)
    assert not timeouts.timeout_reason(109.9, 3, is_stalled=False)
    assert "idle for 10 s" in timeouts.timeout_reason(110.0, 3, is_stalled=False)
    timeouts.active_s = 110.0
    assert not timeouts.timeout_reason(119.0, 3, is_stalled=False)


def test_a_stalled_connection_times_out_despite_bytes() -> None:
    timeouts = ConnectionTimeouts(0.0, 4.0, 0.0)
    for now in range(4):
        timeouts.active_s = now
        assert not timeouts.timeout_reason(now + 1.0, 7, is_stalled=True)
    assert "for 4 s" in timeouts.timeout_reason(5.0, 7, is_stalled=True)


def test_progress_resets_the_stall_timeout() -> None:
    timeouts = ConnectionTimeouts(0.0, 4.0, 0.0)
    assert not any(timeouts.timeout_reason(float(now), now, is_stalled=True) for now in range(50))
    assert not timeouts.timeout_reason(60.0, 49, is_stalled=False)
    assert not timeouts.timeout_reason(61.0, 49, is_stalled=True)


@pytest.mark.parametrize(("idle", "stall", "look"), [(0, 0, None), (8, 0, 2.0), (8, 4, 1.0)])
def test_it_is_looked_at_within_the_shortest(idle: float, stall: float, look: float | None) -> None:
    assert ConnectionTimeouts(idle, stall, 0.0).check_interval_s == look
    assert idle or stall or not ConnectionTimeouts(idle, stall, 0.0).timeout_reason(1e9, 0, is_stalled=True)
