"""The number of laps of a calibration run."""

from __future__ import annotations

import numpy as np

from localization.cli.calibrate import Driver, DriveTo, LapPolicy, Spin, Task
from localization.navigation.control_law import VelocityCommand

LAP: list[Task] = [Spin(0.01), DriveTo(0.0, 0.0)]


def test_laps_are_repeated_until_precise_or_maximum() -> None:
    text = iter([False, False, True])
    rounds = LapPolicy(LAP, 9, lambda: next(text))
    assert [rounds.more(), rounds.more(), rounds.more()] == [LAP, LAP, ()]
    assert rounds.begun == 3
    assert LapPolicy(LAP, 1, lambda: False).more() == ()


def test_a_driver_asks_for_more_when_all_is_done() -> None:
    rounds = LapPolicy([DriveTo(0.0, 5.0)], 3, lambda: False)
    driver = Driver([DriveTo(0.0, 0.0)], 1.0, 1.0, rounds.more)
    here = np.zeros(3)
    assert driver.command(here) == VelocityCommand(0.0, 1.0)
    assert (driver.passed, driver.count, rounds.begun) == (1, 2, 2)
    assert driver.command(np.array([0.0, 5.0, 1.57])) is None
    assert (driver.passed, driver.count, rounds.begun) == (3, 3, 3)
