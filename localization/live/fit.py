"""Whether readings fit what a filter was told of its robot: NIS and refusals, summed over a run.

    NIS        mean of innovation^2 / its variance of the readings taken in: 1 is right
    refused    share of the ranges that the gate refused

A filter that is told too little noise believes its own wrong numbers, and its standard deviations say nothing of it;
its readings do. Rules: values and words.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from localization.estimation.observation import Refusal
from localization.live.localizer import Echo

LARGEST_NIS: Final = 1.5
MOST_REFUSED: Final = {True: 0.1, False: 0.35}
"""By whether sonars are exact rays; of a real ring's readings many are bad anyway."""


@dataclass
class Fit:
    """The sums. `rays`: sonars are taken for exact rays."""

    rays: bool
    taken: int = 0
    refused: int = 0
    nis_sum: float = 0.0

    def add(self, echoes: Iterable[Echo]) -> None:
        """Echoes of another period."""
        for echo in echoes:
            if echo.refusal is Refusal.NONE:
                self.taken += 1
                self.nis_sum += echo.nis
            elif echo.refusal is Refusal.GATE:
                self.refused += 1

    @property
    def nis(self) -> float:
        """The mean of those taken in; 0 of none."""
        return self.nis_sum / self.taken if self.taken else 0.0

    @property
    def refused_share(self) -> float:
        """Of those taken in or refused by the gate; 0 of none."""
        return self.refused / (self.taken + self.refused) if self.refused else 0.0

    @property
    def good(self) -> bool:
        """Whether what was found can be believed as far as it says."""
        return self.nis <= LARGEST_NIS and self.refused_share <= MOST_REFUSED[self.rays]

    def line(self) -> str:
        """In words, with the remedy where it is not good."""
        told = f"readings fit with a NIS of {self.nis:.2f} (1 is right), {self.refused_share:.1%} refused"
        if self.good:
            return told
        ring = "a real ring's cones are taken for rays (--sonars cones), " if self.rays else ""
        return (
            f"{told}: do not believe this. The encoders miss more than --odometry-noise says, {ring}--start is "
            "elsewhere, or the map is not of this room"
        )
