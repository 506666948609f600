"""How far a robot may come within a span of time, and which way: by what it was told, before anything is driven. Pure.

A path of length s whose heading turns by no more than an angle a keeps within s a of the straight way, wherever on it
the robot is stopped. So towards something in the direction n it comes no nearer than by the straight way's share along
n, if that is positive, and what it may stray.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Reach(NamedTuple):
    """The straight ways to the farthest places ahead and behind, (dx, dy), and what may be added to them, inches."""

    ahead_x: float
    ahead_y: float
    behind_x: float
    behind_y: float
    stray_in: float

    def towards(self, x: float, y: float) -> float:
        """No less than it comes nearer to what lies far away in a direction, a unit vector."""
        ahead, behind = self.ahead_x * x + self.ahead_y * y, self.behind_x * x + self.behind_y * y
        return max(ahead, behind, 0.0) + self.stray_in


STAYS: Final = Reach(0.0, 0.0, 0.0, 0.0, 0.0)
"""It goes nowhere."""
