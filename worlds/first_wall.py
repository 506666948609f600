"""Which wall a ray meets first, for who asks the same walls again and again: prepared once.

Rules: the answers are raycast's, to the bit. What a ray meets nothing of has the row after the last.
"""

from __future__ import annotations

from math import inf
from typing import Final

import numpy as np
import numpy.typing as npt

from worlds.ray import WORTH_A_LOOK, meeting_before
from worlds.raycast import NO_WALL, cast_ray

FEW: Final = 40
"""So many walls are looked through sooner in numbers, one by one."""


class FirstWall:
    """Walls (m, 4), rows x1 y1 x2 y2 in inches, that stay."""

    def __init__(self, walls: npt.ArrayLike) -> None:
        self._walls = np.ascontiguousarray(walls, dtype=np.float64).reshape(-1, 4)
        self._listed = [tuple(wall) for wall in self._walls.tolist()]
        self.nothing = len(self._walls)
        """The row of no wall."""

    def first(self, x: float, y: float, dx: float, dy: float) -> tuple[float, int]:
        """The range from (x, y) along the unit vector (dx, dy) to the first wall, and its row; inf and the row after
        the last where there is none."""
        if self.nothing > FEW:
            nearest, row = cast_ray(x, y, dx, dy, self._walls)
            return nearest, self.nothing if row == NO_WALL else row
        nearest, hit = inf, self.nothing
        for row, (x1, y1, x2, y2) in enumerate(self._listed):
            if (dx * (y1 - y) - dy * (x1 - x)) * (dx * (y2 - y) - dy * (x2 - x)) <= WORTH_A_LOOK:
                met = meeting_before(nearest, x, y, dx, dy, x1, y1, x2, y2)
                if met < nearest:
                    nearest, hit = met, row
        return max(nearest, 0.0), hit
