"""The result of a calibration: from the belief of the calibrating filter to numbers with accuracies and a table."""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief
from localization.filters.calibration import OFFSET, OWN, RING_TURN
from localization.filters.odometry import OdometryParameter
from worlds.robots import Calibration, Spread

TYPICAL_SCALE, TYPICAL_DRIFT, TYPICAL_RING, TYPICAL_SONAR = 0.03, 0.00075, radians(3.0), 1.0
"""Typical systematic errors: wheels 3 %, 0.75 mrad/in, ring 3 degrees, sonar 1 in."""
REQUIRED_PRECISION: Final = 1.0 / 30.0
"""Required standard deviation relative to the number: 10 % of it are then three standard deviations."""
NOISE_STDS: Final = 2.0
"""A number within this many standard deviations of 0 may be 0."""


class CalibrationNumber(NamedTuple):
    """One number of a calibration: its difference from an ideal robot, standard deviation, typical value."""

    name: str
    off: float
    std: float
    typical: float

    @property
    def is_enough(self) -> bool:
        """True if the number is accurate enough."""
        return self.std <= REQUIRED_PRECISION * max(abs(self.off), self.typical)

    @property
    def is_noise(self) -> bool:
        """True if the number may be 0."""
        return abs(self.off) <= NOISE_STDS * self.std

    @property
    def words(self) -> str:
        """Accuracy of the number relative to itself, as text."""
        return "within noise of zero" if self.is_noise else f"accurate to {self.std / abs(self.off):.1%}"


def numbers(found: Calibration) -> list[CalibrationNumber]:
    """Return all numbers of a calibration: distance, turn, drift, ring, and the sonars in order."""
    spread = found.spread
    sonars = enumerate(zip(found.offsets_in, spread.offsets_in, strict=True))
    return [
        CalibrationNumber("way", found.distance_scale - 1.0, spread.distance_scale, TYPICAL_SCALE),
        CalibrationNumber("turn", found.turn_scale - 1.0, spread.turn_scale, TYPICAL_SCALE),
        CalibrationNumber("drift", found.drift_rad_in, spread.drift_rad_in, TYPICAL_DRIFT),
        CalibrationNumber("ring", found.turned_rad, spread.turned_rad, TYPICAL_RING),
        *(CalibrationNumber(f"sonar {sonar}", off, std, TYPICAL_SONAR) for sonar, (off, std) in sonars),
    ]


def missing(found: Calibration) -> list[str]:
    """Return the names of numbers that are not accurate enough."""
    return [number.name for number in numbers(found) if not number.is_enough]


def noise_in(found: Calibration) -> list[str]:
    """Return the names of numbers that may be 0."""
    return [number.name for number in numbers(found) if number.is_noise]


def calibration_in(belief: Belief) -> Calibration:
    """Return the calibration in a belief over states of the calibrating filter, with its standard deviations."""
    mean, std, cov = belief.mean, belief.std, belief.cov
    # Each sonar has the common offset plus its own; their covariance counts.
    offsets = mean[OFFSET] + mean[OWN:]
    spread = np.sqrt(cov[OFFSET, OFFSET] + np.diagonal(cov)[OWN:] + 2.0 * cov[OFFSET, OWN:])
    return Calibration(
        1.0 + float(mean[OdometryParameter.DISTANCE_SCALE]),
        1.0 + float(mean[OdometryParameter.TURN_SCALE]),
        float(mean[OdometryParameter.DRIFT]),
        tuple(offsets.tolist()),
        float(mean[RING_TURN]),
        Spread(
            float(std[OdometryParameter.DISTANCE_SCALE]),
            float(std[OdometryParameter.TURN_SCALE]),
            float(std[OdometryParameter.DRIFT]),
            tuple(spread.tolist()),
            float(std[RING_TURN]),
        ),
    )


def table(found: Calibration) -> str:
    """Return a table of all numbers with their standard deviations and accuracies."""
    return "\n".join(_rows(found))


def _rows(found: Calibration) -> Iterator[str]:
    distance, turn, drift, ring, *sonars = numbers(found)
    yield f"{'':24}{'found':>12}{'± std':>12}"
    yield _row("distance, true / counted", 1.0 + distance.off, distance.std, 4, distance.words)
    yield _row("turn, true / counted", 1.0 + turn.off, turn.std, 4, turn.words)
    yield _row("drift, rad/in", drift.off, drift.std, 5, drift.words)
    yield _row("ring turned, deg", degrees(ring.off), degrees(ring.std), 2, ring.words)
    for sonar in sonars:
        yield _row(f"sonar {sonar.name.removeprefix('sonar '):>2} reads more, in", sonar.off, sonar.std, 2, sonar.words)


def _row(name: str, value: float, std: float, places: int, words: str) -> str:
    return f"{name:24}{value:12.{places}f}{std:12.{places}f}   {words}"
