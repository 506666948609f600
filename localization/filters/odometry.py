"""The odometry motion model, the prediction step of the Kalman filter, and what widens a prediction.

    u    (distance_in, turn_rad)      the step that the encoders report: inches rolled, radians turned
    x-   = f(x, u)                    straight along the heading half-way through the turn
    P-   = F P F^T + G Q G^T          F = df/dx, G = df/du, Q the variances of the step

A state is a pose and as many odometry parameters as its n has room for, in this order; n = 3 is the pose alone:

    3  distance_scale    the robot rolls (1 + distance_scale) times the reported distance
    4  turn_scale        and turns (1 + turn_scale) times the reported turn
    5  drift             plus drift times the reported distance, rad/in: wheels of a synchro drive that are not parallel

Parameters are constants: the prediction adds no noise to them. One that is known gets a standard deviation of 0.
A filter may append states that no step changes or depends on, `constants` of them: see `update.RANGE_PARAMETERS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from math import sqrt
from typing import Final

import numpy as np

from localization.filters.belief import (
    HEADING,
    POSE,
    Belief,
    Floats,
    Number,
    add,
    add_outer,
    component,
    pack,
    unit_vector,
    unpack,
    with_constants,
    wrap_angle,
)


class OdometryParameter(IntEnum):
    """Index of each odometry parameter in a state."""

    DISTANCE_SCALE = 3
    TURN_SCALE = 4
    DRIFT = 5


MAX_STATE: Final = POSE + len(OdometryParameter)
"""Coordinates of a pose with all odometry parameters."""

SLIP_GAIN: Final = 0.5
"""Standard deviation along the heading after a slip of the wheels, as a fraction of the displacement."""
SIDE_SLIP_IN: Final = 0.3
"""Standard deviation across the heading after a slip, inches."""
SLIP_RAD: Final = 0.02
"""Standard deviation of the heading after a slip, radians."""

PRESSED_NOISE: Final = 5.0
"""Variance of wheels that roll on the spot, relative to those that roll freely: the robot creeps and turns by the same
noise, and all readings from there repeat their errors."""

_SCALE, _TURN_SCALE, _DRIFT = (int(parameter) for parameter in OdometryParameter)


@dataclass(frozen=True, slots=True)
class OdometryNoise:
    """Variance of a true step about the reported one: a random walk, so variances grow with the distance.

    The simulation's `MotionNoise` (nserver_emu/simulation/odometry.py) has the same terms: translation_std^2 is its
    alpha3, rotation_std^2 its alpha1, drift_std^2 its alpha2; its alpha4 is not modelled.

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


Prediction = Callable[[list[float], list[list[float]], float, float, OdometryNoise, int], None]
"""Predicts x and P after a step (distance, turn), in place; the last argument is the number of constants."""


def process_variance(distance: Number, turn: Number, noise: OdometryNoise) -> tuple[Number, Number]:
    """Return the diagonal of Q: the variances of a step's distance (in^2) and turn (rad^2)."""
    return (noise.translation_std**2 * abs(distance),
            noise.drift_std**2 * abs(distance) + noise.rotation_std**2 * abs(turn))


def true_step(x: Sequence[Number], distance: Number, turn: Number, constants: int = 0) -> tuple[Number, Number]:
    """Return the step (distance, turn) that the odometry parameters of state x make of the reported one."""
    n = len(x) - constants
    true_distance, true_turn = distance, turn
    if n > _SCALE:
        true_distance = distance * (1.0 + x[_SCALE])
    if n > _TURN_SCALE:
        true_turn = turn * (1.0 + x[_TURN_SCALE])
    if n > _DRIFT:
        true_turn = true_turn + x[_DRIFT] * distance
    return true_distance, true_turn


def jacobians(x: Sequence[Number], distance: Number, turn: Number,
              constants: int = 0) -> tuple[Number, Number, tuple[Number, Number], tuple[Number, Number]]:
    """Return the true step, and G, the derivative of the pose by it, at x.

    Returns
    -------
    tuple
        The true distance d and turn t; the elements of G that depend on the state: g, of x and y by d, and h, by t.
        The heading's are 0 and 1, so G is ((g_x, h_x), (g_y, h_y), (0, 1)).

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), section 7.4: V_t, here for the odometry of section 5.4.
    """
    d, t = true_step(x, distance, turn, constants)
    c, s = unit_vector(x[HEADING] + 0.5 * t)
    return d, t, (c, s), (-0.5 * d * s, 0.5 * d * c)


