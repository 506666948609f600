"""The odometry motion model, and the prediction step of the Kalman filter.

    u    (distance_in, turn_rad)      the step that the encoders report: inches rolled, radians turned
    x'   = f(x, u)                    straight along the heading half-way through the turn
    P'   = F P F' + G Q G'            F = df/dx, G = df/du, Q the variances of the step

A state is a pose and as many odometry parameters as its n has room for, in this order; n = 3 is the pose alone:

    3  distance_scale    the robot rolls (1 + distance_scale) times the reported distance
    4  turn_scale        and turns (1 + turn_scale) times the reported turn
    5  drift             plus drift times the reported distance, rad/in: wheels of a synchro drive that are not parallel

Parameters are constants: the prediction adds no noise to them. One that is known gets a standard deviation of 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

import numpy as np

from localization.filters.belief import (
    HEADING,
    POSE,
    Belief,
    Floats,
    Number,
    add,
    component,
    cos,
    pack,
    sin,
    unpack,
    wrap_angle,
)


class OdometryParameter(IntEnum):
    """Index of each odometry parameter in a state."""

    DISTANCE_SCALE = 3
    TURN_SCALE = 4
    DRIFT = 5


MAX_STATE: Final = POSE + len(OdometryParameter)
"""Coordinates of a pose with all odometry parameters."""

_SCALE, _TURN_SCALE, _DRIFT = (int(parameter) for parameter in OdometryParameter)

Columns = list[tuple[int, tuple[Any, Any, Any]]]
"""Columns of a matrix (3, n): the index of each, and its three elements."""


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Variance of a true step about the reported one: a random walk, so variances grow with the distance.

    Attributes
    ----------
    translation_std
        Standard deviation of the distance after one inch, in / sqrt(in).
    rotation_std
        Standard deviation of the turn after one radian, rad / sqrt(rad).
    drift_std
        Standard deviation of the turn after one inch, rad / sqrt(in).
    """

    translation_std: float = 0.1
    rotation_std: float = 0.1
    drift_std: float = 0.005


def process_variance(distance: Number, turn: Number, noise: OdometryNoise) -> tuple[Number, Number]:
    """Return the diagonal of Q: the variances of a step's distance (in^2) and turn (rad^2)."""
    return (
        noise.translation_std**2 * abs(distance),
        noise.drift_std**2 * abs(distance) + noise.rotation_std**2 * abs(turn),
    )


def true_step(x: Sequence[Number], distance: Number, turn: Number) -> tuple[Number, Number]:
    """Return the step (distance, turn) that the odometry parameters of state x make of the reported one."""
    n = len(x)
    true_distance, true_turn = distance, turn
    if n > _SCALE:
        true_distance = distance * (1.0 + x[_SCALE])
    if n > _TURN_SCALE:
        true_turn = turn * (1.0 + x[_TURN_SCALE])
    if n > _DRIFT:
        true_turn = true_turn + x[_DRIFT] * distance
    return true_distance, true_turn


def jacobians(x: Sequence[Number], distance: Number, turn: Number) -> tuple[Number, Number, Columns, Columns]:
    """Return the true step, and the derivatives of the motion model at x.

    Returns
    -------
    tuple
        The true distance and turn; the columns of F - I by which the pose depends on the heading and the odometry
        parameters; and the two columns of G, the derivative of the pose by the true step.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 7.4: G_t and V_t, here for the odometry of section 5.4.
    """
    n = len(x)
    d, t = true_step(x, distance, turn)
    middle = x[HEADING] + 0.5 * t
    c, s = cos(middle), sin(middle)
    # 1. G: the pose by the distance and by the turn.
    by_distance, by_turn = (c, s, 0.0), (-0.5 * d * s, 0.5 * d * c, 1.0)
    # 2. F - I: the pose by the heading, and by each parameter, which acts through the true step.
    F: Columns = [(HEADING, (-d * s, d * c, 0.0))]
    if n > _SCALE:
        F.append((_SCALE, (distance * by_distance[0], distance * by_distance[1], distance * by_distance[2])))
    if n > _TURN_SCALE:
        F.append((_TURN_SCALE, (turn * by_turn[0], turn * by_turn[1], turn * by_turn[2])))
    if n > _DRIFT:
        F.append((_DRIFT, (distance * by_turn[0], distance * by_turn[1], distance * by_turn[2])))
    return d, t, F, [(0, by_distance), (1, by_turn)]


