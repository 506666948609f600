"""Where the encoders were at any recent instant, by interpolation between the states that were polled.

Rules: encoder poses only, in the encoders' own frame; no filter. Between two polls the robot is taken to have gone
evenly; beyond them nothing is made up.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from localization.belief import HEADING, Floats, add, difference, wrapped
from localization.motion import step_between

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

    def add(self, pose: EncoderPose) -> None:
        """A pose later than all others; the oldest are forgotten."""
        self._poses.append(pose)
        while len(self._poses) > 2 and self._poses[1].clock_s < pose.clock_s - REMEMBERED_S:
            self._poses.popleft()

    @property
    def latest(self) -> EncoderPose:
        """The last one added."""
        return self._poses[-1]

    @property
    def rates(self) -> Floats:
        """How fast it went between the last two poses, (2,): in/s along the heading, and rad/s; of one pose 0."""
        if len(self._poses) < 2:
            return np.zeros(2)
        before, after = self._poses[-2], self._poses[-1]
        rates: Floats = step_between(before.pose, after.pose) / (after.clock_s - before.clock_s)
        return rates

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
