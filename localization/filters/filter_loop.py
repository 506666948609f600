"""The loop of the extended Kalman filter over all echoes of a state of the robot, and the estimate that is reported.

    filter_state      echoes, health, prediction from the last echo to the state        KalmanFilter.advance
    filter_ring       the echoes alone: predict, correct, one after another              pose_search.EchoReplay

The functions of the equations are listed at `ekf.KalmanFilter`. `compiled` compiles this module with all that it calls.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from localization.filters import health, odometry, update
from localization.filters.base import EncoderRow, NewEcho
from localization.filters.health import HealthLimits, Signs, SlipSums, Windows
from localization.filters.odometry import OdometryNoise, predict_state
from localization.filters.update import Covariance, DirectModel, Outcome, State, Used


class FilterMemory(NamedTuple):
    """Belief and counts that the filter carries from state to state: lists in plain Python, arrays for compiled code.

    Attributes
    ----------
    x, P
        State and covariance at the last echo (`belief.unpack`).
    used
        Of `update.new_used`.
    slip_sums, windows
        Of `health.IntegrityMonitor`.
    """

    x: State
    P: Covariance
    used: Used
    slip_sums: SlipSums
    windows: Windows


class FilterConfig(NamedTuple):
    """Noise, sonar model and limits of a filter, which stay as they are.

    Attributes
    ----------
    noise, model
        Of the encoders, and of the sonars on the map.
    slip_nats, max_totals
        Limits of `health.take_slip` and `health.mean_nis`.
    middle
        Middle of the map, about which its scale may be wrong.
    """

    noise: OdometryNoise
    model: DirectModel
    slip_nats: float
    max_totals: Sequence[float]
    middle: tuple[float, float]


class StateInput(NamedTuple):
    """Encoders, echoes and clock of a new state of the robot.

    Attributes
    ----------
    encoders, poses, echoes
        As in `base.Filter.process`.
    clock_std_s
        As in `odometry.clock_lag`.
    detects_slips
        False: slips of the wheels are not looked for.
    """

    encoders: EncoderRow
    poses: Sequence[EncoderRow]
    echoes: Sequence[NewEcho]
    clock_std_s: float
    detects_slips: bool


def filter_state(memory: FilterMemory, state: StateInput, config: FilterConfig, correct: Callable[..., Outcome],
                 mean: State, cov: Covariance) -> tuple[list[Outcome], EncoderRow, Signs]:  # fmt: skip
    """Filter by all echoes of a state of the robot, and predict from the last one to the state.

    `compiled` compiles this function with all that it calls.

    Parameters
    ----------
    memory
        Changed in place.
    correct
        The update by the model: `sonar_ray.update_by_ray` or `sonar_cone.update_by_cone`.
    mean, cov
        The prediction that is reported is written into these, as many coordinates as they have.

    Returns
    -------
    tuple
        The outcome of each echo, the encoders at the last one, and the signs of health.
    """
    x, P, used, slip_sums, windows = memory
    poses = state.poses
    # 1. Predict to each echo, and correct by it.
    tested = slip_sums if state.detects_slips else slip_sums[:0]
    outcomes, encoders = filter_ring(x, P, used, tested, state.encoders, poses, state.echoes, config.noise,
                                     config.model, correct)
    # 2. The monitor judges by the outcomes of ranges; a slip of the wheels widens P.
    for refusal, _, nis, outlier_probability, _, _ in outcomes:
        if refusal in update.INFORMATIVE:
            health.add_reading(windows, slip_sums, nis, outlier_probability)
            if state.detects_slips:
                slip_sums[health.COUNTS][health.READINGS] += 1.0
    slip_in = health.take_slip(slip_sums, config.slip_nats)
    if slip_in != 0.0:
        odometry.widen_by_slip(x, P, slip_in)
    signs = health.signs_of(P, windows, slip_sums, config.max_totals)
    # 3. The prediction, of a copy: the scale of the map is the last of the range parameters.
    for i in range(len(mean)):
        mean[i] = x[i]
        for j in range(len(mean)):
            cov[i][j] = P[i][j]
    now, before = poses[len(poses) - 1], poses[max(len(poses) - 2, 0)]
    distance, turn = odometry.relative_step(encoders[1], encoders[2], encoders[3], now[1], now[2], now[3])
    _, _, nis_ratio, _, _, slipped_in2 = signs
    lag, scale = odometry.clock_lag(before, now, state.clock_std_s), x[-1] if config.model.range_parameters > 0 else 0.0
    odometry.widen_prediction(mean, cov, distance, turn, config.noise, nis_ratio, lag, scale, config.middle,
                              slipped_in2, predict_state)
    return outcomes, encoders, signs


def filter_ring(x: State, P: Covariance, used: Used, slip_sums: SlipSums, encoders: EncoderRow,
                poses: Sequence[EncoderRow], echoes: Sequence[NewEcho], noise: OdometryNoise, model: DirectModel,
                correct: Callable[..., Outcome]) -> tuple[list[Outcome], EncoderRow]:  # fmt: skip
    """Filter x, P by all echoes of a ring in order of time, in place; return their outcomes and the last encoders.

    This is the loop of the extended Kalman filter, with the steps that `KalmanFilter` lists.

    Parameters
    ----------
    x, P
        State and covariance at the pose `encoders` (`belief.unpack`).
    used
        Of `update.new_used`.
    slip_sums
        Of `health.IntegrityMonitor`; without rows, slips are not looked for.
    encoders, poses, echoes
        As in `base.Filter.process`.
    correct
        The update by the model: `sonar_ray.update_by_ray` or `sonar_cone.update_by_cone`.
    """
    outcomes = []
    for echo in echoes:
        # By index: numba cannot unpack a row of an array.
        instant_s, sonar, reading_in = echo[0], int(echo[1]), echo[2]
        # 1. u, the step of the encoders to their pose at the instant of the echo.
        to_x, to_y, to_heading, turret = odometry.pose_at(poses, instant_s)
        distance, turn = odometry.relative_step(encoders[1], encoders[2], encoders[3], to_x, to_y, to_heading)
        encoders = instant_s, to_x, to_y, to_heading, turret
        # 2. x- = f(x, u), P- = F P F^T + G Q G^T.
        predict_state(x, P, distance, turn, noise, model.range_parameters)
        update.move_on(used, distance, turn)
        # 3. to 7. The update by the model, in place. For a ray (sonar_ray.update_by_ray):
        #        innovation = z - h(x-)
        #        S = H P- H^T + R,  K = P- H^T / S        R of the `count`-th reading of this sonar from here
        #        unless innovation^2 / S > threshold:
        #            x = x- + K innovation,  P = P- - K S K^T
        turret_offset = turret - to_heading
        mount = update.mount_at(model.mounts, sonar, turret_offset)
        count = update.count_used(used, sonar, turret_offset) + 1
        outcome = correct(x, P, mount, reading_in, model, count, used[-1][update.OUTLIERS])
        refusal, innovation, nis, outlier_probability, _, slope = outcome
        if refusal == update.NONE:
            update.record_used(used, sonar, turret_offset, count)
        # 8. Evidence of a slip of the wheels.
        if refusal in (update.NONE, update.GATE):
            update.count_outlier(used, outlier_probability)
            if len(slip_sums) > 0:
                health.add_slip_evidence(slip_sums, innovation, nis, slope)
        outcomes.append(outcome)
    return outcomes, encoders


def filter_config(noise: OdometryNoise, model: DirectModel, limits: HealthLimits,
                  middle: tuple[float, float] = (0.0, 0.0)) -> FilterConfig:
    """Return the configuration for `filter_state`, with the limits of the monitor."""
    max_totals = health.nis_limits(limits.nis_probability, limits.window)
    return FilterConfig(noise, model, limits.slip_nats, max_totals, middle)


def new_memory(x: State, P: Covariance, *, as_array: bool = False) -> FilterMemory:
    """Return a memory without readings yet, for a filter without a monitor: x and P are lists, or arrays."""
    used, slip_sums, windows = update.new_used(as_array=as_array), health.empty_slip_sums(), health.empty_windows(1)
    if as_array:
        return FilterMemory(x, P, used, np.array(slip_sums), np.array(windows))
    return FilterMemory(x, P, used, slip_sums, windows)
