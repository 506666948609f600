"""How fast an uncertain robot may go: its 3-sigma against the room that walls leave it.

    q = min over walls of (distance - body) / (3 sigma towards the wall)      full speed from ENOUGH on, none at 1

A wall counts by the nearer of the robot's place and the place a little ahead; one that it only goes away from does not.
Rules: pure; a place, a covariance, walls.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from localization.filters.belief import Floats
from worlds.geometry import nearest_points

SIGMAS: Final = 3.0
ENOUGH: Final = 1.6
LEAST_SHARE: Final = 0.1
"""A smaller share is none: else the robot would creep up to where it must stand and never be there."""
_AWAY_IN: Final = 0.05
_NOTHING_IN: Final = 1e-6


def allowed_share(pose: Floats, ahead: Floats, cov: Floats, walls: Floats, body_in: float) -> float:
    """The share of its speed, 0 to 1, that a robot at a pose (3,), known with the covariance (3, 3), may take on its
    way to the place `ahead` (2,), where an error of the heading tells as well."""
    if not len(walls):
        return 1.0
    here = pose[:2]
    nearest, far = nearest_points(np.stack((here, ahead)), walls)
    closing = far[1] < far[0] + _AWAY_IN
    if not closing.any():
        return 1.0
    off = (nearest[0] - here)[closing]
    along = off / np.maximum(np.hypot(off[:, 0], off[:, 1]), _NOTHING_IN)[:, None]
    gone = ahead - here
    by_pose = np.array([[1.0, 0.0, -gone[1]], [0.0, 1.0, gone[0]]])
    sigma = np.sqrt(np.einsum("ki,ij,kj->k", along, by_pose @ cov @ by_pose.T, along))
    room = np.minimum(far[0], far[1])[closing] - body_in
    enough = float((room / np.maximum(SIGMAS * sigma, _NOTHING_IN)).min())
    share = min(1.0, (enough - 1.0) / (ENOUGH - 1.0))
    return share if share >= LEAST_SHARE else 0.0
