"""The measurement update: a belief corrected by one sonar reading, and the reason where a reading is refused.

    1  a MeasurementModel predicts the reading       sonar_ray.RayModel, sonar_cone.ConeModel    -> Association
    2  a rule gives gain and innovation              linear (EKF), iterated, ukf.unscented       -> Correction
    3  pda_update combines all hypotheses            the Kalman update where there is one        -> UpdateResult

For each hypothesis j, that reading z is of reflector j, with expected range h_j, its derivative H_j and variance R_j:

    innovation_j = z - h_j        S_j = H_j P H_j^T + R_j        K_j = P H_j^T / S_j
    x+ = x + sum_j beta_j K_j innovation_j
    P+ = P - sum_j beta_j K_j S_j K_j^T + the spread of the means

A ring of echoes of a live filter takes these steps in `filter_loop.filter_ring`, by `sonar_ray.update_by_ray` or
`sonar_cone.update_by_cone`; other filters by `MeasurementUpdate`. States may be longer than a pose. The last two may be
errors that all readings have in common (RANGE_PARAMETERS): a reading is then expected at

    z = (1 + scale) range + offset        dz/dx = ((1 + scale) H, 1, range)
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from math import exp, nan, pi, sqrt
from typing import Any, Final, NamedTuple, Protocol

import numpy as np

from localization.filters.belief import (
    HEADING,
    POSE,
    Belief,
    Floats,
    Number,
    add_outer,
    pack,
    unit_vector,
    unpack,
    wrap_angle,
)
from worlds.rings import MAX_SONARS, SonarMount

State = list[float]
Covariance = list[list[float]]

OUTLIER_THRESHOLD: Final = 0.5
"""A reading that is an outlier with more than this probability is reported as refused by the gate. Where more than this
fraction of the last readings were outliers, such a reading corrects all the same: the pose may be wrong, not they."""
MIN_INFORMATION: Final = 1e-12
"""Information, as a fraction of the first reading's, that counts as none."""
SAME_POSE_IN, SAME_POSE_RAD = 0.25, 0.005
"""A robot that moved or turned by more is elsewhere: a quarter of an inch on, whole-inch readings round differently."""
RANGE_PARAMETERS: Final = 2
"""Coordinates at the end of a state, if it has them: the offset of all readings, inches, and their scale, the deviation
of the speed of sound from the assumed one, as a fraction."""
MAX_ITERATIONS: Final = 6
CONVERGED: Final = 1e-6
"""The iteration ends when the state changes by less than this, in standard deviations."""


class Refusal(IntEnum):
    """Reason why a reading is not used; the first that holds is reported.

    A cone's reading with GATE is taken for an outlier with more than half of its probability. It is used with the rest
    only where most of the last readings are outliers (`pda_update`), or in a building (`SurfaceUpdate.apply`).
    """

    NONE = 0
    LIMIT = 1
    """The reading is a limit, or no number: it means "so near or nearer" or "nothing", not a range. The Kalman filter
    leaves it out before the update; a filter that is still searching for its pose uses no reading, and returns this for
    each."""
    NO_WALL = 2
    """The map has nothing in this direction."""
    AMBIGUOUS_WALL = 3
    """Within the uncertainty of the pose, the beam may meet another wall."""
    GRAZING = 4
    """The beam meets the wall at too flat an angle."""
    GATE = 5
    """The innovation is larger than its variance explains."""


REFUSALS: Final = tuple(Refusal)
"""Reasons by their codes: formulas return codes, which are plain integers."""
NONE, LIMIT, NO_WALL, AMBIGUOUS_WALL, GRAZING, GATE = (refusal.value for refusal in Refusal)

INFORMATIVE: Final = (NONE, NO_WALL, GATE)
"""Outcomes that say whether the belief is right; the others depend on the geometry only."""
INFORMATIVE_IN_CLUTTER: Final = (NONE, GATE)
"""The same among things that the map does not have: an echo where the map has nothing is no sign of a wrong belief."""


