"""The uncertain instants of a stepped clock, against drawn lags."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.belief import Floats, independent
from localization.filters.odometry import add_lag, clock_lag, move
from localization.live.localizer import LAG_STD_S
from localization.live.sensor_input import CLOCK_STEP_S, EncoderPose, PoseHistory, clock_error


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
    lag = clock_lag(encoders(1.0, before), encoders(1.2, move(before, 0.2 * rates)), LAG_STD_S)
    output = add_lag(independent(pose, np.zeros(3)), lag)
    # 200,000 draws determine the covariance to 1 %.
    np.testing.assert_allclose(output.cov, np.cov(drawn.T), rtol=0.01, atol=1e-7)
    assert (output.mean == pose).all()


def test_the_rest_of_a_state_and_the_belief_itself_stay() -> None:
    belief = independent([0.0, 0.0, 0.0, 0.01], [0.1, 0.1, 0.01, 0.05])
    before = belief.cov.copy()
    lag = clock_lag(encoders(0.0, np.zeros(3)), encoders(0.5, np.array([10.0, 0.0, 0.0])), LAG_STD_S)
    output = add_lag(belief, lag)
    # The difference of two uniform times of one step has a variance of a sixth of its square; 10 in in 0.5 s are 20
    # in/s.
    assert output.cov[0, 0] == pytest.approx(0.1**2 + (20.0 * CLOCK_STEP_S) ** 2 / 6.0)
    assert output.cov[3, 3] == before[3, 3]
    assert (belief.cov == before).all()


def test_standing_robot_has_no_lag() -> None:
    belief = independent([0.0, 0.0, 0.0], [0.1, 0.1, 0.01])
    here = encoders(1.0, np.zeros(3))
    assert add_lag(belief, clock_lag(here, encoders(2.0, np.zeros(3)), LAG_STD_S)) is belief
    assert add_lag(belief, clock_lag(here, here, LAG_STD_S)) is belief


@pytest.mark.parametrize("rates", [[5.0, 0.3], [0.0, -0.8], [5.0, 0.0]])
def test_late_clock_shows_in_the_motion_of_the_encoders(rates: list[float]) -> None:
    start, late_s = np.array([3.0, -4.0, 3.1]), 0.03
    before, middle, after = (move(start, time_s * np.array(rates)) for time_s in (0.0, 0.1, 0.2))
    # The clock of the middle state is late, and its neighbours are right.
    error_s = clock_error(encoders(1.0, before), encoders(1.1 + late_s, middle), encoders(1.2, after))
    assert error_s == pytest.approx(late_s, rel=1e-3)
    assert clock_error(encoders(1.0, start), encoders(1.1 + late_s, start), encoders(1.2, start)) == 0.0


@pytest.mark.parametrize(("late_s", "is_uneven"), [(0.0, False), (CLOCK_STEP_S, False), (0.1, True)])
def test_spread_of_late_clocks_is_estimated(late_s: float, is_uneven: bool) -> None:
    rng, history, spread_s = np.random.default_rng(4), PoseHistory(), []
    for number in range(400):
        time_s = 0.1 * number
        pose = move(np.zeros(3), time_s * np.array([5.0, 0.0]))
        history.add(encoders(time_s + late_s * float(rng.random()), pose))
        spread_s.append(history.clock_std_s)
        if number > 50:
            assert history.is_uneven is is_uneven
    # A uniform error of a length has its standard deviation over sqrt(12).
    assert np.mean(spread_s[50:]) == pytest.approx(late_s / np.sqrt(12.0), rel=0.15)
    if is_uneven:
        # Its length again, and the mean square of what it draws.
        assert history.clock_late_s == pytest.approx(late_s, rel=0.3)
        drawn_s = history.clock_late_s * rng.random(10_000)
        assert history.clock_rms_s == pytest.approx(np.sqrt(np.mean(drawn_s**2)), rel=0.05)
    else:
        assert history.clock_late_s == history.clock_rms_s == 0.0


@pytest.mark.parametrize("touching", [True, False])
def test_wheels_that_slip_at_a_wall_show_nothing_of_the_clock(touching: bool) -> None:
    """A robot at a wall stands; every 10 s its wheels slip by 3 in, half an inch in a period."""
    history, x_in = PoseHistory(), 0.0
    for number in range(1000):
        x_in += 0.5 if number % 100 < 6 else 0.0
        history.add(encoders(0.1 * number, np.array([x_in, 0.0, 0.0])), touching)
    assert history.is_uneven is not touching


def test_nearly_equal_clocks_are_no_great_speed() -> None:
    """A robot at 5 in/s, states every 0.1 s, clocks late by up to 0.1 s: the lag is at most that of its speed."""
    # The reading belongs to any time of 0.1 s: a standard deviation of 0.1 / sqrt(3) from its end.
    std_s = 0.1 / np.sqrt(3.0)
    ahead_in, _ = clock_lag(encoders(1.0, np.zeros(3)), encoders(1.001, np.array([0.5, 0.0, 0.0])), std_s)
    assert ahead_in == pytest.approx(5.0 * std_s)
