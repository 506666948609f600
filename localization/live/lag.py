"""What a clock in steps leaves unknown where readings have no stamps: when they were taken, against when the robot was
where its states say.

    the ring was restarted up to a step later than the clock of its answer tells, and a state is of up to a step later
    than its own: echoes are laid to where the robot was too early or too late, and the estimate is ahead or behind

    P + LAG_STD_S^2 xdot xdot'        xdot = (v cos(heading), v sin(heading), omega)

The first of the two is the same for a whole run, so a filter cannot average it away: this is no noise of the echoes. It
is added to what is told, and never to what the filter goes on from. Rules: pure.
"""

from __future__ import annotations

from math import cos, sin, sqrt
from typing import Final

import numpy as np

from localization.estimation.belief import HEADING, Belief, difference
from localization.estimation.systematic import POSE
from localization.live.echoes import CLOCK_STEP_S
from localization.live.odometry import EncoderPose

LAG_STD_S: Final = CLOCK_STEP_S / sqrt(6.0)
"""The difference of two instants, each anywhere within one step of the clock."""


def with_lag(belief: Belief, before: EncoderPose, now: EncoderPose) -> Belief:
    """A belief over states (n,) of a robot whose encoders went from one pose to the other, widened by that; the belief
    itself where it stood."""
    passed_s = now.clock_s - before.clock_s
    dx, dy, turn = difference(now.pose, before.pose).tolist()
    if passed_s <= 0.0 or not (dx or dy or turn):
        return belief
    told, heading = float(before.pose[HEADING]) + 0.5 * turn, float(belief.mean[HEADING])
    way = LAG_STD_S * (dx * cos(told) + dy * sin(told)) / passed_s
    ahead = np.array([way * cos(heading), way * sin(heading), LAG_STD_S * turn / passed_s])
    cov = belief.cov.copy()
    cov[:POSE, :POSE] += ahead[:, None] * ahead
    return Belief(belief.mean, cov)
