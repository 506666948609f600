"""The Kalman filter that `nomad localize` runs: extended, iterated or unscented, one sonar reading at a time.

`KalmanFilter` lists the equations, and the function of each. Its methods (`registry`) process echoes differently:

    method, model             echoes of a ring              predicts by               corrects by
    ekf, rays                 filter_ring                   predict_state    sonar_ray.update_by_ray
    ekf, cones                filter_ring                   predict_state    sonar_cone.update_by_cone
    ekf, walls with levels    Filter.process                predict_state    surface.SurfaceUpdate.apply, update.linear
    iekf                      Filter.process                predict_state    update.pda_update, update.iterated
    ukf                       Filter.process                ukf.predict_state         update.pda_update, ukf.unscented
    smoother                  Filter.process                predict_state    as ekf

`filter_loop` has `filter_ring`, and `filter_state` from the echoes to the estimate that is reported. numba compiles it
where that is wanted (`compiled.filter_of`), with the same results to the bit.
`update_ring` applies the same Kalman update to whole rings of many robots at once, for the experiments.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import Any, ClassVar, Final

import numpy as np

from localization.filters import compiled, health, odometry, update
from localization.filters.base import Advance, EncoderRow, Filter, NewEcho
from localization.filters.belief import HEADING, Belief, Floats, marginal, pack, unpack, with_constants, wrap_angle
from localization.filters.filter_loop import FilterMemory, StateInput, filter_config, filter_state
from localization.filters.heading_test import MIN_OUTLIERS, HeadingTest
from localization.filters.health import FilterHealth, HealthLimits, IntegrityMonitor, Signs
from localization.filters.odometry import Lag, OdometryNoise, Prediction, predict_state
from localization.filters.sonar_cone import ConeModel
from localization.filters.sonar_ray import Observation
from localization.filters.surface import SurfaceModel
from localization.filters.update import OUTLIERS, MeasurementUpdate, Outcome, Refusal, UpdateResult

READING: Final = 2
"""Element of a `NewEcho`."""
NO_RANGE: Final[Outcome] = (update.LIMIT, 0.0, 0.0, 1.0, 1.0, 0.0)
"""The outcome of a limit, whose likelihood this filter does not need."""


class KalmanFilter(Filter):
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
        9  heading,     evidence of another heading; among      heading_test.py: HeadingTest.correction
           cones        planes once many readings are outliers

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

    def __init__(self, belief: Belief, measurement: MeasurementUpdate, odometry: OdometryNoise,
                 prediction: Prediction = predict_state, range_stds: Sequence[float] = (),
                 middle_in: tuple[float, float] = (0.0, 0.0), limits: HealthLimits | None = None) -> None:  # fmt: skip
        self._measurement, self._odometry, self._predict = measurement, odometry, prediction
        # The state: `size` coordinates of pose and odometry parameters, then those that no step changes: the levels of
        # walls, and the range parameters.
        constant_stds = (*measurement.level_stds, *range_stds)
        state = with_constants(belief, constant_stds)
        self._size, self._constants, self._middle_in = len(belief.mean), len(constant_stds), middle_in
        self._has_scale = bool(range_stds)
        # The path of the echoes, as in the table at the head of this file.
        takes_rings = self.TAKES_RINGS and prediction is predict_state
        self._direct = measurement.direct if takes_rings else None
        """The model, where `filter_state` takes a whole state by it; None: `Filter.process`, one by one."""
        limits = limits or HealthLimits()
        self._config = filter_config(odometry, self._direct, limits, middle_in) if self._direct else None
        self._compiled = compiled.filter_of(self._config)
        """`filter_state` as machine code, where that is wanted; None: as plain Python."""
        is_compiled = self._compiled is not None
        # The monitor of the estimate, and the outcomes that it judges by.
        self._monitor = IntegrityMonitor(limits, as_array=is_compiled)
        self._x: Any
        self._P: Any
        self._x, self._P = (state.mean.copy(), state.cov.copy()) if is_compiled else unpack(state)
        self._used = update.new_used(as_array=is_compiled)
        self._memory = FilterMemory(self._x, self._P, self._used, self._monitor.slip_sums, self._monitor.windows)
        self._has_slip_test = limits.slip_nats < inf
        noise = self._direct.noise if self._direct else None
        self._limits_in = (noise.lowest_in, noise.highest_in) if noise else (-inf, inf)
        self._signs: Signs | None = None
        """Signs of the present health; None: to be computed."""
        # Surfaces err by inches, and a wrong one alike in each reading: one along the axis of another is no new one.
        has_levels = bool(measurement.level_stds)
        self._informative = update.INFORMATIVE_IN_CLUTTER if has_levels else update.INFORMATIVE
        self._count_of = update.count_along_axis if has_levels else update.count_used
        model, has_limit = measurement.model, limits.heading_nats < inf
        surfaces = model if isinstance(model, SurfaceModel) else None
        cone = surfaces.cone if surfaces else model
        self._headings = HeadingTest(cone, surfaces) if isinstance(cone, ConeModel) and has_limit else None
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
        if self._signs is None:
            self._signs = self._monitor.signs(self._P)
        return self._monitor.judge(self._signs)

    def predict(self, distance_in: float, turn_rad: float) -> None:
        """Predict the belief after a step that the encoders report: x- = f(x, u), P- = F P F^T + G Q G^T."""
        self._signs = None
        # Walls with levels relate an echo to earlier ones.
        if self._measurement.level_stds:
            self._measurement.move(*odometry.true_step(self._x, distance_in, turn_rad, self._constants))
        self._predict(self._x, self._P, distance_in, turn_rad, self._odometry, self._constants)
        update.move_on(self._used, distance_in, turn_rad)

    def update(self, sonar: int, turret_offset_rad: float, reading_in: float) -> UpdateResult:
        """Correct the belief by a reading of a sonar that fired at this very pose: x = x- + K (z - h(x-)).

        Only readings that are used can be repeated, and only informative ones enter the health.
        """
        self._signs = None
        count, outlier_fraction = self._count_of(self._used, sonar, turret_offset_rad) + 1, self._used[-1][OUTLIERS]
        result = self._measurement.apply(self._x, self._P, sonar, turret_offset_rad, reading_in, count,
                                         outlier_fraction)
        if result.refusal is Refusal.NONE:
            update.record_used(self._used, sonar, turret_offset_rad, count)
        if result.refusal in (Refusal.NONE, Refusal.GATE):
            update.count_outlier(self._used, result.outlier_probability)
        if result.refusal in self._informative:
            self._monitor.add(result)
            if self.detects_slips and self._has_slip_test:
                self._monitor.add_innovation(result.innovation_in, result.nis, result.slope)
            # The last readings may agree on a slip of the wheels.
            if slip_in := self._monitor.take_slip():
                odometry.widen_by_slip(self._x, self._P, slip_in)
        return result

    def process(self, encoders: EncoderRow, poses: Sequence[EncoderRow],
                echoes: Sequence[NewEcho]) -> Sequence[Outcome]:
        """Predict to the instant of each echo and update; see `Filter.process`."""
        if not self._direct:
            outcomes = super().process(encoders, poses, echoes)
            if self._headings and echoes:
                self._check_heading(poses, echoes)
            return outcomes
        return self.advance(encoders, poses, echoes, 0.0)[0]

    def advance(self, encoders: EncoderRow, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho],
                clock_std_s: float) -> Advance:
        """Predict to the instant of each echo and update, then return the belief at the last pose: `filter_state`."""
        if not self._config:
            return super().advance(encoders, poses, echoes, clock_std_s)
        # 1. A limit is no range: the filter passes over it. It predicts to the last echo in any case.
        (low_in, high_in), ranges = self._limits_in, echoes
        if len(echoes) > 1:
            ranges = [echo for echo in echoes[:-1] if low_in < echo[READING] < high_in]
            ranges.append(echoes[-1])
        # 2. Predict to each range and correct by it; predict to the state.
        state = StateInput(encoders, poses, ranges, clock_std_s, self.detects_slips and self._has_slip_test)
        if self._compiled:
            outcomes, after, self._signs, belief = self._compiled.filter(self._memory, state, self._size)
        else:
            mean, cov = [0.0] * self._size, [[0.0] * self._size for _ in range(self._size)]
            correct = self._config.model.update
            outcomes, after, self._signs = filter_state(self._memory, state, self._config, correct, mean, cov)
            belief = Belief(np.array(mean), np.array(cov))
        # 3. Another heading: the prediction anew.
        if self._headings and echoes and self._check_heading(poses, echoes):
            lag = odometry.clock_lag(poses[max(len(poses) - 2, 0)], poses[-1], clock_std_s)
            belief = self.predicted(*odometry.relative_step(*after[1:4], *poses[-1][1:4]), lag)
        # 4. The outcomes of all echoes.
        if len(ranges) < len(echoes):
            of_ranges, last = iter(outcomes), echoes[-1]
            outcomes = [
                next(of_ranges) if low_in < echo[READING] < high_in or echo is last else NO_RANGE for echo in echoes
            ]
        return outcomes, after, belief

    def predicted(self, distance_in: float, turn_rad: float, lag: Lag = odometry.NO_LAG) -> Belief:
        """Return the belief after such a step, without taking it, widened by what the filter leaves out of P.

        That is `widen_prediction`. The pose does not depend on the range parameters, of which the last is the scale.
        """
        nis_ratio, (_, slipped_in2) = self._monitor.nis_ratio, health.slip_probability(self._monitor.slip_sums)
        scale = float(self._x[-1]) if self._has_scale else 0.0
        x, P = unpack(self.belief)
        odometry.widen_prediction(x, P, distance_in, turn_rad, self._odometry, nis_ratio, lag, scale, self._middle_in,
                                  slipped_in2, self._predict)  # fmt: skip
        return pack(x, P)

    def roll_on_spot(self, distance_in: float) -> None:
        """Widen the belief by the noise of wheels that roll so far while something holds the robot."""
        self._signs = None
        odometry.widen_by_rolling(self._x, self._P, distance_in, self._odometry)

    def _check_heading(self, poses: Sequence[EncoderRow], echoes: Sequence[NewEcho]) -> bool:
        """Correct the heading, and the state with it, if many readings are outliers that agree on another heading.

        Return True if they do.
        """
        assert self._headings is not None
        self._headings.add(poses, echoes)
        # In a building an echo that fits no wall is no outlier: their fraction may stay low with a wrong heading.
        if not self._measurement.level_stds and self._used[-1][OUTLIERS] < MIN_OUTLIERS:
            return False
        x, P = self._x, self._P
        turn_rad, evidence_nats = self._headings.correction(x, P)
        if evidence_nats < self._monitor.limits.heading_nats:
            return False
        # x + K d, K = P_h / P_hh. P stays: readings that agree with both headings have narrowed it already.
        update.shift(x, [row[HEADING] / P[HEADING][HEADING] for row in P], turn_rad)
        self._headings.reset()
        self._used[-1][OUTLIERS] = 0.0
        health.clear_slips(self._monitor.slip_sums)
        self._signs = None
        return True


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
        nis = nis + update.kalman_update(x, P, H, observation.R[..., beam], innovation)
    updated = pack([before + change for before, change in zip(np.moveaxis(belief.mean, -1, 0), x, strict=True)], P)
    updated.mean[..., HEADING] = wrap_angle(updated.mean[..., HEADING])
    return updated, nis