Outcome = tuple[int, float, float, float, float, float]
"""An `UpdateResult` as formulas return it: refusal (a code), innovation_in, nis, outlier_probability, likelihood and
slope. A plain tuple: a named one takes longer to make, and there is one for each echo."""


class UpdateResult(NamedTuple):
    """Outcome of one reading.

    Attributes
    ----------
    refusal
        The reason why it was not used; NONE: it was.
    innovation_in
        Reading less expected range, inches; 0 where nothing was expected.
    nis
        Squared innovation over its variance.
    outlier_probability
        Probability that the reading was an outlier.
    likelihood
        Of the reading under the belief before it: a density per inch for a range and a probability for a limit, the
        same kind for the same reading, whatever the belief.
    slope
        Derivative of the expected range by a displacement of the robot along its heading.
    """

    refusal: Refusal
    innovation_in: float
    nis: float
    outlier_probability: float
    likelihood: float = 1.0
    slope: float = 0.0


def gate_code(outlier_probability: float) -> int:
    """Return GATE for a reading that is more probably an outlier than not, else NONE."""
    return GATE if outlier_probability > OUTLIER_THRESHOLD else NONE


# 1. What a reading may be of.

RangeFunction = Callable[[Floats], tuple[Floats, Floats]]
"""Ranges (..., k) in inches and their derivatives (..., k, 3), of poses (..., k, 3), one each, or (..., 1, 3)."""


class Association(NamedTuple):
    """The k reflectors of the map that a reading may be of, or the reason why it is refused.

    Attributes
    ----------
    refusal
        NONE, or the reason: then there are no hypotheses, and `likelihood` is the density of such a reading.
    ranges_in, H, R
        For each hypothesis the expected range, its derivative by the pose, and the variance of a reading, in^2.
    constant_variance
        The part of R that is one error for all readings from one pose (`inflated_variance`).
    probability
        Probability that the echo is of this reflector, if the reading is no outlier.
    range_function
        Range and derivative at other poses.
    range_parameters
        RANGE_PARAMETERS if the state ends with them, else 0: `H` then has their derivatives.
    outlier_probability, outlier_density
        Prior probability of an outlier, and its density per inch.
    gate_outliers
        Probability of outliers that the gate of the model decides about: only for the likelihood.
    range_span_in
        Such outliers lie anywhere in an interval of this length.
    """

    refusal: Refusal
    likelihood: float = 1.0
    ranges_in: Sequence[float] = ()
    H: Sequence[Sequence[float]] = ()
    R: Sequence[float] = ()
    constant_variance: Sequence[float] = ()
    probability: Sequence[float] = ()
    range_function: RangeFunction | None = None
    outlier_probability: float = 0.0
    outlier_density: float = 0.0
    gate_outliers: float = 0.0
    range_parameters: int = 0
    range_span_in: float = 1.0


class MeasurementModel(Protocol):
    """A kind of sonar, on a map, on a robot body."""

    def associate(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float,
                  reading_in: float) -> Association:
        """Return what sonar number `sonar` may have measured, the turret turned by so much against the heading."""


class ReadingLimits(Protocol):
    """The readings that are ranges (`sonar_ray.RangeNoise`): those between both limits."""

    @property
    def lowest_in(self) -> float:
        """Return the reading that means "so near or nearer"."""

    @property
    def highest_in(self) -> float:
        """Return the reading that means "nothing"."""


class DirectModel(MeasurementModel):
    """A model whose `update` does the association and the linear correction of a reading in one function.

    Attributes
    ----------
    mounts
        The sonars of the ring.
    noise
        Noise of the readings, with their limits.
    range_parameters
        RANGE_PARAMETERS if states end with them, else 0.
    update
        A function of x, P, mount from the heading, reading, this model, count and outlier fraction.
    """

    mounts: Sequence[SonarMount]
    noise: ReadingLimits
    range_parameters: int
    update: Callable[..., Outcome]


def mount_at(mounts: Sequence[Sequence[float]], sonar: int, turret_offset_rad: float) -> SonarMount:
    """Return the mount of a sonar of the ring, its direction from the heading."""
    mount = mounts[sonar]
    return SonarMount(turret_offset_rad + mount[0], mount[1], mount[2])


