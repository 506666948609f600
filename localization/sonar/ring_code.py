"""A ring judged at once by machine code, where numba is there and somebody asks for it: gating.observe then uses it.

    ring_code.load()        some seconds: numba is imported, and the loop below compiled

Written as plain loops, so that numba can compile it: the same lines are tested as they stand. Results are gating's
within rounding, not to the bit (arrays round some products once, loops twice): so nothing loads it by itself.
"""

from __future__ import annotations

from collections.abc import Callable
from math import cos, inf, sin, sqrt
from typing import Final, cast

import numpy as np
import numpy.typing as npt

from localization.estimation.belief import Floats
from localization.estimation.observation import Codes, Refusal
from worlds import ray
from worlds.ray import meeting_before

Loop = Callable[..., None]

NONE, LIMIT, NO_WALL = Refusal.NONE.value, Refusal.LIMIT.value, Refusal.NO_WALL.value
AMBIGUOUS_WALL, GRAZING, GATE = Refusal.AMBIGUOUS_WALL.value, Refusal.GRAZING.value, Refusal.GATE.value


class RingCode:
    """`run` is `judge_ring` as machine code, or None as long as that is not loaded."""

    def __init__(self) -> None:
        self.run: Loop | None = None

    def load(self) -> bool:
        """Compile it, once; returns whether there is machine code."""
        if self.run is None:
            try:
                import numba
                import numba.extending
            except ImportError:
                return False
            for helper in (ray.meeting, ray.meeting_before, first_row, sideways, meets_another, spread):
                numba.extending.register_jitable(helper)
            self.run = cast(Loop, numba.njit(judge_ring))
        return self.run is not None


RING: Final = RingCode()
"""The one of this process."""


def load() -> bool:
    """Have machine code from now on; False where numba is not installed."""
    return RING.load()


def first_row(x: float, y: float, dx: float, dy: float, walls: Floats) -> int:
    """The first wall (m, 4) that a ray meets; m for none."""
    nearest, hit = inf, len(walls)
    for row in range(len(walls)):
        met = meeting_before(nearest, x, y, dx, dy, walls[row, 0], walls[row, 1], walls[row, 2], walls[row, 3])
        if met < nearest:
            nearest, hit = met, row
    return hit


def sideways(cov: Floats, dx: float, dy: float, side: float, sigmas: float) -> tuple[float, float, float]:
    """The pose's error of `sigmas` that carries a beam (dx, dy) farthest aside where it meets the wall: see gating."""
    pull_x = cov[0, 2] * side - cov[0, 0] * dy + cov[0, 1] * dx
    pull_y = cov[1, 2] * side - cov[1, 0] * dy + cov[1, 1] * dx
    pull_t = cov[2, 2] * side - cov[2, 0] * dy + cov[2, 1] * dx
    aside = pull_t * side - pull_x * dy + pull_y * dx
    share = sigmas / sqrt(aside) if aside > 0.0 else 0.0
    return share * pull_x, share * pull_y, share * pull_t


def meets_another(
    row: int, pose: Floats, pull: tuple[float, float, float], beam: tuple[float, float, float, float], walls: Floats
) -> bool:
    """Whether a beam (arm, direction) meets another wall than `row` from the poses `pull` to either side."""
    arm_x, arm_y, dx, dy = beam
    for sign in (1.0, -1.0):
        turn_x, turn_y = cos(sign * pull[2]), sin(sign * pull[2])
        from_x = pose[0] + sign * pull[0] + turn_x * arm_x - turn_y * arm_y
        from_y = pose[1] + sign * pull[1] + turn_y * arm_x + turn_x * arm_y
        if row != first_row(from_x, from_y, turn_x * dx - turn_y * dy, turn_y * dx + turn_x * dy, walls):
            return True
    return False


def spread(cov: Floats, by_x: float, by_y: float, by_t: float) -> float:
    """Variance of the expected range: h P h' for a row h of the Jacobian."""
    variance: float = (
        by_x * (by_x * cov[0, 0] + 2.0 * (by_y * cov[0, 1] + by_t * cov[0, 2]))
        + by_y * (by_y * cov[1, 1] + 2.0 * by_t * cov[1, 2])
        + by_t * by_t * cov[2, 2]
    )
    return variance


def judge_ring(
    pose: Floats,
    cov: Floats,
    axes: Floats,
    directions: Floats,
    standoff_in: float,
    walls: Floats,
    lines: Floats,
    gate: tuple[float, float, float],
    sonar: tuple[float, float, float, float, float],
    readings_in: Floats,
    innovation: Floats,
    jacobian: Floats,
    variance: Floats,
    refusals: Codes,
) -> None:
    """gating.observe of one belief (3,), (3, 3) and n beams; the last four, (n,), (n, 3), (n,), (n,), are filled.

    gate      sigmas, least cosine of incidence, largest squared innovation over its variance
    sonar     relative_std, floor_std_in, rounding_var_in2, lowest_in, highest_in
    """
    sigmas, least_cosine, threshold = gate
    relative_std, floor_std, rounding, lowest, highest = sonar
    cosine, sine = cos(pose[2]), sin(pose[2])
    for at in range(len(readings_in)):
        innovation[at], variance[at] = 0.0, 1.0
        jacobian[at, 0] = jacobian[at, 1] = jacobian[at, 2] = 0.0
        if not lowest < readings_in[at] < highest:
            refusals[at] = LIMIT
            continue
        arm_x = cosine * axes[at, 0] - sine * axes[at, 1]
        arm_y = sine * axes[at, 0] + cosine * axes[at, 1]
        dx = cosine * directions[at, 0] - sine * directions[at, 1]
        dy = sine * directions[at, 0] + cosine * directions[at, 1]
        row = first_row(pose[0] + arm_x, pose[1] + arm_y, dx, dy, walls)
        slant = lines[row, 0] * dx + lines[row, 1] * dy
        if slant == 0.0:
            refusals[at] = NO_WALL if row == len(walls) else AMBIGUOUS_WALL
            continue
        normal_x, normal_y = lines[row, 0], lines[row, 1]
        way = (lines[row, 2] - normal_x * (pose[0] + arm_x) - normal_y * (pose[1] + arm_y)) / slant
        point_x, point_y = arm_x + way * dx, arm_y + way * dy
        pull = sideways(cov, dx, dy, dx * point_x + dy * point_y, sigmas)
        if meets_another(row, pose, pull, (arm_x, arm_y, dx, dy), walls):
            refusals[at] = AMBIGUOUS_WALL
            continue
        if abs(slant) < least_cosine:
            refusals[at] = GRAZING
            continue
        by_x, by_y = -normal_x / slant, -normal_y / slant
        by_t = (normal_x * point_y - normal_y * point_x) / slant
        std = max(relative_std * (way - standoff_in), floor_std)
        off = readings_in[at] - (way - standoff_in)
        if not off * off <= threshold * (spread(cov, by_x, by_y, by_t) + std * std + rounding):
            refusals[at] = GATE
            continue
        refusals[at] = NONE
        innovation[at], variance[at] = off, std * std + rounding
        jacobian[at, 0], jacobian[at, 1], jacobian[at, 2] = by_x, by_y, by_t


def empty(count: int) -> tuple[Floats, Floats, Floats, npt.NDArray[np.int8]]:
    """What `judge_ring` fills, for so many beams."""
    return np.empty(count), np.empty((count, 3)), np.empty(count), np.empty(count, dtype=np.int8)
