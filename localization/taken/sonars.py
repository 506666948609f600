"""What --sonars left out comes to: what the robot is, where that can be known; else a guess that is said and doubted.

    sim:                as its setup hears: exact rays (ideal, noisy, worn) or a real ring's cones (measured)
    other simulations   rays, for a server does not tell its setup: a guess, said aloud, doubted by what is heard
    robots              cones

Rules: values and words; a setup is read from the address and its file alone. Whether readings fit is live.fit's to
say.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from localization.live.localizer import Echo, Fit
from localization.taken.body import SIMULATION
from nclient.address import parsed
from nclient.connect import address_or_default
from nclient.errors import WorldFileError
from worlds.texts import read_text, toml_of

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
RING_SETUPS: Final = ("measured",)
"""The named setups whose sonars hear like a real ring."""
RING_MODEL: Final = "polaroid"
"""What a setup's file calls such sonars."""


def taken(option: str | None, simulated: bool, address: str | None = None) -> Taken:
    """By the option `--sonars` (rays, cones or left out), what is at the other end, and its address (None: the
    default's)."""
    if option is not None:
        return Taken(option == "rays", guessed=False)
    told = rays_told_by(address_or_default(address))
    return Taken(simulated, guessed=True) if told is None else Taken(told, guessed=False)


def rays_told_by(address: str) -> bool | None:
    """Whether an address says that sonars are exact rays; None where it says nothing of it."""
    there = parsed(address)
    if there.scheme != SIMULATION:
        return None
    setup = there.options.get("setup", "")
    if not setup.endswith(".toml"):
        return setup not in RING_SETUPS
    try:
        values = toml_of(read_text(Path(setup)), setup)
    except WorldFileError:
        return None
    sonar = values.get("sonar", {})
    model = sonar.get("model") if isinstance(sonar, dict) else None
    return values.get("base") not in RING_SETUPS if model is None else model != RING_MODEL


def hint(sonars: Taken, echoes: Iterable[Echo]) -> str:
    """What to say where the guess does not fit what was heard; "" where it does, or was none."""
    if not sonars.line():
        return ""
    fit = Fit(sonars.rays)
    fit.add(echoes)
    return "" if fit.good or fit.taken + fit.refused < FEWEST else fit.line()