# 2. Gain and innovation of one hypothesis.


def forward_slope(H: Sequence[Any], c: Any, s: Any) -> Any:
    """Return the derivative of an expected reading by a displacement along the heading of this unit vector."""
    return H[0] * c + H[1] * s


def expected_reading(x: Sequence[Any], range_in: Any, H: Sequence[Any], range_parameters: int) -> tuple[Any, list[Any]]:
    """Return the reading that state x expects of a range, and its derivative by pose and range parameters.

    Parameters
    ----------
    range_in, H
        The range and its derivative by the pose.
    range_parameters
        RANGE_PARAMETERS, or 0: then the range is the reading.
    """
    a, b, c = H
    if range_parameters == 0:
        return range_in, [a, b, c]
    scale = 1.0 + x[-1]
    return scale * range_in + x[-2], [scale * a, scale * b, scale * c, 1.0, range_in]


def readings_at(association: Association, states: Floats) -> tuple[Floats, Floats]:
    """Return the expected readings (..., k) of k hypotheses at states (..., 1, n) or (..., k, n), and H (..., k, m)."""
    assert association.range_function is not None
    ranges, H = association.range_function(states[..., :POSE])
    x = list(np.moveaxis(states, -1, 0))
    readings, columns = expected_reading(x, ranges, list(np.moveaxis(H, -1, 0)), association.range_parameters)
    return readings, np.stack(np.broadcast_arrays(*columns), axis=-1)


def kalman_gain(P: Sequence[Sequence[Number]], H: Sequence[Number], R: Number) -> tuple[list[Number], Number]:
    """Return K = P H^T / S and S = H P H^T + R of a scalar reading.

    Parameters
    ----------
    P
        Covariance, n rows of n.
    H
        Derivative of the expected reading by the pose, then by the last coordinates; 0 by those between.
    R
        Variance of the reading.
    """
    if len(P) == POSE:
        K, S = pose_gain(P, H, R)
        return [K[0], K[1], K[2]], S
    a, b, c = H[0], H[1], H[2]
    if len(H) == POSE + RANGE_PARAMETERS:
        # The usual case of a live robot in one pass.
        d, e = H[3], H[4]
        PHt = [row[0] * a + row[1] * b + row[2] * c + row[-2] * d + row[-1] * e for row in P]
        S = PHt[0] * a + PHt[1] * b + PHt[2] * c + R + PHt[-2] * d + PHt[-1] * e
        return [value / S for value in PHt], S
    PHt = [row[0] * a + row[1] * b + row[2] * c for row in P]
    between = len(P) - len(H)
    for j in range(POSE, len(H)):
        PHt = [value + cov * H[j] for value, cov in zip(PHt, P[between + j])]  # noqa: B905  for numba
    S = PHt[0] * a + PHt[1] * b + PHt[2] * c + R
    for j in range(POSE, len(H)):
        S = S + PHt[between + j] * H[j]
    return [value / S for value in PHt], S


def pose_gain(P: Sequence[Sequence[Number]], H: Sequence[Number],
              R: Number) -> tuple[tuple[Number, Number, Number], Number]:
    """Return `kalman_gain` for a state that is a pose, without lists: they cost compiled code more than the numbers."""
    a, b, c = H[0], H[1], H[2]
    of_x, of_y, of_heading = P[0], P[1], P[2]
    x = of_x[0] * a + of_x[1] * b + of_x[2] * c
    y = of_y[0] * a + of_y[1] * b + of_y[2] * c
    heading = of_heading[0] * a + of_heading[1] * b + of_heading[2] * c
    S = x * a + y * b + heading * c + R
    return (x / S, y / S, heading / S), S


def shift(x: State, K: Sequence[float], innovation: float) -> None:
    """Add K innovation to x in place, the heading wrapped."""
    for i, gain in enumerate(K):
        x[i] += gain * innovation
    x[HEADING] = wrap_angle(x[HEADING])


