"""A laser vector in another shape than the robot sent: a connection reads one shape, the robot's laser gives another.

    words a reading     4 lines x1 y1 x2 y2 | 2 points x y | 1 the camera's row of each column
    rows -> points -> lines       and no way back: what cannot be made is (0,), no reading

Rules: pure. Rows become points by the geometry of simulation/laser.py, evenly spread over its angle.
"""

from __future__ import annotations

import numpy as np

from nclient.protocol.terms import LINES, PIXELS, POINTS
from nclient.protocol.units import tenths
from nserver_emu.simulation.laser import COLUMNS, PIXEL_IN, LineFit, lines, points
from worlds.bodies import Body
from worlds.geometry import FloatArray

NOTHING = (0,)


def in_shape(vector: tuple[int, ...], width: int, body: Body, fit: LineFit) -> tuple[int, ...]:
    """The laser vector (n, numbers of n readings), 1/10 inch or rows, with `width` words a reading."""
    count = vector[0]
    given = (len(vector) - 1) // count if count else width
    if given == width:
        return vector
    if given == LINES or width == PIXELS:
        return NOTHING
    found = _points_of_rows(vector[1:], body) if given == PIXELS else np.reshape(vector[1:], (-1, POINTS)) / 10.0
    if width == LINES:
        found = lines(found, fit)
    return (len(found), *[tenths(number) for number in found.ravel().tolist()])


def _points_of_rows(rows: tuple[int, ...], body: Body) -> FloatArray:
    """Points (k, 2) in the robot's frame, of the columns that see something: range is PIXEL_IN / row."""
    at = np.linspace(0, COLUMNS - 1, len(rows)).round().astype(int)
    seen = np.full(COLUMNS, np.inf)
    lit = np.array(rows) > 0
    seen[at[lit]] = PIXEL_IN / np.array(rows)[lit]
    return points(seen, body)
