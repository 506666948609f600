"""Bounds of the motion of a robot by direction, and a grid of the positions of all robots."""

from collections.abc import Iterator
from math import floor, hypot
from typing import Final, NamedTuple

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
