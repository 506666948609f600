"""One reading and several things it may be: an echo of this reflector or that one, or a bad reading of none.

    share_j  ~  (1 - bad) p_j N(z; h_j, S_j)      S_j = H_j P H_j' + R_j        share_0 ~ bad' / width
    mean'    =  mean + sum_j share_j K_j (z - h_j)
    P'       =  sum_j share_j (P_j + d_j d_j')    d_j: how far hypothesis j lies from mean'
             =  P + C diag(w) C'                  columns C: all K_j, w -share_j S_j; all d_j, w share_j

The gaussian with the first two moments of the mixture of all hypotheses: probabilistic data association (Bar-Shalom
and Tse 1975) with a reflector a hypothesis. bad' = bad + (1 - bad) (1 - sum p_j): what is heard of none is bad as
well. A bad reading pulls little and leaves the covariance larger: no gate decides between all and nothing.

K_j, S_j and d_j come from a rule of correction: linear (the above), iterated or unscented (updates).

Rules: pure; one belief, one scalar reading; states of any length n >= 3, the derivative by their constants being 0.
"""

from __future__ import annotations

from math import exp, nan, pi, sqrt
from operator import mul, sub
from typing import Final, NamedTuple

import numpy as np

from localization.estimation.belief import Belief, add
from localization.estimation.candidates import Candidates
from localization.estimation.repeats import nth_variance
from localization.estimation.updates import Rule, linear

_TURN: Final = 2.0 * pi


class Absorbed(NamedTuple):
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
    def bad_share(self) -> float:
        """How likely the reading was a bad one."""
        return self.shares[-1]


def absorb(
    belief: Belief, reading_in: float, heard: Candidates, rule: Rule = linear, times: int = 1
) -> Absorbed:
    """A belief (mean (n,), cov (n, n)) corrected by a reading that may be any of k candidates or a bad one.

    The `times`-th from the same place corrects by what it adds alone (repeats); what it is, is judged as ever.
    """
    moves, gains, spread, innovation, nis = rule(belief, reading_in, heard)
    good = 1.0 - heard.bad_share
    chances = heard.probability.tolist()
    weights = [
        good * chance * exp(-0.5 * square) / sqrt(_TURN * variance)
        for chance, variance, square in zip(chances, spread, nis, strict=True)
    ]
    bad = heard.bad_density * (1.0 - good * sum(chances))
    total = sum(weights) + bad
    shares = [weight / total for weight in (*weights, bad)]
    if times > 1:
        adding = heard._replace(variance=nth_variance(heard.variance, heard.constant, times))
        moves, gains, spread, _, _ = rule(belief, reading_in, adding)
    change = [sum(map(mul, shares, column)) for column in zip(*moves, strict=True)] or [0.0] * len(belief.mean)
    columns = [(-share * variance, gain) for share, variance, gain in zip(shares, spread, gains, strict=False)]
    columns += [(share, list(map(sub, move, change))) for share, move in zip(shares, moves, strict=False)]
    columns.append((shares[-1], change))
    best = weights.index(max(weights)) if weights else None
    return Absorbed(
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
