"""How far a simulation that got the same commands differs from the real robot: real less simulated, by quantity.

    Running      one quantity: count, mean, standard deviation, largest, last (Welford's recurrence)
    Shadow       all of them, in inches, degrees and seconds; `compare` takes two State vectors of one moment

Rules: pure; no robot, no clock. Angles differ by the short way. A sonar counts where both heard something; where only
one did is counted beside it. 255 is no range, and 0 a dead sonar.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from nclient.protocol.mask import BUMPER_SLOT, COMPASS_SLOT
from nclient.protocol.models import Model
from nclient.protocol.units import FULL_TURN_TENTHS

_X, _Y, _STEERING, _TURRET = 34, 35, 36, 37
_VELOCITIES: Final = range(38, 41)
_INFRAREDS: Final = range(1, 17)
_SONARS: Final = range(17, 33)
_NO_ECHO: Final = (0, 255)
ALL_SONARS: Final = "sonars_in"
TURNING: Final = ("translation_in_s", "steering_deg_s", "turret_deg_s")
WHEELS: Final = ("right_wheel_in_s", "left_wheel_in_s")


@dataclass(slots=True)
class Running:
    """A quantity's differences so far: none is kept but the last."""

    count: int = 0
    mean: float = 0.0
    largest: float = 0.0
    """The one farthest from 0, with its sign."""
    last: float = 0.0
    one_sided: int = 0
    """Times that only one of the two had a reading."""
    _squares: float = 0.0

    def add(self, difference: float) -> None:
        """One more. Welford 1962: M2 += (d - old mean) (d - new mean)."""
        self.count += 1
        off = difference - self.mean
        self.mean += off / self.count
        self._squares += off * (difference - self.mean)
        self.last = difference
        if abs(difference) > abs(self.largest):
            self.largest = difference

    @property
    def std(self) -> float:
        """Standard deviation of the sample; 0 for fewer than two."""
        return math.sqrt(self._squares / (self.count - 1)) if self.count > 1 else 0.0

    def as_numbers(self) -> dict[str, Any]:
        """For a report."""
        return {"count": self.count, "mean": self.mean, "std": self.std, "max": self.largest, "last": self.last,
                "one_sided": self.one_sided}  # fmt: skip


class Shadow:
    """The differences of one robot. `quantities` by name, in the order of State."""

    def __init__(self, model: Model) -> None:
        self.model = model
        self.states = 0
        self._axes = TURNING if model.has_turret else WHEELS
        self._infrareds = [f"infrared_{number}" for number in range(16)] if model.has_infrared else []
        self._sonars = [f"sonar_{number}_in" for number in range(16)]
        names = ("x_in", "y_in", "steering_deg", "turret_deg", *self._axes, "compass_deg", "bumpers", *self._infrareds,
                 ALL_SONARS, *self._sonars)  # fmt: skip
        self.quantities = {name: Running() for name in names}

    def compare(self, real: Sequence[int], simulated: Sequence[int]) -> None:
        """Two whole State vectors, 45 numbers in wire units, bumpers clean."""
        self.states += 1
        lengths = [(_X, "x_in"), (_Y, "y_in"), *zip(_VELOCITIES, self._axes, strict=False)]
        for slot, name in lengths:
            self.quantities[name].add((real[slot] - simulated[slot]) / 10)
        for slot, name in ((_STEERING, "steering_deg"), (_TURRET, "turret_deg"), (COMPASS_SLOT, "compass_deg")):
            self.quantities[name].add(short_way_deg(real[slot] - simulated[slot]))
        self.quantities["bumpers"].add((real[BUMPER_SLOT] ^ simulated[BUMPER_SLOT]).bit_count())
        for slot, name in zip(_INFRAREDS, self._infrareds, strict=False):
            self.quantities[name].add(real[slot] - simulated[slot])
        for slot, name in zip(_SONARS, self._sonars, strict=True):
            self._compare_sonar(name, real[slot], simulated[slot])

    def summary(self) -> str:
        """One line: mean and standard deviation of what matters most, and how often sonars disagreed."""
        parts = [
            f"{name} {found.mean:+.2f} ± {found.std:.2f}"
            for name, found in self.quantities.items()
            if name in ("x_in", "y_in", "steering_deg", ALL_SONARS)
        ]
        one_sided = self.quantities[ALL_SONARS].one_sided
        return f"{self.states} states: {', '.join(parts)}; {one_sided} echoes heard by one alone"

    def _compare_sonar(self, name: str, real: int, simulated: int) -> None:
        heard = (real not in _NO_ECHO) + (simulated not in _NO_ECHO)
        for found in (self.quantities[name], self.quantities[ALL_SONARS]):
            if heard == 2:
                found.add(real - simulated)
            else:
                found.one_sided += heard


def short_way_deg(difference_tenths: int) -> float:
    """The difference of two directions in degrees, -180 to below 180."""
    half = FULL_TURN_TENTHS // 2
    return ((difference_tenths + half) % FULL_TURN_TENTHS - half) / 10