def predict_state(x: list[Number], P: list[list[Number]], distance: Number, turn: Number, noise: OdometryNoise) -> None:
    """Predict x and P after a step that the encoders report, in place: the prediction step of the Kalman filter.

    Parameters
    ----------
    x, P
        State of n elements and covariance of n rows, see `belief.unpack`. Coordinates from MAX_STATE on stay.
    distance, turn
        The reported step, inches and radians.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 3.3, lines 2 and 3; the random walk of `OdometryNoise`
    instead of table 5.6.
    """
    n = len(x)
    # 1. The motion model and its derivatives.
    d, t, F, G = jacobians(x, distance, turn)
    (_, g), (_, h) = G
    q_distance, q_turn = process_variance(distance, turn, noise)
    # 2. x' = f(x, u).
    x[0] = x[0] + d * g[0]
    x[1] = x[1] + d * g[1]
    x[HEADING] = wrap_angle(x[HEADING] + t)
    # 3. P <- F P. F is the identity but for the rows of the pose. The heading comes first among its columns and has
    #    nothing in its own row, so every row on the right is still the old one.
    of_x, of_y, of_heading = P[:POSE]
    for k, (f_x, f_y, f_heading) in F:
        for j, value in enumerate(P[k]):
            of_x[j] = of_x[j] + f_x * value
            of_y[j] = of_y[j] + f_y * value
            if k != HEADING:
                of_heading[j] = of_heading[j] + f_heading * value
    # 4. P <- P F' in the rows of the pose.
    for row in P[:POSE]:
        for k, (f_x, f_y, f_heading) in F:
            value = row[k]
            row[0] = row[0] + f_x * value
            row[1] = row[1] + f_y * value
            if k != HEADING:
                row[2] = row[2] + f_heading * value
    # 5. P <- P + G Q G' in its upper half; the lower half by symmetry.
    for i in range(POSE):
        row, along, about = P[i], q_distance * g[i], q_turn * h[i]
        for j in range(i, POSE):
            row[j] = P[j][i] = row[j] + along * g[j] + about * h[j]
        for j in range(POSE, n):
            P[j][i] = row[j]


