"""How the robot moves, and how far a move may differ from what the encoders say.

Rules: pure functions on arrays; no clock (a step is a distance and a turn, whatever time it took), no sensors.
A step is an array (..., 2): drho_in, the distance rolled (negative backwards), and dtheta_rad, the turn made
meanwhile. One step is the thesis' x += T v cos(theta + w T / 2), y += T v sin(theta + w T / 2), theta += T w
with drho = T v and dtheta = T w. For a single robot the same is done in plain numbers: an array of three is slower.

Encoders that err the same way every time, and a filter that finds out how: states longer than a pose.

A state (..., n) is a pose and as many of these, in this order, as its n has room for; n = 3 is the pose alone:

    3  way_scale     the robot goes (1 + way_scale) drho where the encoders tell drho
    4  turn_scale    and turns (1 + turn_scale) dtheta
    5  drift         + drift drho besides, rad/in: a synchro drive whose wheels are not parallel

Rules: pure functions; constants are not driven, so no noise is added to them: what is known of them only grows. One
that is known beforehand gets a standard deviation of 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import cos, sin
from typing import Final, NamedTuple

import numpy as np

from localization.filters.belief import HEADING, Belief, Floats, add, difference, part, wrapped

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


POSE: Final = 3
"""Coordinates of the pose, which every state begins with."""


class OdometryParameter(IntEnum):
    """Where in a state each constant stands."""

    DISTANCE_SCALE = 3
    TURN_SCALE = 4
    DRIFT = 5


LARGEST: Final = 6
"""Coordinates of the largest state."""


def true_step(states: Floats, step: Floats) -> Floats:
    """The steps (..., 2) that states (..., n) make of what the encoders tell, (..., 2)."""
    count = states.shape[-1]
    told_way, told_turn = part(step, 0), part(step, 1)
    made = np.empty((*np.broadcast_shapes(states.shape[:-1], step.shape[:-1]), 2))
    made[..., 0] = (
        told_way * (1.0 + part(states, OdometryParameter.DISTANCE_SCALE))
        if count > OdometryParameter.DISTANCE_SCALE
        else told_way
    )
    made[..., 1] = (
        told_turn * (1.0 + part(states, OdometryParameter.TURN_SCALE))
        if count > OdometryParameter.TURN_SCALE
        else told_turn
    )
    if count > OdometryParameter.DRIFT:
        made[..., 1] += part(states, OdometryParameter.DRIFT) * told_way
    return made


def move_states(states: Floats, step: Floats) -> Floats:
    """Where states (..., n) lead after steps (..., 2) that the encoders tell; the constants stay."""
    after = np.broadcast_to(states, np.broadcast_shapes(states.shape, (*step.shape[:-1], 1))).copy()
    after[..., :POSE] = move(states[..., :POSE], true_step(states, step))
    return after


def predict(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """The belief over states (..., n), 3 <= n <= 6, after steps (..., 2) that the encoders tell.

    mean' = move(mean, true_step), P' = F P F' + Q. With G the derivative of the pose by the true step, the columns of F
    for the constants are G times the derivative of the true step by them. Raises ValueError for other n.
    """
    if belief.mean.ndim == step.ndim == 1:
        return _predict_one(belief, step, noise)
    made = true_step(belief.mean, step)
    by_state, by_step = step_jacobians(belief.mean, step)
    scaled = by_step * np.sqrt(step_variance(step, noise))[..., None, :]
    cov = by_state @ belief.cov @ by_state.swapaxes(-1, -2)
    cov[..., :POSE, :POSE] += scaled @ scaled.swapaxes(-1, -2)
    mean = belief.mean.copy()
    mean[..., :POSE] = move(belief.mean[..., :POSE], made)
    return Belief(mean, 0.5 * (cov + cov.swapaxes(-1, -2)))


def step_jacobians(states: Floats, step: Floats) -> tuple[Floats, Floats]:
    """F and G of `predict`: derivatives of `move_states` by the state, (..., n, n), and of its pose by the true step,
    (..., 3, 2). Raises ValueError for other n than 3 to 6."""
    count = _size(states)
    by_pose, by_step = step_jacobian(states[..., :POSE], true_step(states, step))
    by_state = np.zeros((*by_pose.shape[:-2], count, count))
    by_state[...] = np.eye(count)
    by_state[..., :POSE, :POSE] = by_pose
    by_state[..., :POSE, POSE:] = by_step @ _by_constants(step, count)
    return by_state, by_step


def _size(states: Floats) -> int:
    """How many coordinates states (..., n) have."""
    count: int = states.shape[-1]
    if not POSE <= count <= LARGEST:
        raise ValueError(f"a state has {POSE} to {LARGEST} coordinates, not {count}")
    return count


def _predict_one(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """`predict` of a single belief in numbers. `columns`: those of F for the pose that are not the identity's, (which,
    its three numbers)."""
    count = _size(belief.mean)
    if count == POSE:
        return Belief(*carried(belief.mean, belief.cov, step, noise))
    x, y, heading, *constants = belief.mean.tolist()
    told_way, told_turn = step.tolist()
    way_scale, turn_scale, drift = (*constants, 0.0, 0.0, 0.0)[:3]
    way, turn = told_way * (1.0 + way_scale), told_turn * (1.0 + turn_scale) + drift * told_way
    cosine, sine = cos(heading + 0.5 * turn), sin(heading + 0.5 * turn)
    by_way, by_turn = (cosine, sine, 0.0), (-0.5 * way * sine, 0.5 * way * cosine, 1.0)
    columns = [(HEADING, (-way * sine, way * cosine, 0.0))]
    by_constants = (3, by_way, told_way), (4, by_turn, told_turn), (5, by_turn, told_way)
    for which, by_step, told in by_constants[: count - POSE]:
        columns.append((which, (told * by_step[0], told * by_step[1], told * by_step[2])))
    along = noise.translation_std**2 * abs(told_way)
    about = noise.drift_std**2 * abs(told_way) + noise.rotation_std**2 * abs(told_turn)
    cov = belief.cov.tolist()
    for row in range(POSE):
        for which, by in columns:
            share = by[row]
            if share:
                cov[row] = [here + share * there for here, there in zip(cov[row], cov[which], strict=True)]
    for row in range(POSE):
        told = cov[row]
        of_way, of_turn = along * by_way[row], about * by_turn[row]
        for at in range(row, POSE):
            more = sum([by[at] * told[which] for which, by in columns])
            told[at] = cov[at][row] = told[at] + more + of_way * by_way[at] + of_turn * by_turn[at]
        for which in range(POSE, count):
            cov[which][row] = told[which]
    mean = [x + way * cosine, y + way * sine, wrapped(heading + turn), *constants]
    return Belief(np.array(mean), np.array(cov))


def with_parameters(belief: Belief, stds: tuple[float, ...]) -> Belief:
    """A belief over poses (..., 3) with constants besides, at first 0 and as uncertain as `stds` say, in their order.

    Raises ValueError for more constants than there are.
    """
    count = belief.mean.shape[-1] + len(stds)
    if count > LARGEST:
        raise ValueError(f"there are {LARGEST - POSE} constants, not {count - POSE}")
    mean = np.zeros((*belief.mean.shape[:-1], count))
    mean[..., : -len(stds) or None] = belief.mean
    cov = np.zeros((*mean.shape, count))
    size = belief.mean.shape[-1]
    cov[..., :size, :size] = belief.cov
    rest = np.arange(size, count)
    cov[..., rest, rest] = np.square(stds)
    return Belief(add(mean, np.zeros_like(mean)), cov)


def with_pose(pose: Belief, known: Belief) -> Belief:
    """A belief (n,) with the pose of one over poses (3,) and the constants of another (n,), the two independent."""
    cov = known.cov.copy()
    cov[:POSE], cov[:, :POSE] = 0.0, 0.0
    cov[:POSE, :POSE] = pose.cov
    return Belief(np.concatenate((pose.mean, known.mean[POSE:])), cov)


def _by_constants(step: Floats, count: int) -> Floats:
    """The derivative (..., 2, n - 3) of the true step by the constants."""
    way, turn = part(step, 0), part(step, 1)
    by_constants = np.zeros((*step.shape[:-1], 2, LARGEST - POSE))
    by_constants[..., 0, OdometryParameter.DISTANCE_SCALE - POSE] = way
    by_constants[..., 1, OdometryParameter.TURN_SCALE - POSE] = turn
    by_constants[..., 1, OdometryParameter.DRIFT - POSE] = way
    wanted: Floats = by_constants[..., : count - POSE]
    return wanted


def pose_of(belief: Belief) -> Belief:
    """The part of a belief (..., n) that is about the pose."""
    return Belief(belief.mean[..., :POSE], belief.cov[..., :POSE, :POSE])
