"""What beams say about a state, and why some of them say nothing: what passes between gate and filter.

Rules: values only. The gate (gating) makes observations, a filter (ekf) takes them; neither knows the other.

What one reading may be of: so many things in the map, each with its range as a function of the pose.

Rules: values only. A sense (filters.sense) finds them, a rule of correction (updates) asks for their ranges elsewhere
than at the mean, the mixture weighs them; none knows the others.

How many readings of each sonar came from where the robot stands: what errs the same way each time is news once.

A reading's error has two parts: one of variance r, drawn anew each time, and one of variance c, which is the same as
long as the robot stands where it does (of readings in whole inches: the rounding). However many readings there are, a
range is not known better than c, while a filter that takes them for independent becomes surer and surer. Taken in one
by one, readings with weights w_1, w_2, ... are claimed to tell with variance 1 / W, W = sum w, and really do with
c + r sum w^2 / W^2. The largest weights for which the claim is true are w_1 = 1 / (c + r), w_n = (1 - 2 c W) w_1, so

    R_n = (c + r) / q^(n - 1)        q = (r - c) / (r + c)

and all together are worth 1 / (2 c). Where c is r or more, those after the first add nothing.

Rules: pure but for the counts; the encoders alone tell whether it stands.

Rules of correction: what a reading would make of a belief, for each thing it may be of. All of one interface.

    linear      the extended Kalman filter: one derivative, at the mean
    iterated    the derivative again where the last one led, to the most likely state: Gauss-Newton (Bell, Cathey 1993)
    unscented   no derivative: sigma points through the range itself

Of each candidate j they tell K_j, S_j and the move d_j of the mean, so that its hypothesis is (mean + d_j,
P - K_j S_j K_j'), and its density by S_j and NIS. Rules: pure; one belief, one scalar reading; which candidates there
are and how they are weighed is settled elsewhere.

One reading and several things it may be: an echo of this reflector or that one, or a bad reading of none.

    share_j  ~  (1 - bad) p_j N(z; h_j, S_j)      S_j = H_j P H_j' + R_j        share_0 ~ bad' / width
    mean'    =  mean + sum_j share_j K_j (z - h_j)
    P'       =  sum_j share_j (P_j + d_j d_j')    d_j: how far hypothesis j lies from mean'
             =  P + C diag(w) C'                  columns C: all K_j, w -share_j S_j; all d_j, w share_j

The gaussian with the first two moments of the mixture of all hypotheses: probabilistic data association (Bar-Shalom
and Tse 1975) with a reflector a hypothesis. bad' = bad + (1 - bad) (1 - sum p_j): what is heard of none is bad as
well. A bad reading pulls little and leaves the covariance larger: no gate decides between all and nothing.

K_j, S_j and d_j come from a rule of correction: linear (the above), iterated or unscented (updates).

Rules: pure; one belief, one scalar reading; states of any length n >= 3, the derivative by their constants being 0.

How a gaussian filter takes one reading in: a sense finds what it may be of, a rule of correction says what each of
that would make of the belief, the mixture puts it together.

Rules: pure; a belief in, a belief out, and the reason where a reading said nothing. Whoever hands them over has brought
the belief to the instant at which the sonar fired. States may be longer than a pose (see systematic).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from math import exp, nan, pi, sqrt
from operator import mul, sub
from typing import Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Belief, Floats, add, wrapped
from localization.filters.ukf import offsets, root_of, weights

Mask = npt.NDArray[np.bool_]
Codes = npt.NDArray[np.int8]


class Refusal(IntEnum):
    """Why a beam is left out. Where several hold, the first of this order is told."""

    NONE = 0
    LIMIT = 1
    """The reading is a limit, or no number at all: it says "no nearer" or "nothing", not how far."""
    NO_WALL = 2
    """The map has nothing where the beam points."""
    AMBIGUOUS_WALL = 3
    """From somewhere the robot may well be, the beam meets another wall."""
    GRAZING = 4
    """The beam strikes the wall at too flat an angle."""
    GATE = 5
    """The reading is farther from the expected one than chance explains."""


@dataclass(frozen=True, slots=True)
class Observation:
    """What n beams say about a state of m coordinates, ready for a correction.

    `innovation` (..., n), reading less expectation, inches; `jacobian` (..., n, m), the derivative of the expectation
    by the state; `variance` (..., n) of the readings, in^2; `refusals` (..., n) int8, a `Refusal` each. A beam left
    out has innovation 0, a row of zeros and variance 1: it says nothing, and arrays keep their shape.
    """

    innovation: Floats
    jacobian: Floats
    variance: Floats
    refusals: Codes

    @property
    def used(self) -> Mask:
        """Which beams may correct, (..., n)."""
        accepted: Mask = self.refusals == Refusal.NONE.value
        return accepted

    def reasons(self) -> tuple[Refusal, ...]:
        """The refusals of a single robot's beams, as words."""
        return tuple(Refusal(int(code)) for code in self.refusals.reshape(-1))


