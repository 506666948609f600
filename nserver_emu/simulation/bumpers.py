"""Bumpers: which of them a touch sets. Pure: directions in, bits out; what touches is found in contact.py.

A touch sets the bumper nearest to its direction, and both neighbours where it lies midway: all that are no farther
from it than half their spacing. Walls and robots reach from the floor to above both rings, so the rings count as one.
"""

from __future__ import annotations

from collections.abc import Iterable
from math import tau
from typing import Final

from nserver_emu.simulation.angles import short_way

MIDWAY_RAD: Final = 1e-6
"""A touch this near to midway is midway: 1e-5 in on the rim, where contacts are found to 1e-4 in at worst."""


def pressed(directions_rad: Iterable[float], bumper_angles_rad: tuple[float, ...]) -> int:
    """Bit i is set where bumper number i is pressed.

    directions_rad      where things touch, in the frame of the bumpers, counter-clockwise
    bumper_angles_rad   of a ring with equal spacing, in the same frame
    """
    half = 0.5 * tau / len(bumper_angles_rad) + MIDWAY_RAD
    bits = 0
    for direction in directions_rad:
        for number, angle in enumerate(bumper_angles_rad):
            if abs(short_way(direction - angle)) <= half:
                bits |= 1 << number
    return bits
