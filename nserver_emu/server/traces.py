"""Where the robots have been: the track of each actual robot, and of where its encoders believed it was.

Rules: a point is kept where the last one is POINT_IN away or more, as time passes; the oldest of
MOST_POINTS is forgotten for a new one. Inches. Who drives and who looks is not known here.
Robots that drive for days fill their tracks: a coordinate is kept in eight bytes, not as an object of Python's.
"""

from __future__ import annotations

from array import array
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


class Trace:
    """A track as points; coordinates one after another, which a snapshot keeps in little room."""

    gone: int = 0
    """How many points there were so far, those forgotten as well."""

    def __init__(self) -> None:
        self._flat = array("d")

    @property
    def points(self) -> list[tuple[float, float]]:
        """(x, y) in inches, the oldest first."""
        flat = iter(self._flat[-2 * MOST_POINTS :])
        return list(zip(flat, flat, strict=True))

    def go(self, x_in: float, y_in: float) -> None:
        """The robot is here."""
        if not self._flat or hypot(x_in - self._flat[-2], y_in - self._flat[-1]) >= POINT_IN:
            self._flat.extend((x_in, y_in))
            self.gone += 1
            if len(self._flat) >= 2 * (MOST_POINTS + FORGOTTEN_AT_ONCE):
                del self._flat[: 2 * FORGOTTEN_AT_ONCE]

    def newer(self, gone: int) -> list[float]:
        """The coordinates of the points after the first `gone`, as far as they are kept: x, y, x, y ... in inches."""
        count = min(max(self.gone - gone, 0), MOST_POINTS)
        return self._flat[max(len(self._flat) - 2 * count, 0) :].tolist()


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
