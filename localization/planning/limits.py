"""How fast the axes of each model go: what a way is smoothed to. Data; numbers as in ROBOTS.md.

    translation_in_s, _in_s2      speed and acceleration along the way
    steering_rad_s, _rad_s2       of the heading

A Scout turns by its two wheels, which share what they can do: 20 in/s and 90 deg/s at once are 31 of a wheel's 39 in/s;
15 in/s2 and 126 deg/s2 are its 30 in/s2.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf, radians
from types import MappingProxyType
from typing import Final


@dataclass(frozen=True, slots=True)
class AxisLimits:
    """See the head of this file."""

    translation_in_s: float
    translation_in_s2: float
    steering_rad_s: float
    steering_rad_s2: float

    def capped(self, translation_in_s: float, steering_rad_s: float = inf) -> AxisLimits:
        """The same, driving and turning no faster."""
        return replace(
            self,
            translation_in_s=min(self.translation_in_s, translation_in_s),
            steering_rad_s=min(self.steering_rad_s, steering_rad_s),
        )


_SYNCHRO: Final = AxisLimits(20.0, 30.0, radians(45.0), radians(50.0))
LIMITS: Final[Mapping[str, AxisLimits]] = MappingProxyType(
    {"n150": _SYNCHRO, "n200": _SYNCHRO, "scout": AxisLimits(20.0, 15.0, radians(90.0), radians(126.0))}
)
"""By the model's name, at the accelerations that robots have at power-on."""
