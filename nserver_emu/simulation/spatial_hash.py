"""Bounds of the motion of robots, and a grid of their positions.

A path of length s whose heading turns by at most an angle a stays within s a of the straight path, wherever on it the
robot is stopped. Towards something in the direction n it therefore comes no nearer than by the straight path's
component along n, if that is positive, and the deviation.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, floor, hypot, sin
from typing import Final, NamedTuple

from nserver_emu.simulation.drive import Drive
from nserver_emu.simulation.noise import RobotSetup

NOISE_SIGMAS: Final = 6.0
"""Standard deviations of motion noise that are allowed for: one in 1e9 draws goes beyond."""

CELL_IN: Final = 40.0
"""Two robots wide: a search examines four cells, or nine."""


class SweptBounds(NamedTuple):
    """Bounds of a robot's displacement: the straight paths ahead and behind, (dx, dy), and the deviation, inches."""

    ahead_x: float
    ahead_y: float
    behind_x: float
    behind_y: float
    deviation_in: float

    def towards(self, x: float, y: float) -> float:
        """Return an upper bound of the approach to a far point in the direction (x, y), a unit vector; inches."""
        ahead, behind = self.ahead_x * x + self.ahead_y * y, self.behind_x * x + self.behind_y * y
        return max(ahead, behind, 0.0) + self.deviation_in


STATIONARY: Final = SweptBounds(0.0, 0.0, 0.0, 0.0, 0.0)
"""The bounds of a robot that does not move."""


def max_travel_in(drive: Drive, setup: RobotSetup | None, span_s: float) -> float:
    """Return an upper bound of the distance travelled within a time if no command comes, inches; 0 only at rest.

    Parameters
    ----------
    setup
        Its errors of motion; None: every motion is as commanded.
    """
    if setup is None:
        return drive.max_speed * span_s
    span_s *= max(map(abs, setup.odometry.scales[:2]))
    commanded_in = drive.max_speed * span_s
    return commanded_in + NOISE_SIGMAS * setup.motion.distance_std_in(commanded_in, drive.max_turn_rate * span_s)


def swept_bounds(drive: Drive, setup: RobotSetup | None, heading_rad: float, span_s: float) -> SweptBounds:
    """Return the bounds by direction for a robot with this heading; arguments as for `max_travel_in`."""
    farthest_in = max_travel_in(drive, setup, span_s)
    if not farthest_in:
        return STATIONARY
    backward, forward = drive.velocity_bounds
    # 1. Largest turn of the heading, and what noise adds to the distance.
    turn_rad, deviation_in = drive.max_turn_rate * span_s, 0.0
    if setup is not None:
        odometry, noise = setup.odometry, setup.motion
        span_s *= max(map(abs, odometry.scales[:2]))
        commanded_in, angle_rad = drive.max_speed * span_s, drive.max_turn_rate * span_s
        drift_rad = max(map(abs, odometry.drifts)) * (drive.axes[0].max_speed + drive.axes[1].max_speed) * span_s
        turn_rad = angle_rad + drift_rad + NOISE_SIGMAS * noise.turn_std_rad(commanded_in, angle_rad)
        deviation_in = farthest_in - commanded_in
    # 2. The straight paths, and the deviation that the turn causes.
    x, y = span_s * cos(heading_rad), span_s * sin(heading_rad)
    deviation_in += max(forward, -backward) * span_s * turn_rad
    return SweptBounds(forward * x, forward * y, backward * x, backward * y, deviation_in)


Disc = tuple[float, float, float]
"""x, y, radius in inches."""


class SpatialHash:
    """Robots as discs in a grid of cells, by their numbers; none is ever removed."""

    def __init__(self) -> None:
        self._cells: dict[tuple[int, int], list[tuple[int, Disc]]] = {}
        self._max_radius_in = 0.0

    def add(self, number: int, disc: Disc) -> None:
        """Add a robot."""
        # A disc is stored in the cell of its centre; searches add the largest radius.
        x, y, radius = disc
        self._cells.setdefault((floor(x / CELL_IN), floor(y / CELL_IN)), []).append((number, disc))
        self._max_radius_in = max(self._max_radius_in, radius)

    def touched(self, x_in: float, y_in: float, radius_in: float) -> list[tuple[int, Disc]]:
        """Return the robots that a robot of this radius would touch there, sorted by their numbers."""
        return sorted(
            (number, (x, y, radius))
            for number, (x, y, radius) in self._around(x_in, y_in, radius_in + self._max_radius_in)
            if hypot(x_in - x, y_in - y) - radius_in - radius <= 0.0
        )

    def _around(self, x_in: float, y_in: float, reach_in: float) -> Iterator[tuple[int, Disc]]:
        for column in range(floor((x_in - reach_in) / CELL_IN), floor((x_in + reach_in) / CELL_IN) + 1):
            for row in range(floor((y_in - reach_in) / CELL_IN), floor((y_in + reach_in) / CELL_IN) + 1):
                yield from self._cells.get((column, row), ())