SPAN_IN: Final = 249.0
"""Bad readings lie anywhere from 6 to 255 inches."""
MOSTLY_BAD: Final = 0.5
"""A reading that is bad with more than this probability is told of as refused by the gate; its NIS says nothing."""


class UpdateResult(NamedTuple):
    """What became of a reading: why it said nothing (NONE: it did), reading less expectation (0 where nothing was
    expected) with its normalised square, and how likely it was a bad one."""

    refusal: Refusal
    innovation_in: float
    nis: float
    outlier_probability: float


def refusal_of(outlier_probability: float) -> Refusal:
    """What became of a reading that was so likely a bad one: refused by the gate, or taken."""
    return Refusal.GATE if outlier_probability > MOSTLY_BAD else Refusal.NONE


INFORMATIVE: Final = frozenset({Refusal.NONE, Refusal.NO_WALL, Refusal.GATE})
"""What becomes of readings that tell whether the belief is right; others are left out whatever they say."""


Expect = Callable[[Floats], tuple[Floats, Floats]]
"""Of poses (..., k, 3), a pose a candidate, or (..., 1, 3), one for all: the ranges (..., k) in inches, and their
derivative by the pose (..., k, 3)."""


class Hypotheses(NamedTuple):
    """k things that a reading may be of, and how likely it is of none.

    ranges_in, jacobian   (k,) and (k, 3) at the mean of the belief       variance   (k,) of readings of them, in^2
    constant              (k,) the part of it that is one error for all readings from one place (repeats)
    probability           (k,) that it is heard of this one, were no reading bad
    expect                ranges and derivatives anywhere else
    bad_share             of the readings that are of none of them whatever they are
    bad_density           of a bad reading, per inch
    """

    ranges_in: Floats
    jacobian: Floats
    variance: Floats
    constant: Floats
    probability: Floats
    expect: Expect
    outlier_probability: float
    bad_density: float

    def by_state(self, size: int) -> Floats:
        """The derivative (k, size) by a state that begins with the pose: 0 by the rest."""
        return widened(self.jacobian, size)


def widened(jacobian: Floats, size: int) -> Floats:
    """Derivatives (..., 3) by the pose as derivatives (..., size) by a longer state."""
    if jacobian.shape[-1] == size:
        return jacobian
    wide = np.zeros((*jacobian.shape[:-1], size))
    wide[..., : jacobian.shape[-1]] = jacobian
    return wide


SAME_IN, SAME_RAD = 0.25, 0.005
"""Moved or turned by more, a robot is elsewhere: a quarter of an inch on, readings in whole inches err otherwise."""
LEAST_WORTH: Final = 1e-12
"""Of the first reading's: as good as nothing."""


