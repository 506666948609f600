"""Where robots stand, in squares of the ground: who is in the way of one more, without asking all of them."""

from __future__ import annotations

from collections.abc import Iterator
from math import floor, hypot
from typing import Final

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
