"""How simulated time goes, as State[0] tells it."""

from __future__ import annotations

import pytest

from nserver_emu.server.context import Pace


@pytest.mark.parametrize(
    ("pace", "shown", "alone", "asked_s"),
    [
        (Pace(), 10, True, 0.0),
        (Pace(0.1), 1, True, 0.0),
        (Pace(100.0), 1000, True, 0.0),
        (Pace(None), 9999, True, 0.0),
        (Pace(2.0, paused=True), 0, False, 0.0),
        (Pace(2.0, lockstep_s=0.1), 0, False, 0.1),
        (Pace(2.0, paused=True, lockstep_s=0.1), 0, False, 0.0),
    ],
)
def test_the_factor_is_told_and_time_passes_as_it_says(pace: Pace, shown: int, alone: bool, asked_s: float) -> None:
    assert (pace.speed_tenths, pace.runs_alone, pace.asked_s) == (shown, alone, asked_s)
