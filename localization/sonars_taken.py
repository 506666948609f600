"""What --sonars left out comes to: rays of a simulation, cones of a robot; said aloud, and doubted by what is heard.

A simulation does not tell whether its sonars are rays (setups ideal, noisy) or a real ring's cones (setup measured), so
rays are a guess. Rules: values and words; whether readings fit is calibration's fit to say.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from localization.calibration.fit import Fit
from localization.localizer import Echo

FEWEST: Final = 30
"""Of fewer readings chance alone makes a bad fit."""


class Taken(NamedTuple):
    """For what the sonars are taken, and whether that is a guess."""

    rays: bool
    guessed: bool

    def line(self) -> str:
        """The guess in words; "" where somebody said it, or it is a robot's."""
        if not (self.rays and self.guessed):
            return ""
        return "sonars are taken for exact rays, this being a simulation (of setup measured: --sonars cones)"


AS_CONES: Final = Taken(rays=False, guessed=False)


def taken(option: str | None, simulated: bool) -> Taken:
    """By the option `--sonars` (rays, cones or left out) and what is at the other end."""
    return Taken(simulated if option is None else option == "rays", option is None)


def hint(sonars: Taken, echoes: Iterable[Echo]) -> str:
    """What to say where the guess does not fit what was heard; "" where it does, or was none."""
    if not sonars.line():
        return ""
    fit = Fit(sonars.rays)
    fit.add(echoes)
    return "" if fit.good or fit.taken + fit.refused < FEWEST else fit.line()
