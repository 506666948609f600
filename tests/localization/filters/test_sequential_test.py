"""Places held against each other by fresh echoes: nats by hand, and wrong winners no more often than Ville's bound."""

from __future__ import annotations

from math import exp, log, pi, sqrt

import numpy as np
import pytest

from localization.filters import global_localization as contest_module
from localization.filters.belief import Belief, independent
from localization.filters.global_localization import DECISION_NATS, EchoRecord, SequentialTest, Side
from localization.filters.odometry import OdometryNoise, predict
from localization.filters.update import Association, Covariance, MeasurementUpdate, Refusal, State

STD_IN, SPAN_IN = 1.5, 249.0
NOISE = OdometryNoise(0.1, 0.1, 0.005)


class Wall:
    """All sonars read a robot's x, give or take STD_IN; nothing is learnt from it. `taken` readings are kept."""

    def __init__(self) -> None:
        self.taken: list[tuple[int, float, float]] = []

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        del P
        self.taken.append((sonar, turret_offset_rad, reading_in))
        return Association(Refusal.GATE, density(reading_in, x[0]))


def density(reading_in: float, x_in: float) -> float:
    """Of a gaussian."""
    return exp(-0.5 * ((reading_in - x_in) / STD_IN) ** 2) / (STD_IN * sqrt(2.0 * pi))


def at(x_in: float) -> Belief:
    return independent([x_in, 0.0, 0.0], [0.5, 0.5, 0.03])


def clue(reading_in: float) -> EchoRecord:
    return EchoRecord(np.zeros(3), 0.0, 0, 0.0, reading_in)


def test_each_side_gets_the_logarithm_of_how_it_explains_an_echo_and_a_bad_one_costs_so_much_at_most() -> None:
    contest = SequentialTest(at(52.0), at(90.0), MeasurementUpdate(Wall()), NOISE)
    for reading, here in ((51.0, 0.2), (90.0, 0.0), (30.0, 0.01)):
        contest.update(clue(reading), here)
    bad = 0.3 / SPAN_IN
    expected = {
        Side.HERE: log(0.7 * 0.2 + bad) + log(bad) + log(0.7 * 0.01 + bad),
        Side.NEAR: log(0.7 * density(51.0, 52.0) + bad) + 2.0 * log(bad),
        Side.ELSEWHERE: log(bad) + log(0.7 * density(90.0, 90.0) + bad) + log(bad),
    }
    first, second = sorted(expected.values())[:0:-1]
    assert contest.echoes == 3
    assert contest.lead_nats == pytest.approx(first - second)
    assert contest.winner is None


def test_silence_is_weighed_as_a_chance() -> None:
    contest = SequentialTest(None, at(90.0), MeasurementUpdate(Wall()), NOISE)
    contest.update(clue(255.0), 1.0)
    assert contest.lead_nats == pytest.approx(log(1.0 / 0.3))


def test_rivals_move_with_the_encoders_and_hear() -> None:
    wall, step = Wall(), np.array([2.0, 0.3])
    contest = SequentialTest(at(52.0), at(90.0), MeasurementUpdate(wall), NOISE)
    contest.predict(*step.tolist())
    contest.update(EchoRecord(np.zeros(3), 0.5, 7, 0.2, 50.0), 0.1)
    for side, x_in in ((Side.NEAR, 52.0), (Side.ELSEWHERE, 90.0)):
        moved = predict(at(x_in), step, NOISE)
        np.testing.assert_array_equal(contest.belief(side).mean, moved.mean)
        np.testing.assert_array_equal(contest.belief(side).cov, moved.cov)
    assert wall.taken == [(7, 0.2, 50.0)] * 2


@pytest.mark.parametrize(("true_in", "winner"), [(50.0, Side.HERE), (54.0, Side.NEAR), (90.0, Side.ELSEWHERE)])
def test_the_right_side_wins_after_a_handful_of_echoes(true_in: float, winner: Side) -> None:
    chance = np.random.default_rng(4)
    contest = SequentialTest(at(54.0), at(90.0), MeasurementUpdate(Wall()), NOISE)
    while contest.winner is None:
        reading = true_in + STD_IN * float(chance.standard_normal())
        contest.update(clue(reading), density(reading, 50.0))
    assert contest.winner is winner
    assert contest.lead_nats >= DECISION_NATS
    assert contest.echoes <= 12


def test_a_third_place_does_not_win_because_the_estimate_has_slipped() -> None:
    """The truth is near, and a third of all echoes fits elsewhere by chance: enough against the estimate alone."""

    def readings(near: Belief | None) -> SequentialTest:
        contest = SequentialTest(near, at(90.0), MeasurementUpdate(Wall()), NOISE)
        for reading in (54.0, 54.0, 90.0) * 4:
            contest.update(clue(reading), density(reading, 44.0))
        return contest

    assert readings(None).winner is Side.ELSEWHERE
    assert readings(at(54.0)).winner is Side.NEAR


def test_while_the_estimate_is_right_a_rival_wins_no_more_often_than_villes_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three tenths of the echoes bad, wherever the rival stands, looked at after every one of 40."""
    nats = 2.5
    monkeypatch.setattr(contest_module, "DECISION_NATS", nats)
    chance, runs, wrong = np.random.default_rng(6), 3000, 0
    hearing = MeasurementUpdate(Wall())
    for _ in range(runs):
        contest = SequentialTest(None, at(float(chance.uniform(48.0, 60.0))), hearing, NOISE)
        good = chance.random(40) >= 0.3
        heard = np.where(good, 50.0 + STD_IN * chance.standard_normal(40), chance.uniform(6.0, 255.0, 40))
        for reading in heard.tolist():
            contest.update(clue(reading), density(reading, 50.0))
            if contest.winner is not None:
                break
        wrong += contest.winner is Side.ELSEWHERE
    assert 0 < wrong <= runs * exp(-nats)