def kalman_update(x: list[Number], P: list[list[Number]], H: Sequence[Number], R: Number, innovation: Number) -> Number:
    """Correct x and P by a scalar reading, in place; return its NIS. A heading is not wrapped.

    For the rings of `ekf.update_ring`; a filter that reads one echo at a time corrects by `pda_update`, which with a
    single certain hypothesis is the same.

    References
    ----------
    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation (2001), table 5.2.4-1.
    """
    # 1. K = P H^T / S.
    K, S = kalman_gain(P, H, R)
    return apply_gain(x, P, K, S, innovation)


def apply_gain(x: list[Number], P: list[list[Number]], K: Sequence[Number], S: Number, innovation: Number) -> Number:
    """Correct x and P by a gain, in place; return the NIS: steps 2 and 3 of `kalman_update`."""
    # 2. x+ = x + K innovation.
    for i, gain in enumerate(K):
        x[i] = x[i] + gain * innovation
    # 3. P+ = P - K S K^T.
    add_outer(P, -S, K)
    return innovation * innovation / S


class Correction(NamedTuple):
    """The correction of a state by one hypothesis: gain K, innovation and its variance S, NIS, and change dx of x.

    The hypothesis is then (x + dx, P - K S K^T); the density of the reading is exp(-nis / 2) / sqrt(2 pi S).
    """

    K: list[float]
    S: float
    innovation: float
    nis: float
    dx: list[float]


Rule = Callable[[State, Covariance, float, Association, Sequence[float]], list[Correction]]
"""Corrections for x, P, a reading in inches, its hypotheses, and the variance R of each."""


def linear(x: State, P: Covariance, reading_in: float, association: Association,  # noqa: ARG001  a rule has x
           variances: Sequence[float]) -> list[Correction]:
    """Return the corrections of the extended Kalman filter: one derivative, at x."""
    corrections = []
    for range_in, H, R in zip(association.ranges_in, association.H, variances):  # noqa: B905  for numba
        K, S = kalman_gain(P, H, R)
        innovation = reading_in - range_in
        dx = [gain * innovation for gain in K]
        corrections.append(Correction(K, S, innovation, innovation * innovation / S, dx))
    return corrections


def iterated(x: State, P: Covariance, reading_in: float, association: Association,
             variances: Sequence[float]) -> list[Correction]:
    """Return the corrections of the iterated extended Kalman filter: the derivative at the most likely state.

    Gauss-Newton from x, all hypotheses at once; a step that makes the state less likely is not taken:

        dx_i+1 = K_i (z - h(x_i) + H_i dx_i)      cost = (z - h)^2 / R + dx^T P^-1 dx

    dx is a multiple of the gain, so dx^T P^-1 dx = (S - R) (dx / K)^2 and P is not inverted. The density is Laplace's
    approximation about that state, sqrt(|P+| / |P|) = sqrt(R / S), so the NIS is the cost.

    References
    ----------
    Bell, Cathey, The iterated Kalman filter update as a Gauss-Newton method (1993).
    """
    mean, cov = np.array(x), np.array(P)
    ranges, R = np.array(association.ranges_in), np.array(variances)
    H = _widened(np.array(association.H).reshape(len(ranges), -1), len(x))
    dx = np.zeros((len(ranges), len(x)))
    std = np.maximum(np.sqrt(np.diagonal(cov)), np.finfo(float).tiny)
    cost = (reading_in - ranges) ** 2 / R
    for _ in range(MAX_ITERATIONS):
        # 1. A Gauss-Newton step.
        K, S = _gains(cov, H, R)
        ahead = reading_in - ranges + (H * dx).sum(axis=-1)
        proposed = K * ahead[:, None]
        # 2. Its cost; accept it where it is lower.
        new_ranges, new_H = readings_at(association, mean + proposed)
        new_cost = (reading_in - new_ranges) ** 2 / R + (S - R) * (ahead / S) ** 2
        better = new_cost < cost
        has_moved = (better & (np.abs(proposed - dx) > CONVERGED * std).any(axis=-1)).any()
        dx = np.where(better[:, None], proposed, dx)
        H = np.where(better[:, None], _widened(new_H, len(x)), H)
        ranges, cost = np.where(better, new_ranges, ranges), np.where(better, new_cost, cost)
        if not has_moved:
            break
    K, S = _gains(cov, H, R)
    innovation = [reading_in - range_in for range_in in association.ranges_in]
    return list(map(Correction, K.tolist(), S.tolist(), innovation, cost.tolist(), dx.tolist()))


