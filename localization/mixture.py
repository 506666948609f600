"""One reading and several things it may be: an echo of this reflector or that one, or a bad reading of none.

    share_j  ~  (1 - bad) p_j N(z; h_j, S_j)      S_j = H_j P H_j' + R_j        share_0 ~ bad' / width
    mean'    =  mean + sum_j share_j K_j (z - h_j)
    P'       =  sum_j share_j (P_j + d_j d_j')    d_j: how far hypothesis j lies from mean'

The gaussian with the first two moments of the mixture of all hypotheses: probabilistic data association (Bar-Shalom
and Tse 1975) with a reflector a hypothesis. bad' = bad + (1 - bad) (1 - sum p_j): what is heard of none is bad as
well. A bad reading pulls little and leaves the covariance larger: no gate decides between all and nothing.

K_j, S_j and d_j come from a rule of correction: linear (the above), iterated or unscented (updates).

Rules: pure; one belief, one scalar reading; states of any length n >= 3, the derivative by their constants being 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from localization.belief import Belief, Floats, add
from localization.candidates import Candidates
from localization.updates import Rule, linear


class Absorbed(NamedTuple):
    """A belief that a reading has corrected, and how it was understood.

    shares            (k + 1,) how likely it was each candidate's, the last: bad
    likelihood        of the reading under the belief before it, per inch
    innovation_in     reading less what its likeliest candidate gives; nis its square over its variance. NaN for none
    """

    belief: Belief
    shares: Floats
    likelihood: float
    innovation_in: float
    nis: float

    @property
    def bad_share(self) -> float:
        """How likely the reading was a bad one."""
        return float(self.shares[-1])


def absorb(belief: Belief, reading_in: float, heard: Candidates, rule: Rule = linear) -> Absorbed:
    """A belief (mean (n,), cov (n, n)) corrected by a reading that may be any of k candidates or a bad one."""
    moves, gains, spread, innovation, nis = rule(belief, reading_in, heard)
    good = 1.0 - heard.bad_share
    bad = heard.bad_density * (1.0 - good * heard.probability.sum())
    weight = good * heard.probability * np.exp(-0.5 * nis) / np.sqrt(2.0 * np.pi * spread)
    total = float(weight.sum()) + bad
    weight /= total
    change = weight @ moves
    away = moves - change
    cov = belief.cov - (gains * (weight * spread)[:, None]).T @ gains
    cov += (away * weight[:, None]).T @ away + (bad / total) * np.outer(change, change)
    best = int(np.argmax(weight)) if len(weight) else None
    return Absorbed(
        Belief(add(belief.mean, change), 0.5 * (cov + cov.T)),
        np.append(weight, bad / total),
        total,
        float("nan") if best is None else float(innovation[best]),
        float("nan") if best is None else float(nis[best]),
    )