def parameter_columns(n: int, distance: Number, turn: Number, g: tuple[Number, Number],
                      h: tuple[Number, Number]) -> list[tuple[int, Number, Number, Number]]:
    """Return the columns of F for the odometry parameters among n coordinates, each with its index.

    A parameter acts through the true step, so its column is one of G times the reported distance or turn.
    """
    columns = [
        (_SCALE, distance * g[0], distance * g[1], 0.0 * distance),
        (_TURN_SCALE, turn * h[0], turn * h[1], turn),
        (_DRIFT, distance * h[0], distance * h[1], distance),
    ]
    return columns[: n - POSE]


def predict_state(x: list[Number], P: list[list[Number]], distance: Number, turn: Number, noise: OdometryNoise,
                  constants: int = 0) -> None:  # fmt: skip
    """Predict x and P after a step that the encoders report, in place: the prediction step of the Kalman filter.

    Parameters
    ----------
    x, P
        State of n elements and covariance of n rows, see `belief.unpack`.
    distance, turn
        The reported step, inches and radians.
    constants
        Number of coordinates at the end of the state that stay and have no part in the step.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 3.3, lines 2 and 3; the random walk of `OdometryNoise`
    instead of table 5.6.
    """
    n = len(x)
    # 1. The motion model and its derivatives.
    d, t, (g_x, g_y), (h_x, h_y) = jacobians(x, distance, turn, constants)
    q_distance, q_turn = process_variance(distance, turn, noise)
    # 2. x- = f(x, u).
    x[0] = x[0] + d * g_x
    x[1] = x[1] + d * g_y
    x[HEADING] = wrap_angle(x[HEADING] + t)
    # 3. P <- F P F^T. F is the product of one factor I + f e_k^T for each column k: the heading, whose column is
    #    twice that of the turn in G, but for its 1, and the parameters.
    of_x, of_y, of_heading = P[0], P[1], P[2]
    f_x, f_y = 2.0 * h_x, 2.0 * h_y
    x_heading, y_heading = of_x[2] + f_x * of_heading[2], of_y[2] + f_y * of_heading[2]
    of_x[0] = of_x[0] + f_x * (of_x[2] + x_heading)
    of_x[1] = of_x[1] + f_x * of_y[2] + f_y * x_heading
    of_y[1] = of_y[1] + f_y * (of_y[2] + y_heading)
    of_x[2], of_y[2] = x_heading, y_heading
    if n > POSE:
        for j in range(POSE, n):
            P[j][0] = of_x[j] = of_x[j] + f_x * of_heading[j]
            P[j][1] = of_y[j] = of_y[j] + f_y * of_heading[j]
    if n - constants > POSE:
        of_y[0], of_heading[0], of_heading[1] = of_x[1], of_x[2], of_y[2]
        for k, a, b, c in parameter_columns(n - constants, distance, turn, (g_x, g_y), (h_x, h_y)):
            for j in range(n):  # the rows of the pose
                of_x[j] = of_x[j] + a * P[k][j]
                of_y[j] = of_y[j] + b * P[k][j]
                of_heading[j] = of_heading[j] + c * P[k][j]
            # Their columns, in the upper half.
            of_x[0] = of_x[0] + a * of_x[k]
            of_x[1] = of_x[1] + b * of_x[k]
            of_x[2] = of_x[2] + c * of_x[k]
            of_y[1] = of_y[1] + b * of_y[k]
            of_y[2] = of_y[2] + c * of_y[k]
            of_heading[2] = of_heading[2] + c * of_heading[k]
            for j in range(POSE, n):
                P[j][0], P[j][1], P[j][2] = of_x[j], of_y[j], of_heading[j]
    # 4. P <- P + G Q G^T; the lower half by symmetry.
    of_x[0] = of_x[0] + q_distance * g_x * g_x + q_turn * h_x * h_x
    of_y[0] = of_x[1] = of_x[1] + q_distance * g_x * g_y + q_turn * h_x * h_y
    of_heading[0] = of_x[2] = of_x[2] + q_turn * h_x
    of_y[1] = of_y[1] + q_distance * g_y * g_y + q_turn * h_y * h_y
    of_heading[1] = of_y[2] = of_y[2] + q_turn * h_y
    of_heading[2] = of_heading[2] + q_turn


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


def move(states: Floats, step: Floats, constants: int = 0) -> Floats:
    """Return states (..., n) after steps (..., 2) that the encoders report; parameters stay.

    References
    ----------
    The thesis' x += T v cos(theta + w T / 2), y += T v sin(theta + w T / 2), theta += T w, with distance = T v and
    turn = T w.
    """
    distance, turn = _components(step)
    d, t = true_step([component(states, index) for index in range(states.shape[-1])], distance, turn, constants)
    middle = component(states, HEADING) + 0.5 * t
    after = np.broadcast_to(states, np.broadcast_shapes(states.shape, (*step.shape[:-1], 1))).copy()
    after[..., 0] += d * np.cos(middle)
    after[..., 1] += d * np.sin(middle)
    after[..., HEADING] = wrap_angle(after[..., HEADING] + t)
    return after