def _gains(cov: Floats, H: Floats, R: Floats) -> tuple[Floats, Floats]:
    """Return `kalman_gain` of k scalar readings, each alone: K (k, n) and S (k,)."""
    K, S = kalman_gain([list(row) for row in cov], list(H.T), R)
    return np.stack(K, axis=-1), S


def _widened(H: Floats, n: int) -> Floats:
    """Return derivatives (k, m) by the pose and the last coordinates as derivatives (k, n) by the state."""
    wide = np.zeros((len(H), n))
    wide[:, :POSE] = H[:, :POSE]
    wide[:, n - H.shape[1] + POSE :] = H[:, POSE:]
    return wide


# 3. All hypotheses together.


class PdaResult(NamedTuple):
    """Result of the probabilistic data association of one reading.

    Attributes
    ----------
    beta
        Probability of each of the k hypotheses, and last of an outlier.
    likelihood
        Density of the reading under the belief before it, per inch.
    innovation_in, nis
        Of the most probable hypothesis; NaN without any.
    best
        Number of this hypothesis; -1 without any.
    """

    beta: list[float]
    likelihood: float
    innovation_in: float
    nis: float
    best: int


def association_probabilities(association: Association,
                              corrections: Sequence[Correction]) -> tuple[list[float], float, int]:
    """Return beta, likelihood and best of `PdaResult`: prior probability times likelihood, normalised.

    An echo of none of the reflectors is an outlier as well.
    """
    inlier, outlier, likelihood, best = 1.0 - association.outlier_probability, 1.0, 0.0, -1
    beta = [0.0 for _ in corrections]
    for j, correction in enumerate(corrections):
        prior = inlier * association.probability[j]
        beta[j] = prior * exp(-0.5 * correction.nis) / sqrt(2.0 * pi * correction.S)
        likelihood, outlier = likelihood + beta[j], outlier - prior
        if best < 0 or beta[j] > beta[best]:
            best = j
    beta.append(association.outlier_density * outlier)
    if len(corrections) == 1 and not association.outlier_density:
        beta = [1.0, 0.0]  # certain, however improbable
    else:
        likelihood += beta[-1]
        beta = [one / likelihood for one in beta]
    return beta, likelihood, best


def pda_update(x: State, P: Covariance, reading_in: float, association: Association, rule: Rule = linear,
               count: int = 1, outlier_fraction: float = 1.0) -> PdaResult:  # fmt: skip
    """Correct x and P by a reading that is of one of k reflectors or an outlier, in place.

    The result is the Gaussian with the mean and covariance of the mixture of all hypotheses. With one hypothesis and no
    outliers it is the Kalman update.

    Parameters
    ----------
    count
        Number of this reading among those from the same pose (`count_used`): later ones correct by what they
        add, but are associated like the first.
    outlier_fraction
        Of the last readings. While most fit, a probable outlier is of something that the map does not have and that is
        read again and again, and does not correct: each would widen P by the spread of the means, until an error of
        heading or offset explains them. Else the belief may be wrong, and it corrects by the rest of its probability.

    References
    ----------
    Bar-Shalom, Tse, Tracking in a cluttered environment with probabilistic data association (1975): equations of the
    PDA filter, with a reflector of the map for each validated measurement.
    """
    # 1. K, S and innovation of each hypothesis.
    corrections = rule(x, P, reading_in, association, association.R)
    # 2. beta_j.
    beta, likelihood, best = association_probabilities(association, corrections)
    innovation_in, nis = nan, nan
    if best >= 0:
        innovation_in, nis = corrections[best].innovation, corrections[best].nis
    if beta[-1] > OUTLIER_THRESHOLD and outlier_fraction <= OUTLIER_THRESHOLD:
        return PdaResult(beta, likelihood, innovation_in, nis, best)
    # 3. A repeated reading corrects with the variance that leaves its new information.
    if count > 1:
        parts = zip(association.R, association.constant_variance)  # noqa: B905  for numba
        inflated = [inflated_variance(R, constant, count) for R, constant in parts]
        corrections = rule(x, P, reading_in, association, inflated)
    # 4. x+ = x + dx, with dx = sum_j beta_j dx_j.
    dx = [0.0 for _ in x]
    for j, correction in enumerate(corrections):
        dx = [total + beta[j] * change for total, change in zip(dx, correction.dx)]  # noqa: B905  for numba
    shift(x, dx, 1.0)  # gain and innovation are in dx
    # 5. P+ = P - sum_j beta_j K_j S_j K_j^T + sum_j beta_j (dx_j - dx) (dx_j - dx)^T: an outlier leaves x as it is.
    for j, correction in enumerate(corrections):
        add_outer(P, -beta[j] * correction.S, correction.K)
        if beta[j] < 1.0:
            spread = [one - change for one, change in zip(correction.dx, dx)]  # noqa: B905  for numba
            add_outer(P, beta[j], spread)
    if beta[-1]:
        add_outer(P, beta[-1], dx)
    return PdaResult(beta, likelihood, innovation_in, nis, best)


