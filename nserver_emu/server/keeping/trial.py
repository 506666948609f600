"""A simulation out of a stranger's file lives for a moment, so that what is wrong with it shows now and not later.

Rules: it is let do a bounded amount of work, whatever its clocks say; numbers that overflow or are none are refused
where they arise. The simulation that is tried is a copy, and is used for nothing else. No file, no clock.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any, Final

import numpy as np

from nclient.errors import SnapshotError
from nserver_emu.server.stage.state_reply import state_slots
from nserver_emu.simulation.simulation import Simulation

TRIED_S: Final = 0.1
CALLS: Final = 50_000
"""Function calls that it may take, times the square of one more than there are robots: they hear one another. Ten
robots that hear as measured take 140,000."""
_CALLS: Final = ("call", "c_call")


def try_out(simulation: Simulation) -> None:
    """Let a simulation live for a moment.

    Raises SnapshotError where it does not come to its end, ValueError for clocks that cannot be, or whatever its
    numbers and missing parts lead to: ArithmeticError, TypeError, LookupError, AttributeError.
    """
    for robot in simulation.robots.values():
        robot.sonar.check()
    _bounded(lambda: _live(simulation), CALLS * (1 + len(simulation.robots)) ** 2)


def _live(simulation: Simulation) -> None:
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for robot in simulation.robots.values():
            state_slots(robot, 0)
        simulation.step(TRIED_S)
        for robot in simulation.robots.values():
            state_slots(robot, 0)


class Budget:
    """So many calls of functions, Python's own and C's. `count` is a profile function (sys.setprofile)."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def count(self, _frame: FrameType | None, event: str, _argument: Any) -> None:
        """Something happened; raises SnapshotError where that call is one too many."""
        self.left -= event in _CALLS
        if self.left < 0:
            raise SnapshotError("is damaged: its time has no end")


def _bounded(act: Callable[[], None], most_calls: int) -> None:
    """Do something that makes so many calls at most."""
    before = sys.getprofile()
    sys.setprofile(Budget(most_calls).count)
    try:
        act()
    finally:
        sys.setprofile(before)
