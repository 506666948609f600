"""The sequential test: log likelihoods by hand, and wrong winners no more often than Ville's bound."""

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np
import pytest

from localization.filters import global_localization as module
from localization.filters.belief import Belief, independent
from localization.filters.global_localization import DECISION_NATS, SequentialTest, Side
from localization.filters.odometry import OdometryNoise, predict
from localization.filters.pose_search import EchoRecord
from localization.filters.update import Association, Covariance, MeasurementUpdate, Refusal, State

STD_IN, SPAN_IN = 1.5, 249.0
NOISE = OdometryNoise(0.1, 0.1, 0.005)


class Wall:
    """All sonars read a robot's x with STD_IN; beliefs do not change. `seen` records the readings."""

    def __init__(self) -> None:
        self.seen: list[tuple[int, float, float]] = []

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        del P
        self.seen.append((sonar, turret_offset_rad, reading_in))
        return Association(Refusal.GATE, density(reading_in, x[0]))


def density(reading_in: float, x_in: float) -> float:
    """Of a gaussian."""
    return exp(-0.5 * ((reading_in - x_in) / STD_IN) ** 2) / (STD_IN * sqrt(2.0 * pi))


def at(x_in: float) -> Belief:
    return independent([x_in, 0.0, 0.0], [0.5, 0.5, 0.03])


def record(reading_in: float) -> EchoRecord:
    return EchoRecord(np.zeros(3), 0.0, 0, 0.0, reading_in)


def test_each_side_gains_the_log_likelihood_of_an_echo() -> None:
    sequential = SequentialTest(at(52.0), at(90.0), MeasurementUpdate(Wall()), NOISE)
    # A reading near 52, one near 90, and one of neither.
    for reading, here in ((51.0, 0.2), (90.0, 0.0), (30.0, 0.01)):
        sequential.update(record(reading), here)
    # Three tenths of readings are outliers, spread evenly over the span of the sensor.
    bad = 0.3 / SPAN_IN
    expected = {
        Side.HERE: log(0.7 * 0.2 + bad) + log(bad) + log(0.7 * 0.01 + bad),
        Side.NEAR: log(0.7 * density(51.0, 52.0) + bad) + 2.0 * log(bad),
        Side.ELSEWHERE: log(bad) + log(0.7 * density(90.0, 90.0) + bad) + log(bad),
    }
    # The lead is that of the best over the second best side.
    first, second = sorted(expected.values())[:0:-1]
    assert sequential.echoes == 3
    assert sequential.lead_nats == pytest.approx(first - second)
    assert sequential.winner is None


def test_missing_echo_has_a_probability() -> None:
    sequential = SequentialTest(None, at(90.0), MeasurementUpdate(Wall()), NOISE)
    sequential.update(record(255.0), 1.0)
    assert sequential.lead_nats == pytest.approx(log(1.0 / 0.3))


def test_alternatives_are_predicted_and_updated() -> None:
    wall, step = Wall(), np.array([2.0, 0.3])
    sequential = SequentialTest(at(52.0), at(90.0), MeasurementUpdate(wall), NOISE)
    # Both alternatives move with the robot.
    sequential.predict(*step.tolist())
    sequential.update(EchoRecord(np.zeros(3), 0.5, 7, 0.2, 50.0), 0.1)
    for side, x_in in ((Side.NEAR, 52.0), (Side.ELSEWHERE, 90.0)):
        moved = predict(at(x_in), step, NOISE)
        np.testing.assert_array_equal(sequential.belief(side).mean, moved.mean)
        np.testing.assert_array_equal(sequential.belief(side).cov, moved.cov)
    # Each is updated with the reading, sonar and turret offset of the record.
    assert wall.seen == [(7, 0.2, 50.0)] * 2


@pytest.mark.parametrize(("true_in", "winner"), [(50.0, Side.HERE), (54.0, Side.NEAR), (90.0, Side.ELSEWHERE)])
def test_the_right_side_wins_after_a_handful_of_echoes(true_in: float, winner: Side) -> None:
    rng = np.random.default_rng(4)
    sequential = SequentialTest(at(54.0), at(90.0), MeasurementUpdate(Wall()), NOISE)
    while sequential.winner is None:
        reading = true_in + STD_IN * float(rng.standard_normal())
        sequential.update(record(reading), density(reading, 50.0))
    assert sequential.winner is winner
    assert sequential.lead_nats >= DECISION_NATS
    assert sequential.echoes <= 12


def test_a_slipped_estimate_does_not_let_a_third_pose_win() -> None:
    """The truth is near, and a third of all echoes fits elsewhere: enough against the estimate alone."""

    def readings(near: Belief | None) -> SequentialTest:
        sequential = SequentialTest(near, at(90.0), MeasurementUpdate(Wall()), NOISE)
        # Two readings fit 54 (the truth, near), one fits 90 (elsewhere); the estimate says 44.
        for reading in (54.0, 54.0, 90.0) * 4:
            sequential.update(record(reading), density(reading, 44.0))
        return sequential

    assert readings(None).winner is Side.ELSEWHERE
    assert readings(at(54.0)).winner is Side.NEAR


@pytest.mark.long
def test_wrong_decisions_stay_within_villes_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three tenths of the echoes bad, wherever the rival stands, looked at after every one of 40."""
    # A low threshold, so that some wrong decisions occur in 3000 runs.
    nats = 2.5
    monkeypatch.setattr(module, "DECISION_NATS", nats)
    rng, runs, wrong = np.random.default_rng(6), 3000, 0
    measurement = MeasurementUpdate(Wall())
    for _ in range(runs):
        sequential = SequentialTest(None, at(float(rng.uniform(48.0, 60.0))), measurement, NOISE)
        # Seven tenths of the readings are of the estimate, which is right.
        good = rng.random(40) >= 0.3
        readings_in = np.where(good, 50.0 + STD_IN * rng.standard_normal(40), rng.uniform(6.0, 255.0, 40))
        for reading in readings_in.tolist():
            sequential.update(record(reading), density(reading, 50.0))
            if sequential.winner is not None:
                break
        wrong += sequential.winner is Side.ELSEWHERE
    # Ville's inequality: the ratio exceeds exp(nats) with at most probability exp(-nats).
    assert 0 < wrong <= runs * exp(-nats)
