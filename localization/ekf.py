"""The extended Kalman filter: two functions and a value (belief.Belief).

Rules: pure; no map, no sensor, no gate, no clock. Which beams may correct is settled before (observation.Observation).
Leading dimensions are independent filters.

    predict   mean' = move(mean, step)             P' = F P F' + Q
    correct   K = P H' (H P H' + R)^-1             mean' = mean + K innovation
              P' = (I - K H) P (I - K H)' + K R K'   (Joseph: symmetric, never negative, whatever rounding does to K)

R is diagonal, so K is worked out as (I + P A)^-1 P H' R^-1 with A = H' R^-1 H (the matrix inversion lemma): one system
as large as the state instead of one as large as the ring.
"""

from __future__ import annotations

import numpy as np

from localization.belief import Belief, Floats, add, difference
from localization.motion import OdometryNoise, move, transition
from localization.observation import Observation


def predict(belief: Belief, step: Floats, noise: OdometryNoise) -> Belief:
    """The belief after steps (..., 2) of drho_in and dtheta_rad that the encoders report; state x, y, heading."""
    by_pose, process_cov = transition(belief.mean, step, noise)
    cov = by_pose @ belief.cov @ np.swapaxes(by_pose, -1, -2) + process_cov
    return Belief(move(belief.mean, step), _symmetric(cov))


def correct(belief: Belief, observation: Observation) -> Belief:
    """The belief after an observation of n beams; any state of three coordinates or more."""
    by_state = observation.jacobian
    weighted = np.swapaxes(by_state / observation.variance[..., None], -1, -2)
    identity = np.eye(belief.mean.shape[-1])
    gain = np.linalg.solve(identity + belief.cov @ (weighted @ by_state), belief.cov) @ weighted
    kept = identity - gain @ by_state
    noise = (gain * observation.variance[..., None, :]) @ np.swapaxes(gain, -1, -2)
    cov = kept @ belief.cov @ np.swapaxes(kept, -1, -2) + noise
    change = (gain @ observation.innovation[..., None])[..., 0]
    return Belief(add(belief.mean, change), _symmetric(cov))


def innovation_squared(before: Belief, after: Belief, observation: Observation) -> Floats:
    """NIS (...): innovation' S^-1 innovation of a correction from `before` to `after`.

    As many degrees of freedom as beams used. S^-1 innovation = R^-1 (innovation - H K innovation), and K innovation is
    what the correction added, so nothing is inverted.
    """
    change = difference(after.mean, before.mean)
    rest = observation.innovation - (observation.jacobian @ change[..., None])[..., 0]
    nis: Floats = (observation.innovation * rest / observation.variance).sum(axis=-1)
    return nis


def _symmetric(cov: Floats) -> Floats:
    """Rounding leaves the two halves of a covariance a few bits apart; their mean."""
    mean: Floats = 0.5 * (cov + np.swapaxes(cov, -1, -2))
    return mean