def predict(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """Return the belief over states (..., n), 3 <= n <= MAX_STATE, after steps (..., 2) that the encoders report.

    Raises
    ------
    ValueError
        A state of another size.
    """
    n = belief.mean.shape[-1]
    if not POSE <= n <= MAX_STATE:
        raise ValueError(f"a state has {POSE} to {MAX_STATE} coordinates, not {n}")
    x, P = unpack(belief)
    predict_state(x, P, *_components(step), noise)
    return pack(x, P)


def move(states: Floats, step: Floats) -> Floats:
    """Return states (..., n) after steps (..., 2) that the encoders report; parameters stay.

    References
    ----------
    The thesis' x += T v cos(theta + w T / 2), y += T v sin(theta + w T / 2), theta += T w, with distance = T v and
    turn = T w.
    """
    distance, turn = _components(step)
    d, t = true_step([component(states, index) for index in range(states.shape[-1])], distance, turn)
    middle = component(states, HEADING) + 0.5 * t
    after = np.broadcast_to(states, np.broadcast_shapes(states.shape, (*step.shape[:-1], 1))).copy()
    after[..., 0] += d * np.cos(middle)
    after[..., 1] += d * np.sin(middle)
    after[..., HEADING] = wrap_angle(after[..., HEADING] + t)
    return after


def step_jacobians(states: Floats, step: Floats) -> tuple[Floats, Floats]:
    """Return F (..., n, n) and G (..., 3, 2) at states (..., n) and steps (..., 2) as matrices."""
    n = states.shape[-1]
    _, _, F, G = jacobians([component(states, index) for index in range(n)], *_components(step))
    shape = np.broadcast_shapes(states.shape[:-1], step.shape[:-1])
    by_state, by_step = np.zeros((*shape, n, n)), np.zeros((*shape, POSE, 2))
    by_state[...] = np.eye(n)
    for matrix, columns in ((by_state, F), (by_step, G)):
        for index, column in columns:
            for row in range(POSE):
                matrix[..., row, index] += column[row]
    return by_state, by_step


def step_variance(step: Floats, noise: OdometryNoise) -> Floats:
    """Return the diagonal of Q, variances (..., 2) of distance (in^2) and turn (rad^2), for steps (..., 2)."""
    return np.stack(process_variance(*_components(step), noise), axis=-1)


def process_covariance(G: Floats, step: Floats, noise: OdometryNoise) -> Floats:
    """Return G Q G' (..., 3, 3), the covariance that steps (..., 2) add to a pose.

    It has rank 2, two noises in three coordinates, and cannot be inverted.
    """
    scaled = G * np.sqrt(step_variance(step, noise))[..., None, :]
    return np.asarray(scaled @ scaled.swapaxes(-1, -2), dtype=np.float64)


def step_between(before: Floats, after: Floats) -> Floats:
    """Return the step (..., 2) from one encoder pose (..., 3) to another: the inverse of `move`.

    See `relative_step`.
    """
    x, y, heading = (component(before, index) for index in range(POSE))
    to_x, to_y, to_heading = (component(after, index) for index in range(POSE))
    return np.stack(relative_step(x, y, heading, to_x, to_y, to_heading), axis=-1)


def relative_step(
    x: Number, y: Number, heading: Number, to_x: Number, to_y: Number, to_heading: Number
) -> tuple[Number, Number]:
    """Return distance and turn of the step from one encoder pose to another.

    The distance is the part of the chord along the middle heading, with its sign. What lies across it, which no single
    step can make, is left out, so poses must be read often enough for one arc to describe the path between them.
    """
    turn = wrap_angle(to_heading - heading)
    middle = heading + 0.5 * turn
    return (to_x - x) * cos(middle) + (to_y - y) * sin(middle), turn


def with_parameters(belief: Belief, stds: tuple[float, ...]) -> Belief:
    """Return a belief over poses (..., 3) extended by odometry parameters of mean 0 and these standard deviations.

    Raises
    ------
    ValueError
        More standard deviations than parameters.
    """
    size = belief.mean.shape[-1]
    count = size + len(stds)
    if count > MAX_STATE:
        raise ValueError(f"there are {MAX_STATE - POSE} odometry parameters, not {count - POSE}")
    mean = np.zeros((*belief.mean.shape[:-1], count))
    mean[..., :size] = belief.mean
    cov = np.zeros((*mean.shape, count))
    cov[..., :size, :size] = belief.cov
    rest = np.arange(size, count)
    cov[..., rest, rest] = np.square(stds)
    return Belief(add(mean, np.zeros_like(mean)), cov)


def with_pose(pose: Belief, parameters: Belief) -> Belief:
    """Return a belief (n,) with the pose of one belief (3,) and the parameters of another (n,), independent of it."""
    cov = parameters.cov.copy()
    cov[:POSE], cov[:, :POSE] = 0.0, 0.0
    cov[:POSE, :POSE] = pose.cov
    return Belief(np.concatenate((pose.mean, parameters.mean[POSE:])), cov)


def _components(step: Floats) -> tuple[Floats, Floats]:
    """Return distance and turn of steps (..., 2)."""
    return component(step, 0), component(step, 1)
