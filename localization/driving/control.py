"""The thesis' control law: from where the robot believes it is to the next small step towards a goal.

Rules: pure functions; no clock, no robot, no filter. In the experiments the limits are inches and radians a step;
live, at a step every T seconds, limit / T is a speed. Which pose is handed in (estimate or odometry) is the caller's.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, Floats, wrap_angle


@dataclass(frozen=True, slots=True)
class Gains:
    """Limits of one step (`drho_max_in`, `dtheta_max_rad`) and the share of the error one step corrects."""

    drho_max_in: float = 0.05
    dtheta_max_rad: float = 0.05
    alpha_rho: float = 0.1
    alpha_theta: float = 0.1


def distance_to(pose: Floats, goal: Floats) -> Floats:
    """Inches (...) from poses (..., 3) to goals (..., 2) in inches."""
    distance: Floats = np.hypot(goal[..., 0] - pose[..., 0], goal[..., 1] - pose[..., 1])
    return distance


def reached(pose: Floats, goal: Floats, radius_in: float) -> npt.NDArray[np.bool_]:
    """Whether poses (..., 3) are within `radius_in` of their goals (..., 2)."""
    within: npt.NDArray[np.bool_] = distance_to(pose, goal) <= radius_in
    return within


def bearing_error(pose: Floats, goal: Floats) -> Floats:
    """Radians (...) in [-pi, pi] from the heading of poses (..., 3) to the direction of goals (..., 2)."""
    direction = np.arctan2(goal[..., 1] - pose[..., 1], goal[..., 0] - pose[..., 0])
    return wrap_angle(direction - pose[..., HEADING])


def next_step(pose: Floats, goal: Floats, gains: Gains) -> Floats:
    """The step (..., 2) of drho_in and dtheta_rad to command at poses (..., 3) towards goals (..., 2).

    drho = min(drho_max, alpha_rho distance), dtheta = sign(delta) min(dtheta_max, alpha_theta |delta|) with delta
    the bearing error. The law rolls at full length even when the goal lies behind: it turns on a circle of radius
    drho_max / dtheta_max.
    """
    delta = bearing_error(pose, goal)
    step = np.empty((*delta.shape, 2))
    step[..., 0] = np.minimum(gains.drho_max_in, gains.alpha_rho * distance_to(pose, goal))
    step[..., 1] = np.clip(gains.alpha_theta * delta, -gains.dtheta_max_rad, gains.dtheta_max_rad)
    return step
