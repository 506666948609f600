"""How far a turn in place by so much still has to go, however often around.

Rules: pure; headings of the estimate in, what is left out. What was turned is added up from one to the next, which are
less than half a turn apart; so it holds over tries, and a robot that was lost ends in the same heading all the same.
"""

from __future__ import annotations

from localization.planning.course import turn_between


class Turning:
    """A turn from a heading, by so much to the left."""

    def __init__(self, heading_rad: float, by_rad: float) -> None:
        self._heading_rad, self._left_rad = heading_rad, by_rad

    def left_rad(self, heading_rad: float) -> float:
        """What is left of it at this heading, to the left."""
        self._left_rad -= turn_between(self._heading_rad, heading_rad)
        self._heading_rad = heading_rad
        return self._left_rad
