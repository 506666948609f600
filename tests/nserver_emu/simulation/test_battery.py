"""Batteries drain."""

from __future__ import annotations

import pytest

from nserver_emu.simulation.robot import battery_v


@pytest.mark.parametrize(("hours", "volts"), [(0.0, 12.0), (3.0, 11.4), (6.0, 10.8), (9.0, 10.8)])
def test_twelve_volts_last_six_hours(hours: float, volts: float) -> None:
    assert battery_v(hours * 3600.0) == pytest.approx(volts)
