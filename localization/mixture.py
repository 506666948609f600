"""One reading and several things it may be: an echo of this reflector or that one, or a bad reading of none.

    share_j  ~  (1 - bad) p_j N(z; h_j, S_j)      S_j = H_j P H_j' + R_j        share_0 ~ bad' / width
    mean'    =  mean + sum_j share_j K_j (z - h_j)
    P'       =  sum_j share_j (P_j + d_j d_j')    d_j: how far hypothesis j lies from mean'

The gaussian with the first two moments of the mixture of all hypotheses: probabilistic data association (Bar-Shalom
and Tse 1975) with a reflector a hypothesis. bad' = bad + (1 - bad) (1 - sum p_j): what is heard of none is bad as
well. A bad reading pulls little and leaves the covariance larger: no gate decides between all and nothing.

Rules: pure; one belief, one scalar reading; states of any length n >= 3, the derivative by their constants being 0.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from localization.belief import Belief, Floats, add
from localization.cone import ConeModel, Returns


class Absorbed(NamedTuple):
    """A belief that a reading has corrected, and how it was understood.

    shares            (k + 1,) how likely it was each reflector's, the last: bad
    likelihood        of the reading under the belief before it, per inch
    innovation_in     reading less what its likeliest reflector gives; nis its square over its variance. NaN for none
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


def absorb(belief: Belief, reading_in: float, returns: Returns, model: ConeModel) -> Absorbed:
    """A belief (mean (n,), cov (n, n)) corrected by a reading that may be any of the returns (k,) or a bad one."""
    able = np.flatnonzero(returns.probability)
    size = belief.mean.shape[-1]
    jacobian = np.zeros((len(able), size))
    jacobian[:, :3] = returns.jacobian[able]
    ranges = returns.ranges_in[able]
    innovation = reading_in - ranges
    pull = jacobian @ belief.cov
    spread = (pull * jacobian).sum(axis=-1) + model.variance(ranges)
    nis = innovation * innovation / spread
    good = 1.0 - model.bad_share
    probability = returns.probability[able]
    bad = model.bad_density * (1.0 - good * probability.sum())
    weight = good * probability * np.exp(-0.5 * nis) / np.sqrt(2.0 * np.pi * spread)
    weight /= (total := float(weight.sum()) + bad)
    gains = pull / spread[:, None]
    moves = gains * innovation[:, None]
    change = weight @ moves
    away = moves - change
    cov = belief.cov - (gains * (weight * spread)[:, None]).T @ gains
    cov += (away * weight[:, None]).T @ away + (bad / total) * np.outer(change, change)
    shares = np.zeros(len(returns.probability) + 1)
    shares[able], shares[-1] = weight, bad / total
    best = int(np.argmax(weight)) if len(able) else None
    return Absorbed(
        Belief(add(belief.mean, change), 0.5 * (cov + cov.T)),
        shares,
        total,
        float("nan") if best is None else float(innovation[best]),
        float("nan") if best is None else float(nis[best]),
    )
