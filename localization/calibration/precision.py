"""Whether a calibration is known well enough, and what of it is nothing but noise.

    wanted      a standard deviation of a thirtieth of what was found, or of what is typical where that is more: then
                10 % of it are three standard deviations
    noise       what was found is no more than two of its own standard deviations: it may as well be 0

Rules: values and words.
"""

from __future__ import annotations

from math import radians
from typing import Final, NamedTuple

from worlds.calibration import Calibration

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
