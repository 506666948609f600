"""The token bucket, on a clock of the test's own."""

from __future__ import annotations

import pytest

from nserver_emu.server.connection import TokenBucket


def test_over_a_long_time_it_is_the_rate() -> None:
    now, answered, allowance = 5.0, 0, TokenBucket(100.0, 20, 5.0)
    while now < 25.0:
        allowance.consume(20, now)
        answered += 20
        now += max(allowance.wait_s(now), 1e-6)
    assert answered / 20.0 == pytest.approx(100.0, rel=0.03)


def test_what_is_saved_up_is_bounded() -> None:
    allowance = TokenBucket(1000.0, 20, 0.0)
    allowance.consume(100, 3600.0)
    assert allowance.wait_s(3600.0) == 0.0
    allowance.consume(20, 3600.0)
    assert allowance.wait_s(3600.0) == pytest.approx(0.02)
    assert allowance.wait_s(3600.01) == pytest.approx(0.01)
    assert allowance.wait_s(3601.0) == 0.0
