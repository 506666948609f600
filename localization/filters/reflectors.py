"""The map as sound meets it: walls, which reflect at a right angle, and vertices, which scatter to all sides.

A vertex is an end of a wall, or a point where walls meet at an angle. A square corner returns all that it receives (its
two walls are a mirror for any direction), other vertices little. All of it is geometry of the map, computed once.
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
"""Two walls that meet within this of a right angle return sound by both of them."""


@dataclass(frozen=True, slots=True)
class Reflectors:
    """m walls and v vertices, inches; in arrays of both, the walls come first.

    Attributes
    ----------
    walls
        (m, 4), rows x1 y1 x2 y2.
    corners
        (m, 2), the first ends.
    along, lengths
        (m, 2) unit vectors from the first ends, and (m,).
    normals
        (m, 2), to the left of them.
    vertices, square, free
        (v, 2), and (v,) True for square corners and for free ends, where one wall ends and no other begins.
    """

    walls: Floats
    corners: Floats
    along: Floats
    normals: Floats
    lengths: Floats
    vertices: Floats
    square: Mask
    free: Mask

    @property
    def count(self) -> int:
        """Number of walls and vertices together."""
        return len(self.walls) + len(self.vertices)

    def within(self, x_in: float, y_in: float, reach_in: float) -> Reflectors:
        """Return those of which a part is nearer to a point than `reach_in`."""
        from_corner = np.array((x_in, y_in)) - self.corners
        foot = np.einsum("ij,ij->i", from_corner, self.along)
        beyond = foot - np.clip(foot, 0.0, self.lengths)
        height = np.einsum("ij,ij->i", from_corner, self.normals)
        vertices = self.vertices - np.array((x_in, y_in))
        return self.some(np.hypot(height, beyond) < reach_in, np.hypot(*vertices.T) < reach_in)

    def some(self, walls: Mask, vertices: Mask) -> Reflectors:
        """Return those alone that are selected, (m,) and (v,)."""
        return Reflectors(
            self.walls[walls],
            self.corners[walls],
            self.along[walls],
            self.normals[walls],
            self.lengths[walls],
            self.vertices[vertices],
            self.square[vertices],
            self.free[vertices],
        )


def reflectors(segments: npt.ArrayLike) -> Reflectors:
    """Return the reflectors of a map of wall segments (m, 4), rows x1 y1 x2 y2; none may have length 0."""
    # 1. Walls: unit vectors and lengths.
    walls = np.array(segments, dtype=np.float64).reshape(-1, 4)
    spans = walls[:, 2:] - walls[:, :2]
    lengths = np.hypot(spans[:, 0], spans[:, 1])
    along = spans / lengths[:, None]
    # 2. The directions of the walls that leave each point.
    directions: dict[tuple[float, float], list[float]] = {}
    for (x1, y1, x2, y2), (ux, uy) in zip(walls.tolist(), along.tolist(), strict=True):
        directions.setdefault((x1, y1), []).append(float(np.arctan2(uy, ux)))
        directions.setdefault((x2, y2), []).append(float(np.arctan2(-uy, -ux)))
    # 3. Vertices: all points but those in the middle of a straight wall.
    angles = {point: _angle_between(leaving) for point, leaving in directions.items()}
    points = [point for point, angle in angles.items() if abs(angle - np.pi) >= STRAIGHT_RAD]
    square = [abs(angles[point] - np.pi / 2.0) <= SQUARE_RAD for point in points]
    free = [len(directions[point]) == 1 for point in points]
    normals = np.stack((-along[:, 1], along[:, 0]), axis=-1)
    vertices = np.array(points, dtype=np.float64).reshape(-1, 2)
    masks = (np.array(mask, dtype=np.bool_) for mask in (square, free))
    return Reflectors(walls, walls[:, :2], along, normals, lengths, vertices, *masks)


def _angle_between(directions_rad: list[float]) -> float:
    """Return the angle from 0 to pi between the two walls that meet in a point; 0 where there are not just two."""
    if len(directions_rad) != 2:
        return 0.0
    return abs(wrap_angle(directions_rad[0] - directions_rad[1]))
