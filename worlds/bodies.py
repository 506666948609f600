"""The bodies of the three robots: what filter, physics and page must agree on. Numbers as in ROBOTS.md.

Lives here: radii, where the sonars and the bumpers sit. Lives elsewhere: what the wire says of a model
(nclient/protocol/types.py), speeds and limits (simulation). No arithmetic but degrees to radians.

    frame       x to the front, y to the left, angles counter-clockwise, inches and radians
    sonars      fixed to the turret (Scout: to the body); a beam points away from the axis, so its reading is
                the range from the axis less the radius of the ring
    bumpers     fixed to the body, which on the synchro drives never turns: not turret, not steering
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import radians
from types import MappingProxyType
from typing import Final

SONARS: Final = 16
"""Sonars in a ring, number i at i x 22.5 degrees from the front."""


@dataclass(frozen=True, slots=True)
class Body:
    """The outside of one model: a vertical cylinder with a ring of sonars and a band of bumpers.

    name                    "n150", "n200" or "scout"
    radius_in               the cylinder that touches walls, inches
    sonar_ring_radius_in    distance of the sonars from the axis, inches (on the N200 0.06 in more than the
                            body: cast from the axis, never from the ring, and no beam starts behind a wall)
    sonar_angles_rad        16 angles against the front of the turret (Scout: of the body)
    bumper_angles_rad       20 angles (Scout: 6) against the body
    """

    name: str
    radius_in: float
    sonar_ring_radius_in: float
    sonar_angles_rad: tuple[float, ...]
    bumper_angles_rad: tuple[float, ...]


def _evenly(count: int) -> tuple[float, ...]:
    """`count` angles around the circle in radians, the first at 0, counter-clockwise."""
    return tuple(radians(360.0 * number / count) for number in range(count))


N150: Final = Body("n150", 9.72, 9.06, _evenly(SONARS), _evenly(20))
N200: Final = Body("n200", 9.0, 9.06, _evenly(SONARS), _evenly(20))
# The radii of the Scout and the places of its six bumpers are decisions of ours: no source gives them.
SCOUT: Final = Body("scout", 8.0, 8.0, _evenly(SONARS), _evenly(6))

BODIES: Final[Mapping[str, Body]] = MappingProxyType({body.name: body for body in (N150, N200, SCOUT)})
"""Every body by its name."""
