"""The control law of the thesis: from an estimated pose to the next small step towards a goal.

All functions accept arrays with leading dimensions; numba compiles `step_to` for floats. In the batch experiments the
limits are inches and radians per step; in live runs a step is made every T seconds, so a limit divided by T is a speed.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from localization.filters.belief import HEADING, POSE, Floats, Number, atan2, clip, hypot, wrap_angle


@dataclass(frozen=True, slots=True)
class ControlGains:
    """Limits of one step and the fraction of the error that one step corrects.

    Attributes
    ----------
    drho_max_in, dtheta_max_rad
        Longest step (in) and largest turn (rad).
    alpha_rho, alpha_theta
        Proportional gains of distance and bearing error, 0 to 1.
    """

    drho_max_in: float = 0.05
    dtheta_max_rad: float = 0.05
    alpha_rho: float = 0.1
    alpha_theta: float = 0.1


def distance_to(pose: Floats, goal: Floats) -> Floats:
    """Return the distance (...) in inches from poses (..., 3) to goals (..., 2)."""
    return np.hypot(goal[..., 0] - pose[..., 0], goal[..., 1] - pose[..., 1])


def is_reached(pose: Floats, goal: Floats, radius_in: float) -> npt.NDArray[np.bool_]:
    """Return True (...) where poses (..., 3) are within `radius_in` of their goals (..., 2)."""
    return distance_to(pose, goal) <= radius_in


def bearing_error(pose: Floats, goal: Floats) -> Floats:
    """Return the angle (...) in [-pi, pi] from the heading of poses (..., 3) to the direction of goals (..., 2)."""
    direction = np.arctan2(goal[..., 1] - pose[..., 1], goal[..., 0] - pose[..., 0])
    return wrap_angle(direction - pose[..., HEADING])


def step_to(
    x: Number, y: Number, heading: Number, goal_x: Number, goal_y: Number, gains: ControlGains
) -> tuple[Number, Number]:
    """Return drho and dtheta of `next_step`."""
    distance = hypot(goal_x - x, goal_y - y)
    delta = wrap_angle(atan2(goal_y - y, goal_x - x) - heading)
    return (
        clip(gains.alpha_rho * distance, 0.0, gains.drho_max_in),
        clip(gains.alpha_theta * delta, -gains.dtheta_max_rad, gains.dtheta_max_rad),
    )


def next_step(pose: Floats, goal: Floats, gains: ControlGains) -> Floats:
    """Return the commanded step towards a goal.

    The robot keeps rolling at full length even when the goal lies behind it: it then turns on a circle of radius
    drho_max / dtheta_max.

    Parameters
    ----------
    pose : (..., 3) array
        x, y in inches, heading in radians.
    goal : (..., 2) array
        x, y in inches.
    gains : ControlGains

    Returns
    -------
    (..., 2) array
        drho in inches and dtheta in radians, with the bearing error delta:
        drho = min(drho_max, alpha_rho distance), dtheta = sign(delta) min(dtheta_max, alpha_theta abs(delta)).
    """
    x, y, heading = (pose[..., index] for index in range(POSE))
    return np.stack(np.broadcast_arrays(*step_to(x, y, heading, goal[..., 0], goal[..., 1], gains)), axis=-1)


def slow_for_turn(step: Floats, pose: Floats, goal: Floats, gains: ControlGains) -> Floats:
    """Return a step towards a goal that is shortened until the robot's turning circle reaches the goal.

    A goal inside the smallest circle of `next_step` is never reached: the robot drives around it, up to two radii
    beside the straight line. A goal aside is approached with the component of the step towards it, so that the arc
    stays near the straight line, on which the map is free; a goal behind the robot is turned to on the spot.

    Parameters
    ----------
    step : (..., 2) array
        drho in inches and dtheta in radians, of `next_step`.
    pose : (..., 3) array
        x, y in inches, heading in radians.
    goal : (..., 2) array
        x, y in inches.
    gains : ControlGains

    Returns
    -------
    (..., 2) array
        The arc from the pose through a goal at the distance d and the bearing error delta has the radius
        d / (2 sin abs(delta)): drho is at most dtheta_max times this, and at most cos(delta) times that of the step; 0
        where abs(delta) is 90 degrees or more.
    """
    delta = np.abs(bearing_error(pose, goal))
    with np.errstate(divide="ignore"):
        longest = gains.dtheta_max_rad * distance_to(pose, goal) / (2.0 * np.sin(delta))
    towards = np.maximum(step[..., 0] * np.cos(delta), 0.0)
    return np.stack((np.minimum(towards, longest), step[..., 1]), axis=-1)
