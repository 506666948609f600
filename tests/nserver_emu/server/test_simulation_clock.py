"""The simulation clock and State[0]."""

from __future__ import annotations

import pytest

from nserver_emu.server.server_state import SimulationClock


@pytest.mark.parametrize(
    ("pace", "shown", "alone", "asked_s"),
    [
        (SimulationClock(), 10, True, 0.0),
        (SimulationClock(0.1), 1, True, 0.0),
        (SimulationClock(100.0), 1000, True, 0.0),
        (SimulationClock(None), 9999, True, 0.0),
        (SimulationClock(2.0, paused=True), 0, False, 0.0),
        (SimulationClock(2.0, lockstep_s=0.1), 0, False, 0.1),
        (SimulationClock(2.0, paused=True, lockstep_s=0.1), 0, False, 0.0),
    ],
)
def test_speed_and_step_follow_the_clock_mode(
    pace: SimulationClock, shown: int, alone: bool, asked_s: float
) -> None:
    assert (pace.speed_tenths, pace.is_free_running, pace.step_per_request_s) == (shown, alone, asked_s)
