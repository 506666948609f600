"""A robot that is known to err: its reports as those of a faultless one, and what is left to find out of its wheels.

    readings    less their sonars' offsets; limits stay limits      turret    turned as the ring really stands
    wheels      the filter's constants (systematic) begin at what was found, as uncertain as that is

Rules: pure; what it errs is worlds.calibration's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from localization.belief import Belief
from localization.systematic import POSE, with_constants
from worlds.calibration import FAULTLESS, Calibration

if TYPE_CHECKING:
    from localization.localizer import Report

LOWEST_IN: Final = 6
HIGHEST_IN: Final = 255
_INSIDE_IN: Final = 1e-3


@dataclass(frozen=True, slots=True)
class Faultless:
    """A report of a robot without errors of its sonars."""

    clock_s: float | None
    x_in: float
    y_in: float
    steering_rad: float
    turret_rad: float
    sonars_in: tuple[float, ...]


def of(report: Report, errs: Calibration) -> Report:
    """The report without what the sonars are known to get wrong."""
    if errs is FAULTLESS:
        return report
    sonars = tuple(_range_in(read, off) for read, off in zip(report.sonars_in, errs.offsets_in, strict=True))
    turret_rad = report.turret_rad + errs.turned_rad
    return Faultless(report.clock_s, report.x_in, report.y_in, report.steering_rad, turret_rad, sonars)


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
