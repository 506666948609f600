"""Readings replaced on purpose: the given fraction, each echo the same for as long as it is shown."""

from __future__ import annotations

import numpy as np
import pytest

from localization.experiments.live_trial import BadReadings
from localization.live.sensor_input import FiringSchedule, SensorData

ROUND_S = FiringSchedule(0.0).round_s


def report(clock_s: float | None) -> SensorData:
    return SensorData(clock_s, 1.0, 2.0, 0.3, 0.4, (300,) * 16)


def made_bad(share: float) -> BadReadings:
    return BadReadings(share, FiringSchedule(0.0), np.random.default_rng(4))


def test_given_fraction_of_echoes_is_replaced() -> None:
    bad = made_bad(0.2)
    shown = np.array([bad.apply(report(ROUND_S * (k + 0.999))).sonars_in for k in range(400)])
    replaced = shown[shown != 300]
    assert len(replaced) / shown.size == pytest.approx(0.2, abs=0.015)
    assert replaced.min() == 6
    assert replaced.max() == 255
    # Uniform from 6 to 255 in: the mean is 130.5.
    assert replaced.mean() == pytest.approx(130.5, abs=6.0)


def test_bad_echo_stays_until_its_sonar_fires_again() -> None:
    bad, schedule = made_bad(0.5), FiringSchedule(0.0)
    before = bad.apply(report(ROUND_S + 0.001)).sonars_in
    for k in range(1, 16):
        now = bad.apply(report(ROUND_S + 0.001 + k * schedule.interval_s)).sonars_in
        # Only sonars that have fired since may have another reading.
        fired = set(schedule.order[: k + 1])
        assert all(now[sonar] == before[sonar] for sonar in range(16) if sonar not in fired)
    assert now != before


@pytest.mark.parametrize(("share", "clock_s"), [(0.0, 3.0), (0.5, None)])
def test_state_is_unchanged_without_bad_readings(share: float, clock_s: float | None) -> None:
    output = report(clock_s)
    assert made_bad(share).apply(output) is output
