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

from localization.belief import HEADING, Belief, Floats
from localization.echoes import CLOCK_STEP_S
from localization.systematic import POSE

LAG_STD_S: Final = CLOCK_STEP_S / sqrt(6.0)
"""The difference of two instants, each anywhere within one step of the clock."""


def with_lag(belief: Belief, rates: Floats) -> Belief:
    """A belief over states (n,) of a robot that drives at `rates` (2,), in/s and rad/s, widened by that."""
    heading = float(belief.mean[HEADING])
    ahead = LAG_STD_S * np.array([rates[0] * cos(heading), rates[0] * sin(heading), rates[1]])
    cov = belief.cov.copy()
    cov[:POSE, :POSE] += np.outer(ahead, ahead)
    return Belief(belief.mean, cov)
