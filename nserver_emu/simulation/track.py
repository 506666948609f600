"""Where a robot came along: the pieces of its way, each a stretch from an instant and a place on. Pure."""

from __future__ import annotations

from typing import NamedTuple

from nserver_emu.simulation.stretch import Stretch


class Leg(NamedTuple):
    """A piece of a robot's track: from this instant and place along this stretch, for so long; then it stood."""

    begin_ps: int
    x_in: float
    y_in: float
    heading_rad: float
    stretch: Stretch
    free_s: float

    def place(self, time_s: float) -> tuple[float, float]:
        """(x, y) in inches, so long after its beginning; before that, where it begins."""
        _, x, y, heading, stretch, free_s = self
        if time_s <= 0.0:
            return x, y
        dx, dy = stretch.displacement(heading, time_s if time_s < free_s else free_s)
        return x + dx, y + dy
