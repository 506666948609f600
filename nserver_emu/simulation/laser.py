"""The laser of the N200: a plane sheet of light and the points and lines seen in it. Pure: eye and walls in.

    482 columns over 60 degrees, column 0 the rightmost, from the front of the turret; a wall 6 to 180 in away is seen
    points      in the robot's frame: x to the front of the turret, y to its left, from its axis, inches
    lines       neighbouring points cut at gaps, then where they leave their chord; each piece fitted by least squares
    pixels      the row of the camera, nearer is larger; 0 nothing

Where the sheet starts and what a pixel is are decisions of ours: no source gives them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, inf, radians, sin
from typing import Final

import numpy as np

from nserver_emu.simulation.visibility import Eye
from worlds.geometry import BoolArray, FloatArray
from worlds.raycast import cast_discs, cast_rays
from worlds.robots import Body

COLUMNS: Final = 482
WIDTH_RAD: Final = radians(60.0)
NEAREST_IN: Final = 6.0
FARTHEST_IN: Final = 180.0
PIXEL_IN: Final = 2880.0
"""Pixel row times range: 480 rows at 6 in, 16 at 180 in."""

ANGLES_RAD: Final = np.linspace(-WIDTH_RAD / 2.0, WIDTH_RAD / 2.0, COLUMNS)
"""Directions of the columns against the front of the turret, counter-clockwise."""


@dataclass(frozen=True, slots=True)
class LineFit:
    """How points become lines: farthest from its chord a point of a line may lie, fewest points of a line, and the
    longest gap between two of them. Inches."""

    threshold_in: float = 1.0
    min_points: int = 5
    gap_in: float = 6.0


def ranges(eye: Eye, walls: FloatArray, body: Body) -> FloatArray:
    """What each column sees: (482,) inches from the front of the turret, inf where nothing from 6 to 180 in."""
    directions = eye.turret_rad + ANGLES_RAD
    ways = np.stack((np.cos(directions), np.sin(directions)), axis=1)
    out = body.radius_in
    start = eye.x_in + out * cos(eye.turret_rad), eye.y_in + out * sin(eye.turret_rad)
    met = cast_rays(start, ways, walls)[0]
    others = eye.others
    if len(others):
        met = np.minimum(met, cast_discs(start, ways, others))
    return np.where((met >= NEAREST_IN) & (met <= FARTHEST_IN), met, inf)


def points(seen_in: FloatArray, body: Body) -> FloatArray:
    """The points (k, 2) of the columns that see something, in the robot's frame, from right to left."""
    met: BoolArray = seen_in < inf
    x = body.radius_in + seen_in[met] * np.cos(ANGLES_RAD[met])
    return np.stack((x, seen_in[met] * np.sin(ANGLES_RAD[met])), axis=1)


def pixels(seen_in: FloatArray) -> tuple[int, ...]:
    """The camera's rows, 482 numbers."""
    return tuple(np.rint(PIXEL_IN / seen_in).astype(int).tolist())


def thinned(seen_in: FloatArray, most: int) -> FloatArray:
    """Only so many columns, evenly spread, the others blind; 0 or 482 and more: all."""
    if not 0 < most < COLUMNS:
        return seen_in
    kept = np.zeros(COLUMNS, dtype=np.bool_)
    kept[np.linspace(0, COLUMNS - 1, most).round().astype(int)] = True
    return np.where(kept, seen_in, inf)


def lines(found: FloatArray, fit: LineFit) -> FloatArray:
    """Lines (m, 4), rows x1 y1 x2 y2, through points (k, 2) that follow one another."""
    steps = np.hypot(*np.diff(found, axis=0).T)
    runs = np.split(found, np.flatnonzero(steps > fit.gap_in) + 1)
    fitted = [_fitted(piece) for run in runs for piece in _pieces(run, fit)]
    return np.array(fitted).reshape(-1, 4)


def _pieces(run: FloatArray, fit: LineFit) -> Iterator[FloatArray]:
    """The run cut where it is farthest from the chord of its ends, again and again; too short pieces left out."""
    waiting = [run]
    while waiting:
        piece = waiting.pop()
        if len(piece) < max(fit.min_points, 2):
            continue
        off = _off_chord(piece)
        at = int(off.argmax())
        if off[at] <= fit.threshold_in or not 0 < at < len(piece) - 1:
            yield piece
        else:
            waiting += [piece[at:], piece[: at + 1]]


def _off_chord(piece: FloatArray) -> FloatArray:
    """Distances of points from the line through the first and the last; from the first where these are one."""
    chord, offsets = piece[-1] - piece[0], piece - piece[0]
    length = float(np.hypot(*chord))
    if length == 0.0:
        off: FloatArray = np.hypot(offsets[:, 0], offsets[:, 1])
    else:
        off = np.abs(chord[0] * offsets[:, 1] - chord[1] * offsets[:, 0]) / length
    return off


def _fitted(piece: FloatArray) -> FloatArray:
    """The line of least squared distances, from where the first point lies on it to where the last does: (4,).

    Its direction is half the angle of (sum(u^2 - v^2), 2 sum(u v)), with u, v from the mean of the points.
    """
    mean = piece.mean(axis=0)
    u, v = (piece - mean).T
    angle = 0.5 * np.arctan2(2.0 * (u * v).sum(), (u * u - v * v).sum())
    along = np.array([np.cos(angle), np.sin(angle)])
    ends = mean + np.outer((piece[[0, -1]] - mean) @ along, along)
    line: FloatArray = ends.reshape(4)
    return line