# Repeated readings from one pose.


def information_fraction(variance: float, constant: float, count: int) -> float:
    """Return what the `count`-th reading from one pose adds, as a fraction of the information of the first.

    A reading's error has a part of variance r that is drawn each time, and a part of variance c (`constant`) that stays
    as long as the robot stands (of readings in whole inches: the rounding). A filter that takes such readings for
    independent becomes overconfident. Readings with weights w_1, w_2, ... claim the variance 1 / W, W = sum w, but have
    c + r sum w^2 / W^2. The largest weights for which the claim is true are w_1 = 1 / (c + r), w_n = (1 - 2 c W) w_1:
    the fraction is q^(n - 1), q = (r - c) / (r + c), and all readings together add up to 1 / (2 c).
    """
    return max(1.0 - 2.0 * constant / variance, 0.0) ** (count - 1)


def inflated_variance(variance: float, constant: float, count: int) -> float:
    """Return the variance with which the `count`-th reading from one pose corrects (`information_fraction`)."""
    return variance / max(information_fraction(variance, constant, count), MIN_INFORMATION)


Used = list[list[float]] | Floats
"""For each sonar a row of the first reading that was used from the present pose (`TRAVEL`, ...), and a last row with
travel and turn so far, and the fraction of outliers among the last readings. Lists for plain Python, an array for
compiled code."""
TRAVEL, TURN, TURRET, COUNT = range(4)
"""Columns of a sonar's row, for the first reading that was used from its pose: inches travelled and radians turned
until this reading, the turret against the heading in radians, and the number of readings used from its pose."""
OUTLIERS: Final = 2
"""Column of the last row: the recent fraction of outliers."""
OUTLIER_MEMORY: Final = 16.0
"""Readings over which it is the mean, with exponential weights: those of a round of the ring."""


def new_used(sonars: int = MAX_SONARS, *, as_array: bool = False) -> Used:
    """Return the rows before the first reading, as an array for compiled code."""
    rows = [[0.0] * 4 for _ in range(sonars + 1)]
    return np.array(rows) if as_array else rows


def move_on(used: Used, distance_in: float, turn_rad: float) -> None:
    """Take note of a step of the encoders, from which alone it follows that the robot stands."""
    so_far = used[-1]
    so_far[TRAVEL] += abs(distance_in)
    so_far[TURN] += turn_rad


def count_used(used: Used, sonar: int, turret_offset_rad: float) -> int:
    """Return how many readings of this sonar were used from this pose, along this axis."""
    is_here = abs(used[-1][TURN] - used[sonar][TURN]) <= SAME_POSE_RAD
    return count_along_axis(used, sonar, turret_offset_rad) if is_here else 0


