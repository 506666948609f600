"""Whether a calibration is known well enough, and what of it is nothing but noise.

    wanted      a standard deviation of a thirtieth of what was found, or of what is typical where that is more: then
                10 % of it are three standard deviations
    noise       what was found is no more than two of its own standard deviations: it may as well be 0

Rules: values and words.

What a calibrating filter has found, as a calibration and as a table. Rules: values and words.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import degrees, radians
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import Belief
from localization.filters.calibration import OFFSET, OWN, RING_TURN, SIZE
from localization.filters.odometry import OdometryParameter
from worlds.robots import Calibration, Spread

WAY, TURN, DRIFT, RING, SONAR = 0.03, 0.03, 0.00075, radians(3.0), 1.0
"""Typical: wheels 3 % off, 0.75 mrad/in, a ring 3 degrees, a sonar 1 in."""
SHARE: Final = 1.0 / 30.0
NOISE_STDS: Final = 2.0


class Number(NamedTuple):
    """One number of a calibration: how far it is from what a faultless robot has, how well it is known, and how much is
    typical."""

    name: str
    off: float
    std: float
    typical: float

    @property
    def enough(self) -> bool:
        """Whether it is known as well as wanted."""
        return self.std <= SHARE * max(abs(self.off), self.typical)

    @property
    def is_noise(self) -> bool:
        """Whether it may as well be nothing."""
        return abs(self.off) <= NOISE_STDS * self.std

    @property
    def words(self) -> str:
        """How well it is known, beside itself."""
        return "within noise of zero" if self.is_noise else f"known to {self.std / abs(self.off):.1%}"


def numbers(found: Calibration) -> list[Number]:
    """All that was found: way, turn, drift, ring, and the sonars in their order."""
    spread = found.spread
    sonars = enumerate(zip(found.offsets_in, spread.offsets_in, strict=True))
    return [
        Number("way", found.way_scale - 1.0, spread.way_scale, WAY),
        Number("turn", found.turn_scale - 1.0, spread.turn_scale, TURN),
        Number("drift", found.drift_rad_in, spread.drift_rad_in, DRIFT),
        Number("ring", found.turned_rad, spread.turned_rad, RING),
        *(Number(f"sonar {sonar}", off, std, SONAR) for sonar, (off, std) in sonars),
    ]


def missing(found: Calibration) -> list[str]:
    """The names of what is not known as well as wanted."""
    return [number.name for number in numbers(found) if not number.enough]


def noise_in(found: Calibration) -> list[str]:
    """The names of what may as well be nothing."""
    return [number.name for number in numbers(found) if number.is_noise]


def calibration_in(belief: Belief) -> Calibration:
    """The constants of a belief over states (24,), with their standard deviations."""
    mean, std, cov = belief.mean, belief.std, belief.cov
    offsets = mean[OFFSET] + mean[OWN:SIZE]
    spread = np.sqrt(cov[OFFSET, OFFSET] + np.diagonal(cov)[OWN:SIZE] + 2.0 * cov[OFFSET, OWN:SIZE])
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
    """For people: each number with its standard deviation, and how well that is known of what it is."""
    return "\n".join(_rows(found))


def _rows(found: Calibration) -> Iterator[str]:
    way, turn, drift, ring, *sonars = numbers(found)
    yield f"{'':24}{'found':>12}{'± std':>12}"
    yield _row("way, true / counted", 1.0 + way.off, way.std, 4, way.words)
    yield _row("turn, true / counted", 1.0 + turn.off, turn.std, 4, turn.words)
    yield _row("drift, rad/in", drift.off, drift.std, 5, drift.words)
    yield _row("ring turned, deg", degrees(ring.off), degrees(ring.std), 2, ring.words)
    for sonar in sonars:
        yield _row(f"sonar {sonar.name.removeprefix('sonar '):>2} reads more, in", sonar.off, sonar.std, 2, sonar.words)


def _row(name: str, value: float, std: float, places: int, words: str) -> str:
    return f"{name:24}{value:12.{places}f}{std:12.{places}f}   {words}"
