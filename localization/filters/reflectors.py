"""The map as sound meets it: faces of walls that send it straight back, and vertices that scatter it to all sides.

Rules: pure geometry of the map, worked out once; no robot, no sonar. A face is a whole wall with its normal; a vertex
is an end of a wall or a place where walls meet at an angle. A square corner sends back all that comes in (its two walls
are a mirror to any direction), other vertices a little.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats, wrap_angle

Mask = npt.NDArray[np.bool_]

STRAIGHT_RAD: Final = 1e-3
"""Two walls that meet within this of a straight line are one wall."""
SQUARE_RAD: Final = 0.02
"""Two walls that meet within this of a right angle send sound back by way of both."""


@dataclass(frozen=True, slots=True)
class Reflectors:
    """m walls and v vertices, inches.

    walls (m, 4)       rows x1 y1 x2 y2                  corners (m, 2)     the first ends
    along (m, 2)       unit vectors from the first end   lengths (m,)
    normals (m, 2)     to the left of them
    vertices (v, 2)    and which of them are `square` (v,)
    """

    walls: Floats
    corners: Floats
    along: Floats
    normals: Floats
    lengths: Floats
    vertices: Floats
    square: Mask

    @property
    def count(self) -> int:
        """Walls and vertices together: in all arrays the walls come first."""
        return len(self.walls) + len(self.vertices)

    def some(self, walls: Mask, vertices: Mask) -> Reflectors:
        """Those alone that are chosen (m,), (v,)."""
        return Reflectors(
            self.walls[walls],
            self.corners[walls],
            self.along[walls],
            self.normals[walls],
            self.lengths[walls],
            self.vertices[vertices],
            self.square[vertices],
        )


def reflectors(segments: npt.ArrayLike) -> Reflectors:
    """What sound meets in a map of wall segments (m, 4), rows x1 y1 x2 y2; none may have length 0 (measurement.wall_map
    says which)."""
    walls = np.array(segments, dtype=np.float64).reshape(-1, 4)
    way = walls[:, 2:] - walls[:, :2]
    lengths = np.hypot(way[:, 0], way[:, 1])
    along = way / lengths[:, None]
    ends: dict[tuple[float, float], list[float]] = {}
    for (x1, y1, x2, y2), (ux, uy) in zip(walls.tolist(), along.tolist(), strict=True):
        ends.setdefault((x1, y1), []).append(float(np.arctan2(uy, ux)))
        ends.setdefault((x2, y2), []).append(float(np.arctan2(-uy, -ux)))
    there = {point: _angle_between(out) for point, out in ends.items()}
    kept = [point for point, angle in there.items() if abs(angle - np.pi) >= STRAIGHT_RAD]
    square = [abs(there[point] - np.pi / 2.0) <= SQUARE_RAD for point in kept]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    vertices = np.array(kept, dtype=np.float64).reshape(-1, 2)
    return Reflectors(walls, walls[:, :2], along, normals, lengths, vertices, np.array(square, dtype=np.bool_))


def _angle_between(directions_rad: list[float]) -> float:
    """The angle from 0 to pi between the two walls that meet in a point; 0 where it is not just two."""
    if len(directions_rad) != 2:
        return 0.0
    return abs(float(wrap_angle(np.array(directions_rad[0] - directions_rad[1]))))