def inflated_variance(variance: Floats, constant: Floats, times: int) -> Floats:
    """R_n of the `times`-th reading from one place, of any shape: `variance` r + c of one reading, `constant` c."""
    worth: Floats = variance / np.maximum(information_fraction(variance, constant, times), LEAST_WORTH)
    return worth


def information_fraction(variance: Floats, constant: Floats, times: int) -> Floats:
    """q^(n - 1), 0 where c is r or more: what the `times`-th reading adds, as a share of what the first does."""
    share: Floats = np.maximum(1.0 - 2.0 * constant / variance, 0.0) ** (times - 1)
    return share


class _Taken(NamedTuple):
    """Where a sonar's reading was first taken in from a place (way and turn of the encoders so far, inches and radians;
    the turret against the heading), and how many were."""

    way_in: float
    turned_rad: float
    turret_rad: float
    number: int


class CorrelatedReadings:
    """See the head of this file. Only readings that were taken in count: one that was refused told nothing."""

    def __init__(self) -> None:
        self._way_in = self._turned_rad = 0.0
        self._taken: dict[int, _Taken] = {}

    def move(self, step: Floats) -> None:
        """The encoders told of a step (2,)."""
        way_in, turn_rad = step.tolist()
        self._way_in += abs(way_in)
        self._turned_rad += turn_rad

    def before(self, sonar: int, turret_offset_rad: float) -> int:
        """How many readings of this sonar have been taken in from here, the turret turned by so much against the
        heading."""
        taken = self._taken.get(sonar)
        return taken.number if taken and self._is_here(taken, turret_offset_rad) else 0

    def take(self, sonar: int, turret_offset_rad: float) -> None:
        """One more was."""
        before = self.before(sonar, turret_offset_rad)
        first = self._taken[sonar] if before else _Taken(self._way_in, self._turned_rad, turret_offset_rad, 0)
        self._taken[sonar] = first._replace(number=before + 1)

    def _is_here(self, place: _Taken, turret_offset_rad: float) -> bool:
        turned = self._turned_rad - place.turned_rad
        aimed = wrapped(turned + turret_offset_rad - place.turret_rad)
        return self._way_in - place.way_in <= SAME_IN and max(abs(turned), abs(aimed)) <= SAME_RAD


MOST_ITERATIONS: Final = 6
SETTLED: Final = 1e-6
"""The iteration ends when it moves by less than this, in standard deviations."""


class Corrections(NamedTuple):
    """For k candidates and states of n coordinates: `moves` and `gains`, k rows of n, `spread` of the innovation in
    in^2, `innovation` in inches, and `nis`: exp(-nis / 2) / sqrt(2 pi spread) is the reading's density. In plain
    numbers: so few of them are sooner done than arrays are made."""

    moves: list[list[float]]
    gains: list[list[float]]
    spread: list[float]
    innovation: list[float]
    nis: list[float]


Rule = Callable[[Belief, float, Hypotheses], Corrections]
"""Belief (mean (n,), cov (n, n)), reading in inches, what it may be of."""


def linear(belief: Belief, reading_in: float, heard: Hypotheses) -> Corrections:
    """H P H' + R and P H' / S at the mean."""
    by_x, by_y, by_heading = belief.cov[:3].tolist()
    taken = Corrections([], [], [], [], [])
    each = zip(heard.ranges_in.tolist(), heard.jacobian.tolist(), heard.variance.tolist(), strict=True)
    for range_in, (x, y, heading), variance in each:
        pull = [x * a + y * b + heading * c for a, b, c in zip(by_x, by_y, by_heading, strict=True)]
        spread = x * pull[0] + y * pull[1] + heading * pull[2] + variance
        innovation = reading_in - range_in
        taken.moves.append([part * (innovation / spread) for part in pull])
        taken.gains.append([part / spread for part in pull])
        taken.spread.append(spread)
        taken.innovation.append(innovation)
        taken.nis.append(innovation * innovation / spread)
    return taken


