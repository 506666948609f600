"""A robot that is known to err: what it tells as a faultless one would, and what is left to find out of its wheels.

    readings    less their sonars' offsets; limits stay limits      turret    turned as the ring really stands
    wheels      the filter's constants (systematic) begin at what was found, as uncertain as that is

Rules: pure; what it errs is worlds.calibration's.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from localization.estimation.belief import Belief
from localization.estimation.systematic import POSE, with_constants
from localization.live.told import Told, retold
from worlds.calibration import FAULTLESS, Calibration

LOWEST_IN: Final = 6
HIGHEST_IN: Final = 255
_INSIDE_IN: Final = 1e-3


def of(told: Told, errs: Calibration) -> Told:
    """What a robot tells, without what its sonars are known to get wrong."""
    if errs is FAULTLESS:
        return told
    sonars = tuple(_range_in(read, off) for read, off in zip(told.sonars_in, errs.offsets_in, strict=True))
    return retold(told, sonars, told.turret_rad + errs.turned_rad)


def with_wheels(pose: Belief, errs: Calibration) -> Belief:
    """A belief over poses (3,) with the constants of such wheels; those of a faultless robot change nothing."""
    if errs is FAULTLESS:
        return pose
    spread = errs.spread
    longer = with_constants(pose, (spread.way_scale, spread.turn_scale, spread.drift_rad_in))
    longer.mean[POSE:] = np.array([errs.way_scale - 1.0, errs.turn_scale - 1.0, errs.drift_rad_in])
    return longer


def _range_in(reading_in: float, offset_in: float) -> float:
    """A reading at a limit says nothing of the range, and goes on saying it."""
    if not LOWEST_IN < reading_in < HIGHEST_IN:
        return reading_in
    return min(max(reading_in - offset_in, LOWEST_IN + _INSIDE_IN), HIGHEST_IN - _INSIDE_IN)
