"""How the robot moves, and how far a move may differ from what the encoders say.

Rules: pure functions on arrays; no clock (a step is a distance and a turn, whatever time it took), no sensors.
A step is an array (..., 2): drho_in, the distance rolled (negative backwards), and dtheta_rad, the turn made
meanwhile. One step is the thesis' x += T v cos(theta + w T / 2), y += T v sin(theta + w T / 2), theta += T w
with drho = T v and dtheta = T w. For a single robot the same is done in plain numbers: an array of three is slower.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Final, NamedTuple

import numpy as np

from localization.estimation.belief import HEADING, Floats, add, difference, part, wrapped

_IDENTITY: Final = np.eye(3)


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """How the true step strays from the encoders', a random walk: variances grow with the distance.

    var(drho) = translation_std^2 |drho|, var(dtheta) = rotation_std^2 |dtheta| + drift_std^2 |drho|, so that
    `translation_std` is the standard deviation in inches after one inch (in/sqrt(in)), `rotation_std` in radians after
    one radian (rad/sqrt(rad)), `drift_std` in radians after one inch (rad/sqrt(in)).
    """

    translation_std: float = 0.1
    rotation_std: float = 0.1
    drift_std: float = 0.005


class Transition(NamedTuple):
    """What a step does to a pose and to a small error of it.

    `pose` (..., 3), where it leads; `by_pose` (..., 3, 3), F, the derivative of that by the pose it began at;
    `process_cov` (..., 3, 3), Q, the covariance the step adds. Q has rank 2, two noises in three coordinates: it cannot
    be inverted.
    """

    pose: Floats
    by_pose: Floats
    process_cov: Floats


def step_variance(step: Floats, noise: OdometryNoise) -> Floats:
    """Variances (..., 2) of drho (in^2) and dtheta (rad^2) for steps (..., 2)."""
    rolled, turned = abs(part(step, 0)), abs(part(step, 1))
    variance = np.empty(step.shape)
    variance[..., 0] = noise.translation_std**2 * rolled
    variance[..., 1] = noise.drift_std**2 * rolled + noise.rotation_std**2 * turned
    return variance


def move(pose: Floats, step: Floats) -> Floats:
    """Where poses (..., 3) are after steps (..., 2): straight along the heading half-way through the turn."""
    if pose.ndim == step.ndim == 1:
        return np.array(moved(*pose.tolist(), *step.tolist()))
    return _moved(pose, step, _ahead(pose, part(step, 1)))


def moved(x_in: float, y_in: float, heading_rad: float, way_in: float, turn_rad: float) -> tuple[float, float, float]:
    """`move` of one pose, in numbers."""
    middle = heading_rad + 0.5 * turn_rad
    return x_in + way_in * cos(middle), y_in + way_in * sin(middle), wrapped(heading_rad + turn_rad)


def transition(pose: Floats, step: Floats, noise: OdometryNoise) -> Transition:
    """`move` with its derivatives at poses (..., 3) and steps (..., 2).

    Q = G diag(step_variance) G' with G (..., 3, 2), the derivative by the step.
    """
    by_pose, by_step = step_jacobian(pose, step)
    by_step *= np.sqrt(step_variance(step, noise))[..., None, :]
    return Transition(move(pose, step), by_pose, by_step @ by_step.swapaxes(-1, -2))


def carried(mean: Floats, cov: Floats, step: Floats, noise: OdometryNoise) -> tuple[Floats, Floats]:
    """A pose (3,) and its covariance (3, 3) after a step (2,): `transition`'s pose and F P F' + Q, in numbers.

    F differs from the identity by (a, b) above its heading's 1, the derivative of x and y by the heading; Q's columns
    are (cos, sin, 0) and (a / 2, b / 2, 1), the derivatives by way and turn.
    """
    x, y, heading = mean.tolist()
    (xx, xy, xt), (_, yy, yt), (_, _, tt) = cov.tolist()
    way, turn = step.tolist()
    middle = heading + 0.5 * turn
    ahead_x, ahead_y = cos(middle), sin(middle)
    a, b = -way * ahead_y, way * ahead_x
    along = noise.translation_std**2 * abs(way)
    about = noise.drift_std**2 * abs(way) + noise.rotation_std**2 * abs(turn)
    to_x, to_y = xt + a * tt, yt + b * tt
    half_a, half_b = 0.5 * a * about, 0.5 * b * about
    new_xy = xy + a * yt + b * to_x + along * ahead_x * ahead_y + half_a * 0.5 * b
    new_xt, new_yt = to_x + half_a, to_y + half_b
    new_xx = xx + a * (xt + to_x) + along * ahead_x * ahead_x + half_a * 0.5 * a
    new_yy = yy + b * (yt + to_y) + along * ahead_y * ahead_y + half_b * 0.5 * b
    return (
        np.array((x + way * ahead_x, y + way * ahead_y, wrapped(heading + turn))),
        np.array(((new_xx, new_xy, new_xt), (new_xy, new_yy, new_yt), (new_xt, new_yt, tt + about))),
    )


def step_jacobian(pose: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Derivatives of `move` at poses (..., 3) and steps (..., 2): by the pose (..., 3, 3), by the step (..., 3, 2)."""
    ahead = _ahead(pose, part(step, 1))
    drho = part(step, 0)
    by_heading = drho * -part(ahead, 1), drho * part(ahead, 0)
    by_pose = np.zeros((*ahead.shape[:-1], 3, 3))
    by_pose[...] = _IDENTITY
    by_pose[..., 0, 2], by_pose[..., 1, 2] = by_heading
    by_step = np.zeros((*ahead.shape[:-1], 3, 2))
    by_step[..., :2, 0] = ahead
    by_step[..., 0, 1], by_step[..., 1, 1] = 0.5 * by_heading[0], 0.5 * by_heading[1]
    by_step[..., 2, 1] = 1.0
    return by_pose, by_step


def step_between(before: Floats, after: Floats) -> Floats:
    """The step (..., 2) that leads from one encoder pose (..., 3) to another: the inverse of `move`.

    drho is the part of the chord along the middle heading, with its sign; what lies across it, which no single
    step can make, is left out, so poses must be read often enough for one arc to describe the way between them.
    """
    if before.ndim == after.ndim == 1:
        (x, y, heading), (to_x, to_y, to_heading) = before.tolist(), after.tolist()
        turned = wrapped(to_heading - heading)
        middle = heading + 0.5 * turned
        return np.array([(to_x - x) * cos(middle) + (to_y - y) * sin(middle), turned])
    change = difference(after, before)
    turn = part(change, HEADING)
    ahead = _ahead(before, turn)
    along = part(change, 0) * part(ahead, 0) + part(change, 1) * part(ahead, 1)
    return np.stack([along, turn], axis=-1)


def _ahead(pose: Floats, turn: Floats) -> Floats:
    """The unit vector (..., 2) along the heading of poses (..., 3) half-way through turns (...)."""
    middle = part(pose, HEADING) + 0.5 * turn
    ahead = np.empty((*middle.shape, 2))
    ahead[..., 0] = np.cos(middle)
    ahead[..., 1] = np.sin(middle)
    return ahead


def _moved(pose: Floats, step: Floats, ahead: Floats) -> Floats:
    change = np.empty((*ahead.shape[:-1], 3))
    change[..., :2] = step[..., :1] * ahead
    change[..., 2] = step[..., 1]
    return add(pose, change)