def iterated(belief: Belief, reading_in: float, heard: Hypotheses) -> Corrections:
    """The most likely state by Gauss-Newton, from the mean; a step that makes it less likely is not taken.

        d' = K_i (z - h(x_i) + H_i d_i)      cost = (z - h)^2 / R + d' P^-1 d

    d' P^-1 d = (S - R) (d / K)^2 where d is a multiple of the gain, so P is not inverted. The density is Laplace's
    approximation about that state: sqrt(|P'| / |P|) = sqrt(R / S), so NIS is the cost.
    """
    size = len(belief.mean)
    moves = np.zeros((len(heard.ranges_in), size))
    ranges, jacobian = heard.ranges_in, heard.by_state(size)
    cost = (reading_in - ranges) ** 2 / heard.variance
    std = np.maximum(belief.std, np.finfo(float).tiny)
    for _ in range(MOST_ITERATIONS):
        gains, spread = _gains(belief, jacobian, heard.variance)
        ahead = reading_in - ranges + (jacobian * moves).sum(axis=-1)
        proposed = gains * ahead[:, None]
        there, slope = heard.expect((belief.mean + proposed)[:, :3])
        off = reading_in - there
        new_cost = off * off / heard.variance + (spread - heard.variance) * (ahead / spread) ** 2
        better = new_cost < cost
        settled = not (better & (np.abs(proposed - moves) > SETTLED * std).any(axis=-1)).any()
        moves = np.where(better[:, None], proposed, moves)
        jacobian = np.where(better[:, None], widened(slope, size), jacobian)
        ranges, cost = np.where(better, there, ranges), np.where(better, new_cost, cost)
        if settled:
            break
    gains, spread = _gains(belief, jacobian, heard.variance)
    return _told(moves, gains, spread, reading_in - heard.ranges_in, cost)


def unscented(belief: Belief, reading_in: float, heard: Hypotheses) -> Corrections:
    """Mean, variance and covariance of the range with the state from sigma points."""
    weight = weights(len(belief.mean))
    away = offsets(root_of(belief.cov), weight.reach)
    ranges = heard.expect((belief.mean + away)[:, None, :3])[0]
    expected = weight.mean @ ranges
    off = ranges - expected
    spread = weight.cov @ (off * off) + heard.variance
    gains = (off * weight.cov[:, None]).T @ away / spread[:, None]
    innovation = reading_in - expected
    return _told(gains * innovation[:, None], gains, spread, innovation, innovation * innovation / spread)


def _told(moves: Floats, gains: Floats, spread: Floats, innovation: Floats, nis: Floats) -> Corrections:
    return Corrections(moves.tolist(), gains.tolist(), spread.tolist(), innovation.tolist(), nis.tolist())


def _gains(belief: Belief, jacobian: Floats, variance: Floats) -> tuple[Floats, Floats]:
    """K (k, n) and S (k,) of k scalar readings, each alone."""
    pull = jacobian @ belief.cov
    spread = (pull * jacobian).sum(axis=-1) + variance
    return pull / spread[:, None], spread


_TURN: Final = 2.0 * pi


class PdaResult(NamedTuple):
    """A belief that a reading has corrected, and how it was understood.

    shares            k + 1: how likely it was each candidate's, the last: bad
    likelihood        of the reading under the belief before it, per inch
    innovation_in     reading less what its likeliest candidate gives; nis its square over its variance. NaN for none
    """

    belief: Belief
    shares: list[float]
    likelihood: float
    innovation_in: float
    nis: float

    @property
    def outlier_probability(self) -> float:
        """How likely the reading was a bad one."""
        return self.shares[-1]


