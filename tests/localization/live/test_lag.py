"""The uncertain instants of a stepped clock, against drawn lags."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Floats, independent
from localization.filters.odometry import add_lag, move
from localization.live.localizer import clock_lag
from localization.live.sensor_input import CLOCK_STEP_S, EncoderPose


def encoders(clock_s: float, pose: Floats) -> EncoderPose:
    return EncoderPose.of(clock_s, pose, 0.0)


def test_the_lag_is_that_of_instants_within_one_step() -> None:
    """The encoders' frame is turned against the map's, and nearly once round."""
    pose, rates = np.array([3.0, -4.0, 0.7]), np.array([5.0, 0.3])
    rng = np.random.default_rng(1)
    # Clock and reading are each late by a uniform part of a step.
    late = CLOCK_STEP_S * (rng.uniform(0.0, 1.0, 200_000) - rng.uniform(0.0, 1.0, 200_000))
    drawn = move(pose, late[:, None] * rates)
    # Headings near pi: differences must wrap.
    before = np.array([10.0, 20.0, 3.13])
    lag = clock_lag(encoders(1.0, before), encoders(1.2, move(before, 0.2 * rates)))
    output = add_lag(independent(pose, np.zeros(3)), lag)
    # 200,000 draws determine the covariance to 1 %.
    np.testing.assert_allclose(output.cov, np.cov(drawn.T), rtol=0.01, atol=1e-7)
    assert (output.mean == pose).all()


def test_the_rest_of_a_state_and_the_belief_itself_stay() -> None:
    belief = independent([0.0, 0.0, 0.0, 0.01], [0.1, 0.1, 0.01, 0.05])
    before = belief.cov.copy()
    output = add_lag(belief, clock_lag(encoders(0.0, np.zeros(3)), encoders(0.5, np.array([10.0, 0.0, 0.0]))))
    assert output.cov[0, 0] == pytest.approx(0.1**2 + (20.0 * CLOCK_STEP_S) ** 2 / 6.0)
    assert output.cov[3, 3] == before[3, 3]
    assert (belief.cov == before).all()


def test_standing_robot_has_no_lag() -> None:
    belief = independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01])
    here = encoders(1.0, np.zeros(3))
    assert add_lag(belief, clock_lag(here, encoders(2.0, np.zeros(3)))) is belief
    assert add_lag(belief, clock_lag(here, here)) is belief
