"""Rules of correction: what a reading would make of a belief, for each thing it may be of. All of one interface.

    linear      the extended Kalman filter: one derivative, at the mean
    iterated    the derivative again where the last one led, to the most likely state: Gauss-Newton (Bell, Cathey 1993)
    unscented   no derivative: sigma points through the range itself

Of each candidate j they tell K_j, S_j and the move d_j of the mean, so that its hypothesis is (mean + d_j,
P - K_j S_j K_j'), and its density by S_j and NIS. Rules: pure; one belief, one scalar reading; which candidates there
are and how they are weighed is settled elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np

from localization.estimation.belief import Belief, Floats
from localization.estimation.candidates import Candidates, widened
from localization.estimation.sigma_points import offsets, root_of, weights

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


Rule = Callable[[Belief, float, Candidates], Corrections]
"""Belief (mean (n,), cov (n, n)), reading in inches, what it may be of."""


def linear(belief: Belief, reading_in: float, heard: Candidates) -> Corrections:
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


def iterated(belief: Belief, reading_in: float, heard: Candidates) -> Corrections:
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


def unscented(belief: Belief, reading_in: float, heard: Candidates) -> Corrections:
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
