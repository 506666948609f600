"""How near straight ways come to walls. Rules: pure arrays of plane geometry; inches; no robot, no path.

    ways (n, 4), walls (m, 4)    rows x1 y1 x2 y2
"""

from __future__ import annotations

import numpy as np

from localization.filters.belief import Floats
from worlds.geometry import nearest_points


def clearances(ways: Floats, walls: Floats) -> Floats:
    """The least distance (n,) of each way to any wall; 0 where they cross, inf where there are no walls.

    Two segments that do not cross are nearest at an end of one of them.
    """
    if not len(walls) or not len(ways):
        return np.full(len(ways), np.inf)
    nearest = np.full(len(ways), np.inf)
    for end in (slice(0, 2), slice(2, 4)):
        _, of_way = nearest_points(ways[:, end], walls)
        _, of_wall = nearest_points(walls[:, end], ways)
        nearest = np.minimum(nearest, np.minimum(of_way.min(axis=1), of_wall.min(axis=0)))
    nearest[_crossing(ways, walls).any(axis=1)] = 0.0
    return nearest


def _crossing(ways: Floats, walls: Floats) -> np.typing.NDArray[np.bool_]:
    """Which way crosses which wall, (n, m)."""
    one, other = ways[:, None, :], walls[None, :, :]
    sides = _side(one, other[..., :2]) * _side(one, other[..., 2:])
    other_sides = _side(other, one[..., :2]) * _side(other, one[..., 2:])
    crossing: np.typing.NDArray[np.bool_] = (sides < 0.0) & (other_sides < 0.0)
    return crossing


def _side(segments: Floats, points: Floats) -> Floats:
    along = segments[..., 2:] - segments[..., :2]
    off = points - segments[..., :2]
    side: Floats = along[..., 0] * off[..., 1] - along[..., 1] * off[..., 0]
    return side
