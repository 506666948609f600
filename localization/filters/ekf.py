"""The Kalman filter that `nomad localize` runs: extended, iterated or unscented, one sonar reading at a time.

`KalmanFilter` lists the equations, and the function of each. Its methods (`registry`) process echoes differently:

    method, model             echoes of a ring              predicts by               corrects by
    ekf, rays                 filter_ring                   odometry.predict_state    sonar_ray.update_by_ray
    ekf, cones                filter_ring                   odometry.predict_state    sonar_cone.update_by_cone
    ekf, walls with levels    process_each, one by one      odometry.predict_state    update.pda_update, update.linear
    iekf                      process_each, one by one      odometry.predict_state    update.pda_update, update.iterated
    ukf                       process_each, one by one      ukf.predict_state         update.pda_update, ukf.unscented
    smoother                  process_each, one by one      odometry.predict_state    as ekf

`filter_ring` is compiled by numba where that is wanted (`compiled.ring`), with the same results to the bit.
`update_ring` applies the same Kalman update to whole rings of many robots at once, for the experiments.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from typing import Any, ClassVar, Final

import numpy as np

from localization.filters import compiled
from localization.filters.base import EncoderRow, NewEcho, process_each
from localization.filters.belief import HEADING, Belief, Floats, marginal, pack, unpack, with_constants, wrap_angle
from localization.filters.heading_test import MIN_OUTLIERS, HeadingTest
from localization.filters.health import FilterHealth, HealthLimits, IntegrityMonitor, SlipSums, add_slip_evidence
from localization.filters.odometry import (
    NO_LAG,
    Lag,
    OdometryNoise,
    Prediction,
    pose_at,
    predict_state,
    relative_step,
    true_step,
    widen_by_rolling,
    widen_by_slip,
    widen_prediction,
)
from localization.filters.sonar_cone import ConeModel
from localization.filters.sonar_ray import Observation
from localization.filters.update import (
    GATE,
    INFORMATIVE,
    INFORMATIVE_IN_CLUTTER,
    LIMIT,
    NONE,
    OUTLIERS,
    CorrelatedReadings,
    Covariance,
    DirectModel,
    MeasurementUpdate,
    Outcome,
    Refusal,
    State,
    UpdateResult,
    Used,
    count_outlier,
    count_used,
    kalman_update,
    mount_at,
    move_on,
    record_used,
    shift,
)

READING, REFUSAL = 2, 0
"""Elements of a `NewEcho`, and of an `Outcome`."""
NO_RANGE: Final[Outcome] = (LIMIT, 0.0, 0.0, 1.0, 1.0, 0.0)
"""The outcome of a limit, whose likelihood this filter does not need."""


def filter_ring(
    x: State,
    P: Covariance,
    used: Used,
    slip_sums: SlipSums,
    encoders: EncoderRow,
    poses: Sequence[EncoderRow],
    echoes: Sequence[NewEcho],
    noise: OdometryNoise,
    model: DirectModel,
    correct: Callable[..., Outcome],
) -> list[Outcome]:
    """Filter x, P by all echoes of a ring in order of time, in place; return the outcome of each.

    This is the loop of the extended Kalman filter, with the steps that `KalmanFilter` lists; `compiled` compiles it
    with all that it calls.

    Parameters
    ----------
    x, P
        State and covariance at the pose `encoders` (`belief.unpack`).
    used
        Of `CorrelatedReadings`.
    slip_sums
        Of `health.SlipTest`; without rows, slips are not looked for.
    encoders, poses, echoes
        As in `base.process_each`.
    correct
        The update by the model: `sonar_ray.update_by_ray` or `sonar_cone.update_by_cone`.
    """
    outcomes = []
    _, x_in, y_in, heading, _ = encoders
    for echo in echoes:
        # By index: numba cannot unpack a row of an array.
        instant_s, sonar, reading_in = echo[0], int(echo[1]), echo[2]
        # 1. u, the step of the encoders to their pose at the instant of the echo.
        to_x, to_y, to_heading, turret = pose_at(poses, instant_s)
        distance, turn = relative_step(x_in, y_in, heading, to_x, to_y, to_heading)
        x_in, y_in, heading = to_x, to_y, to_heading
        # 2. x- = f(x, u), P- = F P F^T + G Q G^T.
        predict_state(x, P, distance, turn, noise, model.range_parameters)
        move_on(used, distance, turn)
        # 3. to 7. The update by the model, in place. For a ray (sonar_ray.update_by_ray):
        #        innovation = z - h(x-)
        #        S = H P- H^T + R,  K = P- H^T / S        R of the `count`-th reading of this sonar from here
        #        unless innovation^2 / S > threshold:
        #            x = x- + K innovation,  P = P- - K S K^T
        turret_offset = turret - to_heading
        mount, count = mount_at(model.mounts, sonar, turret_offset), count_used(used, sonar, turret_offset) + 1
        outcome = correct(x, P, mount, reading_in, model, count, used[-1][OUTLIERS])
        refusal, innovation, nis, outlier_probability, _, slope = outcome
        if refusal == NONE:
            record_used(used, sonar, turret_offset, count)
        # 8. Evidence of a slip of the wheels.
        if refusal in (NONE, GATE):
            count_outlier(used, outlier_probability)
            if len(slip_sums) > 0:
                add_slip_evidence(slip_sums, innovation, nis, slope)
        outcomes.append(outcome)
    return outcomes


class KalmanFilter:
    """Kalman filter over a pose, odometry parameters, and the errors that all readings have in common.

    For each echo, a scalar reading z at the end of a step u = (distance, turn) of the encoders, in order:

        1  step         u since the last echo                   odometry.py: pose_at, relative_step
        2  predict      x- = f(x, u)                            odometry.py: predict_state, jacobians (f, F, G)
                        P- = F P F^T + G Q G^T                  odometry.py: predict_state, process_variance (Q)
        3  expect       h(x-), H = dh/dx of the range           sonar_ray.py: predict_beam; sonar_cone.py: first_echoes
                        with offset and scale of readings       update.py: expected_reading
                        R, variance of z                        sonar_ray.py: range_variance
                        R of a repeated reading                 update.py: inflated_variance
        4  compare      innovation = z - h(x-)                  sonar_ray.py: update_by_ray; update.py: linear
        5  gain         S = H P- H^T + R,  K = P- H^T / S       update.py: kalman_gain
        6  gate, rays   NIS = innovation^2 / S <= threshold     sonar_ray.py: update_by_ray
           cones        beta_j, probability of reflector j      update.py: pda_update
        7  correct      x = x- + K innovation                   update.py: shift
                        P = P- - K S K^T                        belief.py: add_outer
        8  slip         evidence that the wheels slipped        health.py: add_slip_evidence
        9  heading,     evidence of another heading, once       heading_test.py: HeadingTest.correction
           cones        many readings are outliers

    A cone has 3 to 5 for each reflector j, and 7 for their mixture (`update.pda_update`). The iterated filter repeats
    3 to 5 at the most likely state (`update.iterated`). The unscented filter has sigma points for the derivatives: in 2
    `ukf.predict_state`, in 3 to 5 `ukf.unscented`.

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
        Limits of the monitor. Default: those of `HealthLimits`.

    References
    ----------
    Thrun, Burgard, Fox, Probabilistic Robotics (2005), table 3.3; Bar-Shalom, Li, Kirubarajan, Estimation with
    Applications to Tracking and Navigation (2001), table 5.2.4-1 for the form of P.
    """

    TAKES_RINGS: ClassVar[bool] = True
    """False: a subclass needs every prediction of its own."""

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
        self._measurement, self._odometry, self._predict = measurement, odometry, prediction
        self._odometric = measurement.odometric
        """The model, where it relates an echo to earlier ones and so needs each step: walls with levels."""
        # The state: `size` coordinates of pose and odometry parameters, then those that no step changes: the levels of
        # walls, and the range parameters.
        constant_stds = (*(self._odometric.level_stds if self._odometric else ()), *range_stds)
        state = with_constants(belief, constant_stds)
        self._size, self._constants, self._middle_in = len(belief.mean), len(constant_stds), middle_in
        self._has_scale = bool(range_stds)
        # The path of the echoes, as in the table at the head of this file.
        takes_rings = self.TAKES_RINGS and prediction is predict_state
        self._direct = measurement.direct if takes_rings else None
        """The model, where `filter_ring` takes a whole ring by it; None: `process_each`, one by one."""
        self._compiled = compiled.ring(filter_ring, widen_prediction, self._direct, odometry)
        """`filter_ring` as machine code, where that is wanted, with x and P in arrays; None: as plain Python, lists."""
        is_compiled = self._compiled is not None
        self._x: Any
        self._P: Any
        self._x, self._P = (state.mean.copy(), state.cov.copy()) if is_compiled else unpack(state)
        self._correlated = CorrelatedReadings(as_array=is_compiled)
        # The monitor of the estimate, and the outcomes that it judges by.
        self._monitor = IntegrityMonitor(limits, as_array=is_compiled)
        self._no_slips = self._monitor.slip.sums[:0]
        self._informative = INFORMATIVE_IN_CLUTTER if self._odometric else INFORMATIVE
        self.detects_slips = True
        model, has_limit = measurement.model, self._monitor.limits.heading_nats < inf
        self._headings = HeadingTest(model) if isinstance(model, ConeModel) and has_limit else None
        """The test of the heading; None for rays, whose ranges depend on it."""

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
        return self._monitor.health(self._P.tolist() if self._compiled else self._P)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report: x- = f(x, u), P- = F P F^T + G Q G^T."""
        if self._odometric:
            self._odometric.move(*true_step(self._x, distance_in, turn_rad, self._constants))
        self._predict(self._x, self._P, distance_in, turn_rad, self._odometry, self._constants)
        self._correlated.move(distance_in, turn_rad)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading of a sonar that fired at this very pose: x = x- + K (z - h(x-)).

        Only readings that are used can be repeated, and only informative ones enter the health.
        """
        count = self._correlated.count(sonar, turret_offset_rad) + 1
        outlier_fraction = self._correlated.outlier_fraction
        result = self._measurement.apply(
            self._x, self._P, sonar, turret_offset_rad, reading_in, count, outlier_fraction
        )
        if result.refusal is Refusal.NONE:
            self._correlated.record(sonar, turret_offset_rad)
        if result.refusal in (Refusal.NONE, Refusal.GATE):
            self._correlated.count_outlier(result.outlier_probability)
        if result.refusal in self._informative:
            self._monitor.add(result)
            if len(self._slip_sums):
                self._monitor.slip.add(result.innovation_in, result.nis, result.slope)
            self._check_slip()
        return result

    def process(
        self, encoders: EncoderRow, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho]
    ) -> Sequence[Outcome]:
        """Predict to the instant of each echo and update; see `process_each`."""
        if not echoes:
            return []
        if not self._direct:
            results = process_each(self, encoders, poses, echoes)
            if self._headings:
                self._check_heading(poses, echoes)
            return results
        noise, model, used, slips = self._odometry, self._direct, self._correlated.used, self._slip_sums
        # 1. A limit is no range: the filter passes over it. It predicts to the last echo in any case.
        low_in, high_in, ranges = model.noise.lowest_in, model.noise.highest_in, echoes
        if len(echoes) > 1:
            ranges = [echo for echo in echoes[:-1] if low_in < echo[READING] < high_in]
            ranges.append(echoes[-1])
        # 2. Predict to each range and correct by it.
        if self._compiled:
            results = self._compiled.filter(self._x, self._P, used, slips, encoders, poses, ranges)
        else:
            x, P = self._x, self._P
            results = filter_ring(x, P, used, slips, encoders, poses, ranges, noise, model, model.update)
        # 3. The monitor judges by the outcomes of ranges.
        informative = [outcome for outcome in results if outcome[REFUSAL] in self._informative]
        self._monitor.add_all(informative)
        if len(slips):
            self._monitor.slip.count_readings(len(informative))
        self._check_slip()
        if self._headings:
            self._check_heading(poses, echoes)
        # 4. The outcomes of all echoes.
        if len(ranges) == len(echoes):
            return results
        of_ranges = iter(results)
        return [
            next(of_ranges) if low_in < echo[READING] < high_in or echo is echoes[-1] else NO_RANGE for echo in echoes
        ]

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by what the filter leaves out of P.

        That is `widen_prediction`. The pose does not depend on the range parameters, of which the last is the scale.
        """
        nis_ratio, (_, slipped_in2) = self._monitor.nis_ratio, self._monitor.slip.slipped
        size, scale = self._size, self._x[-1] if self._has_scale else 0.0
        if self._compiled:
            return Belief(*self._compiled.predicted(
                self._x, self._P, size, distance_in, turn_rad, nis_ratio, lag, scale, self._middle_in, slipped_in2
            ))  # fmt: skip
        x, P = self._x[:size], [row[:size] for row in self._P[:size]]
        widen_prediction(
            x, P, distance_in, turn_rad, self._odometry, nis_ratio, lag, scale, self._middle_in, slipped_in2,
            self._predict,
        )  # fmt: skip
        return Belief(np.array(x), np.array(P))

    def roll_on_spot(self, distance_in: float) -> None:
        """Widen the belief by the noise of wheels that roll so far while something holds the robot."""
        widen_by_rolling(self._x, self._P, distance_in, self._odometry)

    @property
    def _slip_sums(self) -> SlipSums:
        """The sums of the test for slips; no rows where they are not looked for."""
        is_tested = self.detects_slips and self._monitor.limits.slip_nats < inf
        return self._monitor.slip.sums if is_tested else self._no_slips

    def _check_slip(self) -> None:
        """Widen the covariance by a slip of the wheels if the last readings agree on one."""
        slip_in = self._monitor.take_slip()
        if slip_in is not None:
            widen_by_slip(self._x, self._P, slip_in)

    def _check_heading(self, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho]) -> None:
        """Correct the heading, and the state with it, if many readings are outliers that agree on another heading."""
        assert self._headings is not None
        self._headings.add(poses, echoes)
        if self._correlated.outlier_fraction < MIN_OUTLIERS:
            return
        x, P = self._x, self._P
        turn_rad, evidence_nats = self._headings.correction(x, P)
        if evidence_nats < self._monitor.limits.heading_nats:
            return
        # x + K d, K = P_h / P_hh. P stays: readings that agree with both headings have narrowed it already.
        shift(x, [row[HEADING] / P[HEADING][HEADING] for row in P], turn_rad)
        self._headings.reset()
        self._correlated.forget_outliers()
        self._monitor.slip.reset()


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
        # 1. innovation = z - h - H x: of this reading after those before it, in the linear model.
        innovation = observation.innovation[..., beam] - sum(h * change for h, change in zip(H, x, strict=True))
        # 2. S = H P H^T + R, K = P H^T / S, x + K innovation, P - K S K^T.
        nis = nis + kalman_update(x, P, H, observation.R[..., beam], innovation)
    updated = pack([before + change for before, change in zip(np.moveaxis(belief.mean, -1, 0), x, strict=True)], P)
    updated.mean[..., HEADING] = wrap_angle(updated.mean[..., HEADING])
    return updated, nis