def step_jacobians(states: Floats, step: Floats, constants: int = 0) -> tuple[Floats, Floats]:
    """Return F (..., n, n) and G (..., 3, 2) at states (..., n) and steps (..., 2) as matrices."""
    n = states.shape[-1]
    distance, turn = _components(step)
    _, _, g, h = jacobians([component(states, index) for index in range(n)], distance, turn, constants)
    shape = np.broadcast_shapes(states.shape[:-1], step.shape[:-1])
    by_state, by_step = np.zeros((*shape, n, n)), np.zeros((*shape, POSE, 2))
    by_state[...] = np.eye(n)
    by_step[..., HEADING, 1] = 1.0
    for row in range(HEADING):
        by_state[..., row, HEADING] = 2.0 * h[row]
        by_step[..., row, 0], by_step[..., row, 1] = g[row], h[row]
    for k, *column in parameter_columns(n - constants, distance, turn, g, h):
        for row in range(POSE):
            by_state[..., row, k] = column[row]
    return by_state, by_step


def step_variance(step: Floats, noise: OdometryNoise) -> Floats:
    """Return the diagonal of Q, variances (..., 2) of distance (in^2) and turn (rad^2), for steps (..., 2)."""
    return np.stack(process_variance(*_components(step), noise), axis=-1)


