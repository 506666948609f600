"""Where the robots have been: the track of each actual robot, and of where its encoders believed it was.

Rules: a point is kept where the last one is POINT_IN away or more, as time passes; the oldest of
MOST_POINTS is forgotten for a new one. Inches. Who drives and who looks is not known here.
Robots that drive for days fill their tracks: a coordinate is kept in eight bytes, not as an object of Python's.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left
from collections.abc import Iterable
from math import floor, hypot
from typing import Final

from nserver_emu.simulation.simulation import Simulation

POINT_IN: Final = 0.5
"""Nearer points look like one."""

INTERVAL_S: Final = 0.025
"""Nobody goes farther than that in less time at 20 in/s: it is not looked more often."""

MOST_POINTS: Final = 4000
"""At least 2000 inches of way; some days of clients fill no memory."""

FORGOTTEN_AT_ONCE: Final = 400
"""Points; a track moves up in memory when it forgets its oldest."""

JUMP_IN: Final = 6.0
"""Points farther apart were not driven: half again what the fastest wheels make in a tenth of a second."""


class Trace:
    """A track as points; coordinates one after another, which a snapshot keeps in little room."""

    gone: int = 0
    """How many points there were so far, those forgotten as well: the number of the last one."""

    jumps: tuple[int, ...] = ()
    """The numbers of those that the robot did not drive to but was put down at, as long as they are kept."""

    def __init__(self) -> None:
        self._flat = array("d")

    @property
    def points(self) -> list[tuple[float, float]]:
        """(x, y) in inches, the oldest first."""
        flat = iter(self._flat[-2 * MOST_POINTS :])
        return list(zip(flat, flat, strict=True))

    @property
    def first(self) -> int:
        """The number of the oldest that is kept."""
        return self.gone - min(len(self._flat) // 2, MOST_POINTS) + 1

    def at(self, numbers: Iterable[int]) -> list[tuple[float, float]]:
        """(x, y) in inches of those with these numbers, which are kept; however many others there are."""
        flat, first = self._flat, self.gone - len(self._flat) // 2 + 1
        return [(flat[2 * (number - first)], flat[2 * (number - first) + 1]) for number in numbers]

    def go(self, x_in: float, y_in: float) -> None:
        """The robot is here."""
        way_in = hypot(x_in - self._flat[-2], y_in - self._flat[-1]) if self._flat else POINT_IN
        if way_in >= POINT_IN:
            self._flat.extend((x_in, y_in))
            self.gone += 1
            if len(self._flat) >= 2 * (MOST_POINTS + FORGOTTEN_AT_ONCE):
                del self._flat[: 2 * FORGOTTEN_AT_ONCE]
            if way_in > JUMP_IN:
                self.jumps = (*self.jumps[bisect_left(self.jumps, self.first) :], self.gone)


class Traces:
    """The two tracks of each robot by its number: `actual` and `encoder`."""

    def __init__(self) -> None:
        self.actual: dict[int, Trace] = {}
        self.encoder: dict[int, Trace] = {}
        self._noted = -1

    def note(self, simulation: Simulation) -> None:
        """This is where all are now; of several moments within INTERVAL_S the first counts."""
        interval = floor(simulation.time_s / INTERVAL_S)
        if interval == self._noted:
            return
        self._noted = interval
        for robot_id, robot in simulation.robots.items():
            x, y, _ = robot.disc
            believed = robot.encoder
            self.actual.setdefault(robot_id, Trace()).go(x, y)
            self.encoder.setdefault(robot_id, Trace()).go(believed.x_in, believed.y_in)