def count_along_axis(used: Used, sonar: int, turret_offset_rad: float) -> int:
    """Return how many readings of this sonar were used from this place, along this axis.

    The robot may have turned below its turret meanwhile: another heading, but an echo of the same spot.
    """
    first, so_far = used[sonar], used[-1]
    turned_rad = so_far[TURN] - first[TURN] + turret_offset_rad - first[TURRET]
    is_here = so_far[TRAVEL] - first[TRAVEL] <= SAME_POSE_IN and abs(wrap_angle(turned_rad)) <= SAME_POSE_RAD
    return int(first[COUNT]) if is_here else 0


def record_used(used: Used, sonar: int, turret_offset_rad: float, count: int) -> None:
    """Record the `count`-th reading used from here."""
    first, so_far = used[sonar], used[-1]
    if count == 1:
        first[TRAVEL], first[TURN], first[TURRET] = so_far[TRAVEL], so_far[TURN], turret_offset_rad
    first[COUNT] = float(count)


def count_outlier(used: Used, outlier_probability: float) -> None:
    """Take note of a range that was an outlier with this probability."""
    so_far = used[-1]
    so_far[OUTLIERS] += (outlier_probability - so_far[OUTLIERS]) / OUTLIER_MEMORY


class MeasurementUpdate:
    """The update of a belief by one reading: a measurement model and a rule of correction.

    The caller has predicted the belief to the instant at which the sonar fired.
    """

    def __init__(self, model: MeasurementModel, rule: Rule = linear) -> None:
        self.model, self._rule = model, rule
        self.direct = model if isinstance(model, DirectModel) and rule is linear else None
        """The model, where it updates by the linear rule itself: in one function, which can be compiled."""

    @property
    def level_stds(self) -> tuple[float, ...]:
        """Prior standard deviations of the model's own coordinates of the state, before the range parameters."""
        return ()

    def move(self, distance_in: float, turn_rad: float) -> None:
        """Take note of a step of the robot, for a model that relates echoes to earlier ones."""

    def apply(self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float, count: int = 1,
              outlier_fraction: float = 1.0) -> UpdateResult:  # fmt: skip
        """Correct x and P in place by a reading, the `count`-th one used from this pose.

        Parameters
        ----------
        sonar
            Number of the sonar on the ring.
        turret_offset_rad
            Angle of the turret against the heading.
        reading_in
            Inches, its calibration offset subtracted.
        outlier_fraction
            Of the last readings (`pda_update`).
        """
        direct = self.direct
        if direct:
            mount = mount_at(direct.mounts, sonar, turret_offset_rad)
            return result_of(direct.update(x, P, mount, reading_in, direct, count, outlier_fraction))
        association = self.model.associate(x, P, sonar, turret_offset_rad, reading_in)
        if association.refusal is not Refusal.NONE:
            return UpdateResult(association.refusal, 0.0, 0.0, 1.0, association.likelihood)
        outcome = update_by_association(x, P, reading_in, association, self._rule, count, outlier_fraction)
        return result_of(outcome)

    def updated(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float,
                count: int = 1) -> tuple[Belief, UpdateResult]:
        """Return the belief after `apply`, and its result."""
        x, P = unpack(belief)
        outcome = self.apply(x, P, sonar, turret_offset_rad, reading_in, count)
        return pack(x, P), outcome


def update_by_association(x: State, P: Covariance, reading_in: float, association: Association, rule: Rule, count: int,
                          outlier_fraction: float = 1.0) -> Outcome:  # fmt: skip
    """Correct x and P by a reading and its hypotheses, in place."""
    c, s = unit_vector(x[HEADING])
    beta, likelihood, innovation_in, nis, best = pda_update(
        x, P, reading_in, association, rule, count, outlier_fraction
    )
    outlier, share = beta[-1], association.gate_outliers
    likelihood = (1.0 - share) * likelihood + share / association.range_span_in
    slope = forward_slope(association.H[best], c, s) if best >= 0 else 0.0
    return gate_code(outlier), innovation_in, nis, outlier, likelihood, slope


def result_of(outcome: Outcome) -> UpdateResult:
    """Return an outcome as a result."""
    return UpdateResult(REFUSALS[outcome[0]], *outcome[1:])
