"""The Kalman filter that `nomad localize` runs: extended, iterated or unscented, one sonar reading at a time.

    filter_ring        all new echoes of a ring    for each: odometry.predict_state, then sonar_ray.update_by_ray or
                                                   sonar_cone.update_by_cone; the gain is update.kalman_gain
    predict, update    one step, one reading       the same by update.MeasurementUpdate, for other rules

`update_ring` applies the same Kalman update to whole rings of many robots at once, for the experiments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Final

import numpy as np

from localization.filters import compiled
from localization.filters.base import EncoderRow, NewEcho, process_each
from localization.filters.belief import (
    HEADING,
    Belief,
    Floats,
    add_outer,
    marginal,
    pack,
    unit_vector,
    unpack,
    with_constants,
    wrap_angle,
)
from localization.filters.health import BUILDING, FilterHealth, HealthLimits, IntegrityMonitor
from localization.filters.odometry import (
    NO_LAG,
    Lag,
    OdometryNoise,
    pose_at,
    predict_state,
    process_variance,
    relative_step,
    true_step,
    widen,
)
from localization.filters.sonar_ray import Observation
from localization.filters.update import (
    INFORMATIVE,
    INFORMATIVE_IN_CLUTTER,
    LIMIT,
    NONE,
    CorrelatedReadings,
    Covariance,
    DirectModel,
    MeasurementUpdate,
    Outcome,
    Refusal,
    State,
    UpdateResult,
    Used,
    count_used,
    kalman_update,
    mount_at,
    move_on,
    record_used,
)

SLIP_GAIN, SIDE_SLIP_IN, SLIP_RAD = 0.5, 0.3, 0.02
"""Standard deviations that are added when the wheels may have slipped: along the heading, across it, and of it."""

PRESSED_NOISE: Final = 5.0
"""Variance of wheels that roll on the spot, relative to those that roll freely: the robot creeps and turns by the same
noise, and all readings from there repeat their errors."""

NO_RANGE: Final[Outcome] = (LIMIT, 0.0, 0.0, 1.0, 1.0, 0.0)
"""The outcome of a limit, whose likelihood this filter does not need."""

Prediction = Callable[[State, Covariance, float, float, OdometryNoise, int], None]
"""Predicts x and P after a step (distance, turn), in place; the last argument is the number of constants."""


def filter_ring(
    x: State,
    P: Covariance,
    used: Used,
    encoders: EncoderRow,
    poses: Sequence[EncoderRow],
    echoes: Sequence[NewEcho],
    noise: OdometryNoise,
    model: DirectModel,
    correct: Callable[..., Outcome],
) -> list[Outcome]:
    """Filter x, P by all echoes of a ring in order of time, in place; return the outcome of each.

    This is the loop of the extended Kalman filter; `compiled` compiles it with all that it calls.

    Parameters
    ----------
    used
        Of `CorrelatedReadings`.
    encoders, poses, echoes
        As in `base.process_each`.
    correct
        The update by the model: `sonar_ray.update_by_ray` or `sonar_cone.update_by_cone`.
    """
    outcomes = []
    x_in, y_in, heading = encoders[1], encoders[2], encoders[3]
    for echo in echoes:
        # 1. Predict to the pose of the encoders at the instant of the echo.
        to_x, to_y, to_heading, turret = pose_at(poses, echo[0])
        distance, turn = relative_step(x_in, y_in, heading, to_x, to_y, to_heading)
        predict_state(x, P, distance, turn, noise, model.range_parameters)
        move_on(used, distance, turn)
        x_in, y_in, heading = to_x, to_y, to_heading
        # 2. Correct by the reading, the `count`-th one used from here.
        sonar, offset = int(echo[1]), turret - to_heading
        count = count_used(used, sonar, offset) + 1
        outcome = correct(x, P, mount_at(model.mounts, sonar, offset), echo[2], model, count)
        if outcome[0] == NONE:
            record_used(used, sonar, offset, count)
        outcomes.append(outcome)
    return outcomes


class KalmanFilter:
    """Gaussian filter over poses, or states with odometry parameters, and the errors that all readings have in common.

    Parameters
    ----------
    belief
        Belief before the first step, over states (n,), 3 <= n <= 6: the pose and odometry parameters.
    measurement
        The measurement model and the rule of correction.
    odometry
        Noise of the encoders.
    prediction
        The prediction step: extended by default.
    range_stds
        Prior standard deviations of the range parameters, for a model that has them (`LocalizationConfig`).
    middle_in
        Middle of the map, about which its scale may be wrong.
    limits
        Limits of the monitor.
    """

    def __init__(
        self,
        belief: Belief,
        measurement: MeasurementUpdate,
        odometry: OdometryNoise,
        prediction: Prediction = predict_state,
        range_stds: Sequence[float] = (),
        middle_in: tuple[float, float] = (0.0, 0.0),
        limits: HealthLimits | None = None,
    ) -> None:
        self._x, self._P = unpack(with_constants(belief, range_stds))
        self._size, self._constants, self._middle_in = len(belief.mean), len(range_stds), middle_in
        self.detects_slips = True
        self._measurement = measurement
        self._odometry = odometry
        self._predict = prediction
        self._monitor = IntegrityMonitor(limits)
        self._correlated = CorrelatedReadings()
        self._direct = measurement.direct if prediction is predict_state else None
        self._odometric = measurement.odometric
        self._informative: Sequence[int] = INFORMATIVE
        if self._odometric:
            self._informative, self._monitor = INFORMATIVE_IN_CLUTTER, IntegrityMonitor(BUILDING)
        self._compiled = compiled.ring(filter_ring, self._direct, odometry)
        if self._compiled:
            self._correlated.used = np.array(self._correlated.used)  # type: ignore[assignment]

    @property
    def belief(self) -> Belief:
        """The present belief over pose and odometry parameters, mean (n,) and covariance (n, n)."""
        return marginal(self.state, self._size)

    @property
    def state(self) -> Belief:
        """The present belief over the whole state, with the range parameters."""
        return pack(self._x, self._P)

    @property
    def health(self) -> FilterHealth:
        """Health of the estimate; a filter that considers one pose only never reports LOST."""
        return self._monitor.health(self._P)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report."""
        if self._odometric:
            self._odometric.move(*true_step(self._x, distance_in, turn_rad, self._constants))
        self._predict(self._x, self._P, distance_in, turn_rad, self._odometry, self._constants)
        self._correlated.move(distance_in, turn_rad)

    def roll_on_spot(self, distance_in: float) -> None:
        """Widen the belief by the noise of wheels that roll so far while something holds the robot."""
        q_distance, q_turn = process_variance(PRESSED_NOISE * abs(distance_in), 0.0, self._odometry)
        c, s = unit_vector(self._x[HEADING])
        add_outer(self._P, q_distance, (c, s, 0.0))
        add_outer(self._P, q_turn, (0.0, 0.0, 1.0))

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by what the model leaves out.

        That is a lag, innovations that are larger than they should be, the scale of the map, and a slip of the wheels.

        Readings that are all too long by a fraction s are of colder air, or of a map that is too small by s: then the
        robot is s times its distance from the middle off. No reading tells one from the other.
        """
        # The pose does not depend on the range parameters.
        size, ratio = self._size, self._monitor.nis_ratio
        x, P = self._x[:size], [row[:size] for row in self._P[:size]]
        if ratio != 1.0:
            P = [[ratio * cov for cov in row] for row in P]
        self._predict(x, P, distance_in, turn_rad, self._odometry, 0)
        if lag != NO_LAG:
            widen(x, P, lag)
        if self._constants:
            scale, (middle_x, middle_y) = self._x[-1], self._middle_in
            add_outer(P, 1.0, (scale * (x[0] - middle_x), scale * (x[1] - middle_y), 0.0))
        _, slipped_in2 = self._monitor.slip.slipped
        if slipped_in2:
            add_outer(P, slipped_in2, (*unit_vector(x[HEADING]), 0.0))
        return Belief(np.array(x), np.array(P))

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading of a sonar that fired at this very pose."""
        count = self._correlated.count(sonar, turret_offset_rad) + 1
        result = self._measurement.apply(self._x, self._P, sonar, turret_offset_rad, reading_in, count)
        if result.refusal is Refusal.NONE:
            self._correlated.record(sonar, turret_offset_rad)
        if result.refusal in self._informative:
            self._add((result.refusal, *result[1:]))
            self._check_slip()
        return result

    def _add(self, outcome: Outcome) -> None:
        """Let the monitor know of a reading, and of how far it displaces the robot along its heading."""
        self._monitor.add(outcome)
        if self.detects_slips and self._monitor.limits.slip_nats < inf:
            _, innovation_in, nis, _, _, slope = outcome
            self._monitor.slip.add(innovation_in, nis, slope)

    def _check_slip(self) -> None:
        """Widen the covariance by a slip of the wheels, along the heading, if the last readings agree on one."""
        slip_in = self._monitor.take_slip()
        if slip_in is not None:
            std = SLIP_GAIN * abs(slip_in)
            c, s = unit_vector(self._x[HEADING])
            add_outer(self._P, 1.0, (std * c, std * s, 0.0))
            add_outer(self._P, 1.0, (-SIDE_SLIP_IN * s, SIDE_SLIP_IN * c, 0.0))
            add_outer(self._P, 1.0, (0.0, 0.0, SLIP_RAD))

    def process(
        self, encoders: EncoderRow, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho]
    ) -> Sequence[Outcome]:
        """Predict to the instant of each echo and update; see `process_each`."""
        if not self._direct:
            return process_each(self, encoders, poses, echoes)
        x, P, used, noise, model = self._x, self._P, self._correlated.used, self._odometry, self._direct
        # A limit is no range: the filter passes over it. It predicts to the last echo in any case.
        low_in, high_in, last = model.noise.lowest_in, model.noise.highest_in, len(echoes) - 1
        ranges = [k for k, echo in enumerate(echoes) if low_in < echo[2] < high_in or k == last]
        some = echoes if len(ranges) == len(echoes) else [echoes[k] for k in ranges]
        if self._compiled:
            results = self._compiled.filter(x, P, used, encoders, poses, some)
        else:
            results = filter_ring(x, P, used, encoders, poses, some, noise, model, model.update)
        outcomes = [NO_RANGE] * len(echoes)
        for k, outcome in zip(ranges, results, strict=True):
            outcomes[k] = outcome
        for outcome in outcomes:
            if outcome[0] in INFORMATIVE:
                self._add(outcome)
        self._check_slip()
        return outcomes