def pda_update(belief: Belief, reading_in: float, heard: Hypotheses, rule: Rule = linear, times: int = 1) -> PdaResult:
    """A belief (mean (n,), cov (n, n)) corrected by a reading that may be any of k candidates or a bad one.

    The `times`-th from the same place corrects by what it adds alone (repeats); what it is, is judged as ever.
    """
    moves, gains, spread, innovation, nis = rule(belief, reading_in, heard)
    good = 1.0 - heard.outlier_probability
    chances = heard.probability.tolist()
    weights = [
        good * chance * exp(-0.5 * square) / sqrt(_TURN * variance)
        for chance, variance, square in zip(chances, spread, nis, strict=True)
    ]
    bad = heard.bad_density * (1.0 - good * sum(chances))
    total = sum(weights) + bad
    shares = [weight / total for weight in (*weights, bad)]
    if times > 1:
        adding = heard._replace(variance=inflated_variance(heard.variance, heard.constant, times))
        moves, gains, spread, _, _ = rule(belief, reading_in, adding)
    change = [sum(map(mul, shares, column)) for column in zip(*moves, strict=True)] or [0.0] * len(belief.mean)
    columns = [(-share * variance, gain) for share, variance, gain in zip(shares, spread, gains, strict=False)]
    columns += [(share, list(map(sub, move, change))) for share, move in zip(shares, moves, strict=False)]
    columns.append((shares[-1], change))
    best = weights.index(max(weights)) if weights else None
    return PdaResult(
        Belief(add(belief.mean, np.array(change)), np.array(_with_columns(belief.cov.tolist(), columns))),
        shares,
        total,
        nan if best is None else innovation[best],
        nan if best is None else nis[best],
    )


def _with_columns(cov: list[list[float]], columns: list[tuple[float, list[float]]]) -> list[list[float]]:
    """A covariance, in place, with all w c c' of columns (w, c) added."""
    for weight, column in columns:
        for row, value in enumerate(column):
            share = weight * value
            told = cov[row]
            for at in range(row + 1):
                told[at] += share * column[at]
    for row in range(len(cov)):
        for at in range(row):
            cov[at][row] = cov[row][at]
    return cov


class Association(NamedTuple):
    """What a reading may be of, or why it says nothing.

    likelihood    where it is refused: how well the belief explains that
    besides       share of readings that are bad beside those the candidates tell of; for the likelihood alone
    """

    refusal: Refusal
    likelihood: float
    candidates: Hypotheses | None = None
    besides: float = 0.0


class MeasurementModel(Protocol):
    """A kind of sonar, in a map, on a body."""

    def sense(self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float) -> Association:
        """What sonar number `sonar` may have heard, the turret being turned by so much against the heading."""
        ...


class EchoResult(NamedTuple):
    """What a reading left: the belief, what became of it, and how well the belief before it explains it: a density per
    inch for a range, a chance for a limit; the same kind for the same reading, whatever the belief."""

    belief: Belief
    judgement: UpdateResult
    likelihood: float


class MeasurementUpdate:
    """A kind of sonar, in a map, on a body, with a rule of correction."""

    def __init__(self, sense: MeasurementModel, rule: Rule = linear) -> None:
        self._sense, self._rule = sense, rule

    def hear(
        self, belief: Belief, sonar: int, turret_offset_rad: float, reading_in: float, times: int = 1
    ) -> EchoResult:
        """Take in what sonar number `sonar` reads, the turret being turned by so much against the heading; the
        `times`-th of its readings that is taken in from this place (repeats)."""
        sensed = self._sense.sense(belief, sonar, turret_offset_rad, reading_in)
        if sensed.candidates is None:
            return EchoResult(belief, UpdateResult(sensed.refusal, 0.0, 0.0, 1.0), sensed.likelihood)
        taken = pda_update(belief, reading_in, sensed.candidates, self._rule, times)
        judgement = UpdateResult(
            refusal_of(taken.outlier_probability), taken.innovation_in, taken.nis, taken.outlier_probability
        )
        likelihood = (1.0 - sensed.besides) * taken.likelihood + sensed.besides / SPAN_IN
        return EchoResult(taken.belief, judgement, likelihood)
