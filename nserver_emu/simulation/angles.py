"""Angles on the circle, in the one place where physics wraps them. Radians."""

from __future__ import annotations

from math import pi, remainder, tau


def once_round(angle_rad: float) -> float:
    """The same direction in [0, 2 pi): a turn just below 0 is 0, not 2 pi."""
    wrapped = angle_rad % tau
    return wrapped if wrapped < tau else 0.0


def short_way(angle_rad: float) -> float:
    """The same direction in (-pi, pi]: how far it is from 0, the short way round."""
    wrapped = remainder(angle_rad, tau)
    return wrapped if wrapped > -pi else pi
