"""Which wall a ray meets first, for who asks the same walls again and again: prepared once, few calls a question.

    rows(...)     of some rays at once: in arrays of complex numbers, where a corner in a ray's frame is one product
    first(...)    of a single one, with its range: in numbers

Rules: the answers are raycast's, to the wall and, of single rays, to the bit; where a corner lies on a ray's line it is
asked itself. What a ray meets nothing of has the row after the last.
"""

from __future__ import annotations

from math import inf
from typing import Final

import numpy as np
import numpy.typing as npt

from worlds.geometry import FloatArray
from worlds.ray import WORTH_A_LOOK, meeting_before
from worlds.raycast import NO_WALL, cast_ray, cast_rays

Complexes = npt.NDArray[np.complex128]
Rows = npt.NDArray[np.intp]

FEW: Final = 40
"""So many walls are looked through sooner in numbers, one by one."""
_NOWHERE: Final = 1e-300
"""What stands for no wall: farther than any, nearer than one that is missed (0) or behind (less)."""
_NEVER_ZERO: Final = 1e-200
"""Added to what is divided by: changes none but 0."""


class FirstWall:
    """Walls (m, 4), rows x1 y1 x2 y2 in inches, that stay."""

    def __init__(self, walls: npt.ArrayLike) -> None:
        self._walls = np.ascontiguousarray(walls, dtype=np.float64).reshape(-1, 4)
        self._corners: Complexes = np.ascontiguousarray(self._walls.view(np.complex128).T)
        self._listed = [tuple(wall) for wall in self._walls.tolist()]
        self.nothing = len(self._walls)
        """The row of no wall."""

    def rows(self, origins: Complexes, ways: Complexes) -> Rows:
        """The first wall (...) that each ray meets: origins (...) as x + iy, off all walls, unit vectors (...) as
        dx + i dy.

        The nearest is where 1 / range, (side_2 - side_1) / (ahead_1 side_2 - side_1 ahead_2), is largest.
        """
        seen = (self._corners - origins[..., None, None]) * ways.conj()[..., None, None]
        one, other = seen[..., 0, :], seen[..., 1, :]
        side, other_side = one.imag, other.imag
        product = side * other_side
        if not self.nothing or np.abs(product).min() <= WORTH_A_LOOK:
            return self._asked(origins, ways)
        nearness = np.empty((*product.shape[:-1], self.nothing + 1))
        nearness[..., -1] = _NOWHERE
        met = nearness[..., :-1]
        np.divide(other_side - side, (one.conj() * other).imag + _NEVER_ZERO, out=met)
        met *= product < 0.0
        nearest: Rows = nearness.argmax(axis=-1)
        return nearest

    def _asked(self, origins: Complexes, ways: Complexes) -> Rows:
        """The same by the ray caster."""
        starts, along = np.broadcast_arrays(origins, ways)
        rows = cast_rays(_pairs(starts), _pairs(along), self._walls)[1]
        return np.where(rows == NO_WALL, self.nothing, rows)

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


def _pairs(numbers: Complexes) -> FloatArray:
    return np.stack((numbers.real, numbers.imag), axis=-1)