def process_covariance(G: Floats, step: Floats, noise: OdometryNoise) -> Floats:
    """Return G Q G^T (..., 3, 3), the covariance that steps (..., 2) add to a pose.

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


def pose_at(poses: Sequence[Sequence[float]], instant_s: float) -> tuple[float, float, float, float]:
    """Return x, y, heading and turret of the encoders at an instant, between or nearest to the poses given.

    Parameters
    ----------
    poses
        Rows of clock, x, y, heading and turret, in order of time.
    """
    # 1. The last pose before the instant, and the next one.
    k = len(poses) - 1
    while k > 1 and poses[k - 1][0] >= instant_s:
        k -= 1
    later, earlier = poses[k], poses[max(k - 1, 0)]
    # 2. Linear between them, angles by the shorter turn.
    since_s, x, y, heading, turret = earlier[0], earlier[1], earlier[2], earlier[3], earlier[4]
    passed_s, instant_s = later[0] - since_s, instant_s - since_s
    fraction = instant_s / passed_s if 0.0 < instant_s < passed_s else (0.0 if instant_s <= 0.0 < passed_s else 1.0)
    return (
        x + fraction * (later[1] - x),
        y + fraction * (later[2] - y),
        wrap_angle(heading + fraction * wrap_angle(later[3] - heading)),
        turret + fraction * wrap_angle(later[4] - turret),
    )


Lag = tuple[float, float]
"""Standard deviations of an error that is the same multiple of both: inches along the heading, and radians."""
NO_LAG: Final = (0.0, 0.0)
_SQRT_3: Final = sqrt(3.0)


def clock_lag(before: Sequence[float], now: Sequence[float], std_s: float) -> Lag:
    """Return what the uncertain instants of echoes and states add to the last two poses of the encoders.

        P + std_s^2 xdot xdot'        xdot = (v cos(heading), v sin(heading), turn rate)

    A clock in steps leaves it open when the ring was restarted and when a state was taken, so the estimate is ahead of
    the robot or behind it. The first is constant over a run: no filter averages it out, and no noise of the echoes
    describes it. It is added to what is reported, never to the belief that the filter continues from. A robot that
    stands has none.

    Parameters
    ----------
    before, now
        Rows of clock, x, y, heading and turret.
    std_s
        Standard deviation of the difference of two instants.
    """
    passed_s = now[0] - before[0]
    if passed_s <= 0.0:
        return NO_LAG
    # Two clocks that err by up to sqrt(3) std_s may be nearly equal: the robot is not that fast.
    # A comparison, as in health.py: a call of max takes longer.
    shortest_s = _SQRT_3 * std_s
    passed_s = passed_s if passed_s > shortest_s else shortest_s
    distance_in, turn_rad = relative_step(before[1], before[2], before[3], now[1], now[2], now[3])
    return std_s * distance_in / passed_s, std_s * turn_rad / passed_s


def add_lag(belief: Belief, lag: Lag) -> Belief:
    """Return a belief over states (n,) widened by a lag."""
    if lag == NO_LAG:
        return belief
    x, P = unpack(belief)
    widen_by_lag(x, P, lag)
    return pack(x, P)


# What P leaves out, and how much wider it is then.


def widen_by_lag(x: list[float], P: list[list[float]], lag: Lag) -> None:
    """Add the variance of a lag to P, in place."""
    c, s = unit_vector(x[HEADING])
    add_outer(P, 1.0, (lag[0] * c, lag[0] * s, lag[1]))


def widen_by_rolling(x: list[float], P: list[list[float]], distance: float, noise: OdometryNoise) -> None:
    """Add the noise of wheels that roll so far on the spot, while something holds the robot, to P, in place."""
    q_distance, q_turn = process_variance(PRESSED_NOISE * abs(distance), 0.0, noise)
    c, s = unit_vector(x[HEADING])
    # P <- P + G Q G^T of a step without length: along the heading, and of it.
    add_outer(P, q_distance, (c, s, 0.0))
    add_outer(P, q_turn, (0.0, 0.0, 1.0))


def widen_by_slip(x: list[float], P: list[list[float]], slip_in: float) -> None:
    """Add the variance of a displacement along the heading that readings suggest to P, in place."""
    std = SLIP_GAIN * abs(slip_in)
    c, s = unit_vector(x[HEADING])
    # Along the heading, across it, and of it.
    add_outer(P, 1.0, (std * c, std * s, 0.0))
    add_outer(P, 1.0, (-SIDE_SLIP_IN * s, SIDE_SLIP_IN * c, 0.0))
    add_outer(P, 1.0, (0.0, 0.0, SLIP_RAD))


def widen_prediction(x: list[float], P: list[list[float]], distance: float, turn: float, noise: OdometryNoise,
                     nis_ratio: float, lag: Lag, scale: float, middle: tuple[float, float], slipped_in2: float,
                     prediction: Prediction) -> None:  # fmt: skip
    """Predict x, P after a step, in place, and widen P by what the filter leaves out of it.

    Parameters
    ----------
    nis_ratio
        Innovations larger than their S explains: P is multiplied by their mean NIS.
    lag
        Instants of echoes and of states that are not known exactly.
    scale, middle
        The scale of the map: readings that are all too long by a fraction s are of colder air, or of a map that is
        too small by s. No reading tells one from the other. The map puts the robot s times its distance from the
        middle off.
    slipped_in2
        A slip of the wheels: mean square of the displacement, by its probability.
    """
    # 1. P <- NIS P, before the step.
    if nis_ratio != 1.0:
        for row in P:
            for j in range(len(row)):
                row[j] = nis_ratio * row[j]
    # 2. x- = f(x, u), P- = F P F^T + G Q G^T.
    prediction(x, P, distance, turn, noise, 0)
    # 3. The lag: along the heading, and of it.
    if lag[0] != 0.0 or lag[1] != 0.0:
        widen_by_lag(x, P, lag)
    # 4. The scale: away from the middle.
    if scale != 0.0:
        add_outer(P, 1.0, (scale * (x[0] - middle[0]), scale * (x[1] - middle[1]), 0.0))
    # 5. The slip: along the heading.
    if slipped_in2 != 0.0:
        c, s = unit_vector(x[HEADING])
        add_outer(P, slipped_in2, (c, s, 0.0))


def relative_step(x: Number, y: Number, heading: Number, to_x: Number, to_y: Number,
                  to_heading: Number) -> tuple[Number, Number]:
    """Return distance and turn of the step from one encoder pose to another.

    The distance is the part of the chord along the middle heading, with its sign. What lies across it, which no single
    step can make, is left out, so poses must be read often enough for one arc to describe the path between them.
    """
    turn = wrap_angle(to_heading - heading)
    c, s = unit_vector(heading + 0.5 * turn)
    return (to_x - x) * c + (to_y - y) * s, turn


def with_parameters(belief: Belief, stds: tuple[float, ...]) -> Belief:
    """Return a belief over poses (..., 3) extended by odometry parameters of mean 0 and these standard deviations.

    Raises
    ------
    ValueError
        More standard deviations than parameters.
    """
    count = belief.mean.shape[-1] + len(stds)
    if count > MAX_STATE:
        raise ValueError(f"there are {MAX_STATE - POSE} odometry parameters, not {count - POSE}")
    longer = with_constants(belief, stds)
    return Belief(add(longer.mean, np.zeros_like(longer.mean)), longer.cov)


def with_pose(pose: Belief, parameters: Belief) -> Belief:
    """Return a belief (n,) with the pose of one belief (3,) and the parameters of another (n,), independent of it."""
    cov = parameters.cov.copy()
    cov[:POSE], cov[:, :POSE] = 0.0, 0.0
    cov[:POSE, :POSE] = pose.cov
    return Belief(np.concatenate((pose.mean, parameters.mean[POSE:])), cov)


def _components(step: Floats) -> tuple[Floats, Floats]:
    """Return distance and turn of steps (..., 2)."""
    return component(step, 0), component(step, 1)
