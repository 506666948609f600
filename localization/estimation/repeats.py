"""How many readings of each sonar came from where the robot stands: what errs the same way each time is news once.

A reading's error has two parts: one of variance r, drawn anew each time, and one of variance c, which is the same as
long as the robot stands where it does (of readings in whole inches: the rounding). However many readings there are, a
range is not known better than c, while a filter that takes them for independent becomes surer and surer. Taken in one
by one, readings with weights w_1, w_2, ... are claimed to tell with variance 1 / W, W = sum w, and really do with
c + r sum w^2 / W^2. The largest weights for which the claim is true are w_1 = 1 / (c + r), w_n = (1 - 2 c W) w_1, so

    R_n = (c + r) / q^(n - 1)        q = (r - c) / (r + c)

and all together are worth 1 / (2 c). Where c is r or more, those after the first add nothing.

Rules: pure but for the counts; the encoders alone tell whether it stands.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from localization.estimation.belief import Floats, wrapped

SAME_IN, SAME_RAD = 0.25, 0.005
"""Moved or turned by more, a robot is elsewhere: a quarter of an inch on, readings in whole inches err otherwise."""
LEAST_WORTH: Final = 1e-12
"""Of the first reading's: as good as nothing."""


def nth_variance(variance: Floats, constant: Floats, times: int) -> Floats:
    """R_n of the `times`-th reading from one place, of any shape: `variance` r + c of one reading, `constant` c."""
    worth: Floats = variance / np.maximum(share_of_first(variance, constant, times), LEAST_WORTH)
    return worth


def share_of_first(variance: Floats, constant: Floats, times: int) -> Floats:
    """q^(n - 1), 0 where c is r or more: what the `times`-th reading adds, as a share of what the first does."""
    share: Floats = np.maximum(1.0 - 2.0 * constant / variance, 0.0) ** (times - 1)
    return share


class _Taken(NamedTuple):
    """Where a sonar's reading was first taken in from a place (way and turn of the encoders so far, inches and radians;
    the turret against the heading), and how many were."""

    way_in: float
    turned_rad: float
    turret_rad: float
    number: int


class Repeats:
    """See the head of this file. Only readings that were taken in count: one that was refused told nothing."""

    def __init__(self) -> None:
        self._way_in = self._turned_rad = 0.0
        self._taken: dict[int, _Taken] = {}

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,)."""
        way_in, turn_rad = step.tolist()
        self._way_in += abs(way_in)
        self._turned_rad += turn_rad

    def before(self, sonar: int, turret_offset_rad: float) -> int:
        """How many readings of this sonar have been taken in from here, the turret turned by so much against the
        heading."""
        taken = self._taken.get(sonar)
        return taken.number if taken and self._is_here(taken, turret_offset_rad) else 0

    def take(self, sonar: int, turret_offset_rad: float) -> None:
        """One more was."""
        before = self.before(sonar, turret_offset_rad)
        first = self._taken[sonar] if before else _Taken(self._way_in, self._turned_rad, turret_offset_rad, 0)
        self._taken[sonar] = first._replace(number=before + 1)

    def _is_here(self, place: _Taken, turret_offset_rad: float) -> bool:
        turned = self._turned_rad - place.turned_rad
        aimed = wrapped(turned + turret_offset_rad - place.turret_rad)
        return self._way_in - place.way_in <= SAME_IN and max(abs(turned), abs(aimed)) <= SAME_RAD