def update_ring(belief: Belief, observation: Observation) -> tuple[Belief, Floats]:
    """Correct beliefs (..., 3) by the n independent readings of a ring taken at one instant.

    The readings are linearised at the mean before all of them and applied one after another, which is the update by the
    whole vector, without the inverse of an (n, n) matrix.

    Returns
    -------
    tuple
        The beliefs, and the NIS (...) of the whole vector, with as many degrees of freedom as readings used.

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), sequential processing
    of measurements.
    """
    x, P = unpack(Belief(np.zeros_like(belief.mean), belief.cov))  # x: the change of the mean
    nis: Floats = np.zeros(belief.mean.shape[:-1])
    for beam in range(observation.innovation.shape[-1]):
        H = [observation.H[..., beam, index] for index in range(observation.H.shape[-1])]
        # The innovation of this reading after those before it, in the linear model.
        innovation = observation.innovation[..., beam] - sum(h * change for h, change in zip(H, x, strict=True))
        nis = nis + kalman_update(x, P, H, observation.R[..., beam], innovation)
    updated = pack([before + change for before, change in zip(np.moveaxis(belief.mean, -1, 0), x, strict=True)], P)
    updated.mean[..., HEADING] = wrap_angle(updated.mean[..., HEADING])
    return updated, nis
