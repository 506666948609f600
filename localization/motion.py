"""How the robot moves, and how far a move may differ from what the encoders say.

Rules: pure functions on arrays; no clock (a step is a distance and a turn, whatever time it took), no sensors.
A step is an array (..., 2): drho_in, the distance rolled (negative backwards), and dtheta_rad, the turn made
meanwhile. One step is the thesis' x += T v cos(theta + w T / 2), y += T v sin(theta + w T / 2), theta += T w
with drho = T v and dtheta = T w.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from localization.belief import HEADING, Floats, add, difference


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """How the true step strays from the encoders', a random walk: variances grow with the distance.

    var(drho) = translation_std^2 |drho|, var(dtheta) = rotation_std^2 |dtheta| + drift_std^2 |drho|, so that
    `translation_std` is the inches lost in one inch, `rotation_std` the radians in one radian, `drift_std` the
    radians in one inch.
    """

    translation_std: float = 0.1
    rotation_std: float = 0.1
    drift_std: float = 0.005


def step_variance(step: Floats, noise: OdometryNoise) -> Floats:
    """Variances (..., 2) of drho (in^2) and dtheta (rad^2) for steps (..., 2)."""
    length = np.abs(step)
    variance: Floats = length * (noise.translation_std**2, noise.rotation_std**2)
    variance[..., 1] += noise.drift_std**2 * length[..., 0]
    return variance


def move(pose: Floats, step: Floats) -> Floats:
    """Where poses (..., 3) are after steps (..., 2): straight along the heading half-way through the turn."""
    drho, dtheta = step[..., 0], step[..., 1]
    middle = pose[..., HEADING] + 0.5 * dtheta
    change = np.empty((*middle.shape, 3))
    change[..., 0] = drho * np.cos(middle)
    change[..., 1] = drho * np.sin(middle)
    change[..., 2] = dtheta
    return add(pose, change)


def move_jacobians(pose: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Derivatives of `move` by the pose, F (..., 3, 3), and by the step, G (..., 3, 2)."""
    drho = step[..., 0]
    middle = pose[..., HEADING] + 0.5 * step[..., 1]
    cos, sin = np.cos(middle), np.sin(middle)
    by_pose = np.zeros((*middle.shape, 3, 3))
    by_pose[..., (0, 1, 2), (0, 1, 2)] = 1.0
    by_pose[..., 0, 2] = -drho * sin
    by_pose[..., 1, 2] = drho * cos
    by_step = np.zeros((*middle.shape, 3, 2))
    by_step[..., 0, 0] = cos
    by_step[..., 1, 0] = sin
    by_step[..., :2, 1] = 0.5 * by_pose[..., :2, 2]
    by_step[..., 2, 1] = 1.0
    return by_pose, by_step


def transition(pose: Floats, step: Floats, noise: OdometryNoise) -> tuple[Floats, Floats]:
    """What a step does to a small error: F (..., 3, 3) and the covariance Q (..., 3, 3) that it adds.

    Q = G diag(var(step)) G' is of rank 2, two noises in three coordinates: it cannot be inverted.
    """
    by_pose, by_step = move_jacobians(pose, step)
    scaled = by_step * step_variance(step, noise)[..., None, :]
    return by_pose, scaled @ np.swapaxes(by_step, -1, -2)


def step_between(before: Floats, after: Floats) -> Floats:
    """The step (..., 2) that leads from one encoder pose (..., 3) to another: the inverse of `move`.

    drho is the part of the chord along the middle heading, with its sign; what lies across it, which no single
    step can make, is left out, so poses must be read often enough for one arc to describe the way between them.
    """
    change = difference(after, before)
    middle = before[..., HEADING] + 0.5 * change[..., HEADING]
    along = change[..., 0] * np.cos(middle) + change[..., 1] * np.sin(middle)
    return np.stack([along, change[..., HEADING]], axis=-1)
