"""Where the encoders were at any recent instant, by interpolation between the states that were polled.

Rules: encoder poses only, in the encoders' own frame; no filter. Between two polls the robot is taken to have gone
evenly; beyond them nothing is made up.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from localization.estimation.belief import HEADING, Floats, add, difference, wrapped

LONGEST_GAP_S = 0.5
"""Beyond this the way between two states is no single arc any more, and the estimate gets too sure of itself."""
REMEMBERED_S = 2.0
"""Longer than a ring takes, so that every echo still readable has its pose."""


class EncoderPose(NamedTuple):
    """The encoders at an instant: `pose` (3,) x_in, y_in, heading of the steering; the turret's angle beside it."""

    clock_s: float
    pose: Floats
    turret_rad: float

    @property
    def turret_offset_rad(self) -> float:
        """Turret less steering: where the ring's front looks, seen from the heading."""
        return self.turret_rad - float(self.pose[HEADING])


class PoseHistory:
    """The encoder poses of the last seconds."""

    def __init__(self) -> None:
        self._poses: deque[EncoderPose] = deque()

    @property
    def last_two(self) -> tuple[EncoderPose, EncoderPose]:
        """The last one added and the one before it; of one alone it is both."""
        return self._poses[max(len(self._poses) - 2, 0)], self._poses[-1]

    def add(self, pose: EncoderPose) -> None:
        """A pose later than all others; the oldest are forgotten."""
        self._poses.append(pose)
        while len(self._poses) > 2 and self._poses[1].clock_s < pose.clock_s - REMEMBERED_S:
            self._poses.popleft()

    @property
    def latest(self) -> EncoderPose:
        """The last one added."""
        return self._poses[-1]

    def at(self, instant_s: float) -> EncoderPose:
        """The pose at an instant; the nearest there is where it lies before or after all of them."""
        later = None
        for earlier in reversed(self._poses):
            if earlier.clock_s < instant_s:
                return earlier._replace(clock_s=instant_s) if later is None else _between(earlier, later, instant_s)
            later = earlier
        return self._poses[0]._replace(clock_s=instant_s)


def _between(earlier: EncoderPose, later: EncoderPose, instant_s: float) -> EncoderPose:
    share = (instant_s - earlier.clock_s) / (later.clock_s - earlier.clock_s)
    turned = wrapped(later.turret_rad - earlier.turret_rad)
    pose = add(earlier.pose, share * difference(later.pose, earlier.pose))
    return EncoderPose(instant_s, pose, earlier.turret_rad + share * turned)
