"""As many laps as it takes."""

from __future__ import annotations

import numpy as np

from localization.calibration.procedure import Driver, Go, Rounds, Spin, Task
from localization.navigation.waypoints import Command

LAP: list[Task] = [Spin(0.01), Go(0.0, 0.0)]


def test_a_round_more_until_it_is_enough_or_there_were_too_many() -> None:
    said = iter([False, False, True])
    rounds = Rounds(LAP, 9, lambda: next(said))
    assert [rounds.more(), rounds.more(), rounds.more()] == [LAP, LAP, ()]
    assert rounds.begun == 3
    assert Rounds(LAP, 1, lambda: False).more() == ()


def test_a_driver_asks_for_more_when_all_is_done() -> None:
    rounds = Rounds([Go(0.0, 5.0)], 3, lambda: False)
    driver = Driver([Go(0.0, 0.0)], 1.0, 1.0, rounds.more)
    here = np.zeros(3)
    assert driver.command(here) == Command(0.0, 1.0)
    assert (driver.done, driver.count, rounds.begun) == (1, 2, 2)
    assert driver.command(np.array([0.0, 5.0, 1.57])) is None
    assert (driver.done, driver.count, rounds.begun) == (3, 3, 3)
