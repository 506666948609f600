"""The laser of the N200: a plane sheet of light, and the points and lines measured in it.

    482 columns over 60 degrees, column 0 the rightmost, from the front of the turret; ranges of 6 to 180 in
    points      in the robot's frame: x to the front of the turret, y to its left, from its axis, inches
    lines       neighbouring points split at gaps, then where they leave their chord; each piece fitted by least squares
    pixels      the row of the camera image, larger when nearer; 0 for nothing

The origin of the sheet and the scale of a pixel are assumptions: no source gives them.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, inf, radians, sin
from typing import Final

import numpy as np

from nserver_emu.simulation.visibility import SensorPose
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast_arrays import cast_discs, cast_fan
from worlds.robots import Body

COLUMNS: Final = 482
FIELD_OF_VIEW_RAD: Final = radians(60.0)
MIN_RANGE_IN: Final = 6.0
MAX_RANGE_IN: Final = 180.0
PIXEL_IN: Final = 2880.0
"""Pixel row times range: row 480 at 6 in, row 16 at 180 in."""

ANGLES_RAD: Final = np.linspace(-FIELD_OF_VIEW_RAD / 2.0, FIELD_OF_VIEW_RAD / 2.0, COLUMNS)
"""Directions of the columns against the front of the turret, counter-clockwise."""


@dataclass(frozen=True, slots=True)
class LineFit:
    """Parameters of the line extraction.

    Attributes
    ----------
    threshold_in
        Largest distance of a line's point from its chord.
    min_points
        Fewest points of a line.
    gap_in
        Longest gap between two points of a line.
    """

    threshold_in: float = 1.0
    min_points: int = 5
    gap_in: float = 6.0


def ranges(sensor_pose: SensorPose, walls: FloatArray, body: Body) -> FloatArray:
    """Return the range of each column: (482,) inches from the front of the turret, inf for nothing in 6 to 180 in."""
    angles = sensor_pose.turret_rad + ANGLES_RAD
    # The sheet starts at the front of the body.
    x_in = sensor_pose.x_in + body.radius_in * cos(sensor_pose.turret_rad)
    start = x_in, sensor_pose.y_in + body.radius_in * sin(sensor_pose.turret_rad)
    met = cast_fan(*start, angles, walls, MAX_RANGE_IN)
    others = sensor_pose.others
    if len(others):
        directions = np.stack((np.cos(angles), np.sin(angles)), axis=1)
        met = np.minimum(met, cast_discs(start, directions, others))
    measured = np.where((met >= MIN_RANGE_IN) & (met <= MAX_RANGE_IN), met, inf)
    measured.setflags(write=False)
    return measured


def points(ranges_in: FloatArray, body: Body) -> FloatArray:
    """Return the points (k, 2) of the columns with a range, in the robot's frame, from right to left."""
    met: BoolArray = ranges_in < inf
    x = body.radius_in + ranges_in[met] * np.cos(ANGLES_RAD[met])
    return np.stack((x, ranges_in[met] * np.sin(ANGLES_RAD[met])), axis=1)


def pixels(ranges_in: FloatArray) -> tuple[int, ...]:
    """Return the rows of the camera image, 482 numbers."""
    return tuple(np.rint(PIXEL_IN / ranges_in).astype(int).tolist())


def select_columns(ranges_in: FloatArray, count: int) -> FloatArray:
    """Return the ranges of `count` evenly spread columns, inf for the others; 0 or 482 and more: all."""
    if not 0 < count < COLUMNS:
        return ranges_in
    is_selected = np.zeros(COLUMNS, dtype=np.bool_)
    is_selected[np.linspace(0, COLUMNS - 1, count).round().astype(int)] = True
    return np.where(is_selected, ranges_in, inf)


def lines(scan: FloatArray, fit: LineFit) -> FloatArray:
    """Return lines (m, 4), rows x1 y1 x2 y2, through points (k, 2) that follow one another.

    References
    ----------
    Pavlidis and Horowitz, Segmentation of plane curves, IEEE Trans. Computers 23 (1974): split at the farthest point.
    """
    # 1. Runs without gaps. 2. Pieces near their chords. 3. A fit through each.
    steps = np.hypot(*np.diff(scan, axis=0).T)
    runs = np.split(scan, np.flatnonzero(steps > fit.gap_in) + 1)
    fitted = [_fit_line(piece) for run in runs for piece in _split(run, fit)]
    return np.array(fitted).reshape(-1, 4)


def _split(run: FloatArray, fit: LineFit) -> Iterator[FloatArray]:
    """Yield the run, split repeatedly where it is farthest from the chord of its ends; omit too short pieces."""
    # A stack instead of recursion: a run has up to 482 points.
    remaining = [run]
    while remaining:
        piece = remaining.pop()
        if len(piece) < max(fit.min_points, 2):
            continue
        distances = _chord_distances(piece)
        at = int(distances.argmax())
        if distances[at] <= fit.threshold_in or not 0 < at < len(piece) - 1:
            yield piece
        else:
            remaining += [piece[at:], piece[: at + 1]]


def _chord_distances(piece: FloatArray) -> FloatArray:
    """Return the distances of points from the line through the first and the last; from the first if these coincide."""
    chord, offsets = piece[-1] - piece[0], piece - piece[0]
    length = float(np.hypot(*chord))
    if length == 0.0:
        distances: FloatArray = np.hypot(offsets[:, 0], offsets[:, 1])
    else:
        distances = np.abs(chord[0] * offsets[:, 1] - chord[1] * offsets[:, 0]) / length
    return distances


def _fit_line(piece: FloatArray) -> FloatArray:
    """Return the line (4,) of least squared distances, between the projections of the first and the last point.

    Its direction is half the angle of (sum(u^2 - v^2), 2 sum(u v)), with u, v from the mean of the points (total least
    squares).
    """
    # Direction of the largest variance, then the ends of the piece projected onto it.
    mean = piece.mean(axis=0)
    u, v = (piece - mean).T
    angle = 0.5 * np.arctan2(2.0 * (u * v).sum(), (u * u - v * v).sum())
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = mean + np.outer((piece[[0, -1]] - mean) @ along, along)
    line: FloatArray = ends.reshape(4)
    return line
