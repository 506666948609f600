"""New echoes, against a ring simulated firing by firing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from localization.live.sensor_input import CLOCK_STEP_S, FiringSchedule, FiringTime
from nclient.protocol.types import DEFAULT_SONAR_ORDER


def written_out(schedule: FiringSchedule, until_s: float) -> list[FiringTime]:
    """Every firing of the ring up to an instant, one after another."""
    # The oracle: firing by firing, without the arithmetic of the schedule.
    count = int((until_s - schedule.start_s) / schedule.interval_s) + 2
    order = [sonar for (sonar,) in schedule.firing]
    instants = [schedule.start_s + k * schedule.interval_s for k in range(count)]
    firings = (FiringTime(order[k % len(order)], instant) for k, instant in enumerate(instants))
    return [firing for firing in firings if firing.instant_s <= until_s + 1e-9]


def test_the_default_ring_fires_every_60_ms() -> None:
    schedule = FiringSchedule(0.0)
    assert schedule.interval_s == pytest.approx(0.060)
    assert schedule.round_s == pytest.approx(0.960)
    assert [f.sonar for f in schedule.readable(-1.0, 0.2)] == [0, 2, 15, 1]


def test_an_echo_is_readable_once_a_clock_step_later() -> None:
    schedule = FiringSchedule(10.0)
    assert schedule.readable(9.0, 10.0) == []
    assert [f.sonar for f in schedule.readable(9.0, 10.0 + CLOCK_STEP_S)] == [0]
    assert schedule.readable(10.0, 10.0 + CLOCK_STEP_S) == []


def test_by_a_late_clock_no_echo_is_read_before_it_is_there() -> None:
    rng, schedule, last_s, late_s = np.random.default_rng(8), FiringSchedule(0.0), -1.0, 0.1
    seen: list[float] = []
    for number in range(100):
        true_s = 0.1 * number + CLOCK_STEP_S
        # The clock is late by up to 0.1 s, as over a slow link.
        found = schedule.readable(last_s, true_s + late_s * float(rng.random()), late_s)
        seen += [firing.instant_s for firing in found]
        last_s = seen[-1] if seen else last_s
        # What has fired by the true clock, each once and in order.
        assert all(instant_s <= true_s for instant_s in seen)
    assert np.diff(seen) == pytest.approx(schedule.interval_s)


def test_an_echo_that_was_overwritten_is_not_handed_out() -> None:
    schedule = FiringSchedule(0.0)
    late = schedule.readable(-1.0, 5.0)
    assert len(late) <= len(DEFAULT_SONAR_ORDER)
    assert len({f.sonar for f in late}) == len(late)
    assert all(f.instant_s > 5.0 + CLOCK_STEP_S - schedule.round_s for f in late)


@given(
    start_s=st.floats(0, 100),
    rate=st.integers(1, 50),
    order=st.permutations(range(16)).flatmap(lambda p: st.integers(1, 16).map(lambda n: tuple(p[:n]))),
    gaps_s=st.lists(st.floats(0.001, 0.5), min_size=1, max_size=40),
)
@settings(max_examples=80)
def test_polled_anyhow_each_readable_echo_comes_once(
    start_s: float, rate: int, order: tuple[int, ...], gaps_s: list[float]
) -> None:
    schedule = FiringSchedule.of_command(start_s, rate, order)
    echo: list[FiringTime] = []
    last_s, now_s = start_s - 1.0, start_s
    # Polled at random gaps, by a clock with steps of 16.4 ms.
    for gap_s in gaps_s:
        now_s += gap_s
        fresh = schedule.readable(last_s, now_s)
        assert fresh == sorted(fresh, key=lambda firing: firing.instant_s)
        for firing in fresh:
            # A readable firing is the newest of its sonar.
            newest = [f for f in written_out(schedule, now_s) if f.sonar == firing.sonar][-1]
            assert newest.instant_s == pytest.approx(firing.instant_s)
            assert newest.sonar == firing.sonar
        echo += fresh
        last_s = fresh[-1].instant_s if fresh else last_s
    # No firing comes twice.
    assert len({round(f.instant_s, 6) for f in echo}) == len(echo)
    # If gaps are shorter than a round, none is missed.
    if schedule.round_s > max(gaps_s) + 2 * CLOCK_STEP_S + schedule.interval_s:
        due = [f for f in written_out(schedule, now_s) if f.instant_s < now_s - CLOCK_STEP_S - 1e-6]
        assert [f.sonar for f in echo[: len(due)]] == [f.sonar for f in due]
