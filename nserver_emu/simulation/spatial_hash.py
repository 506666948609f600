"""How far a robot may come within a span of time, and which way: by what it was told, before anything is driven. Pure.

A path of length s whose heading turns by no more than an angle a keeps within s a of the straight way, wherever on it
the robot is stopped. So towards something in the direction n it comes no nearer than by the straight way's share along
n, if that is positive, and what it may stray.

Where robots stand, in squares of the ground: who is in the way of one more, without asking all of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, floor, hypot, sin
from typing import Final, NamedTuple

from nserver_emu.simulation.drive import Drive
from nserver_emu.simulation.noise import RobotSetup

STRAY: Final = 6.0
"""Standard deviations of the noise of a way that are allowed for: one in a thousand million goes beyond."""


class Reach(NamedTuple):
    """The straight ways to the farthest places ahead and behind, (dx, dy), and what may be added to them, inches."""

    ahead_x: float
    ahead_y: float
    behind_x: float
    behind_y: float
    stray_in: float

    def towards(self, x: float, y: float) -> float:
        """No less than it comes nearer to what lies far away in a direction, a unit vector."""
        ahead, behind = self.ahead_x * x + self.ahead_y * y, self.behind_x * x + self.behind_y * y
        return max(ahead, behind, 0.0) + self.stray_in


STAYS: Final = Reach(0.0, 0.0, 0.0, 0.0, 0.0)
"""It goes nowhere."""


def way_in(drive: Drive, setup: RobotSetup | None, span_s: float) -> float:
    """No less than it goes within some seconds if no command comes, inches; 0 only where it stays.

    setup    how its motion errs; None: every motion is as commanded
    """
    if setup is None:
        return drive.fastest * span_s
    span_s *= max(map(abs, setup.odometry.scales[:2]))
    told_in = drive.fastest * span_s
    return told_in + STRAY * setup.motion.way_std_in(told_in, drive.fastest_turn * span_s)


def reach(drive: Drive, setup: RobotSetup | None, heading_rad: float, span_s: float) -> Reach:
    """The same by directions, for a robot that heads this way."""
    farthest_in = way_in(drive, setup, span_s)
    if not farthest_in:
        return STAYS
    least, most = drive.extremes
    aside_rad, stray_in = drive.fastest_turn * span_s, 0.0
    if setup is not None:
        odometry, noise = setup.odometry, setup.motion
        span_s *= max(map(abs, odometry.scales[:2]))
        told_in, angle_rad = drive.fastest * span_s, drive.fastest_turn * span_s
        drift_rad = max(map(abs, odometry.drifts)) * (drive.axes[0].fastest + drive.axes[1].fastest) * span_s
        aside_rad = angle_rad + drift_rad + STRAY * noise.turn_std_rad(told_in, angle_rad)
        stray_in = farthest_in - told_in
    x, y = span_s * cos(heading_rad), span_s * sin(heading_rad)
    stray_in += max(most, -least) * span_s * aside_rad
    return Reach(most * x, most * y, least * x, least * y, stray_in)


Disc = tuple[float, float, float]
"""x, y, radius in inches."""

SQUARE_IN: Final = 40.0
"""Two robots wide: a search looks at four squares, or nine."""


class Standing:
    """Discs by the robots' numbers; none is ever taken out."""

    def __init__(self) -> None:
        self._squares: dict[tuple[int, int], list[tuple[int, Disc]]] = {}
        self._largest_in = 0.0

    def add(self, number: int, disc: Disc) -> None:
        """Here stands one more."""
        x, y, radius = disc
        self._squares.setdefault((floor(x / SQUARE_IN), floor(y / SQUARE_IN)), []).append((number, disc))
        self._largest_in = max(self._largest_in, radius)

    def touched(self, x_in: float, y_in: float, radius_in: float) -> list[tuple[int, Disc]]:
        """Those whom a robot of this radius would touch there, by their numbers."""
        return sorted(
            (number, (x, y, radius))
            for number, (x, y, radius) in self._around(x_in, y_in, radius_in + self._largest_in)
            if hypot(x_in - x, y_in - y) - radius_in - radius <= 0.0
        )

    def _around(self, x_in: float, y_in: float, reach_in: float) -> Iterator[tuple[int, Disc]]:
        for column in range(floor((x_in - reach_in) / SQUARE_IN), floor((x_in + reach_in) / SQUARE_IN) + 1):
            for row in range(floor((y_in - reach_in) / SQUARE_IN), floor((y_in + reach_in) / SQUARE_IN) + 1):
                yield from self._squares.get((column, row), ())
