"""Repeated readings from one pose: their count and information, and a standing robot that stays consistent."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.update import (
    SAME_POSE_IN,
    SAME_POSE_RAD,
    Used,
    count_along_axis,
    count_used,
    inflated_variance,
    move_on,
    new_used,
    record_used,
)


@pytest.mark.parametrize(("anew", "constant"), [(0.1, 0.08), (2.0, 1e-3), (0.04, 0.0)])
def test_inflated_variances_are_exact_and_minimal(anew: float, constant: float) -> None:
    """By the whole covariance of the readings."""
    # Five readings of one place: independent noise and a part common to all.
    noise = np.eye(5) * anew + constant
    weights = 1.0 / np.array([inflated_variance(anew + constant, constant, times) for times in range(1, 6)])
    for count in range(1, 6):
        # With inverse variances as weights, information is w'Rw = sum(w): no reading is counted twice.
        first, part = weights[:count], noise[:count, :count]
        assert first @ part @ first == pytest.approx(first.sum(), rel=1e-6)
        # Smaller variances would claim more information than there is.
        more = np.append(first[:-1], 1.01 * first[-1])
        assert more @ part @ more > more.sum()
    # The common part bounds the information of any number of readings.
    assert weights.sum() <= (1.0 / (2.0 * constant) if constant else np.inf)


@pytest.mark.parametrize("anew", [0.0, 0.1, 0.2])
def test_fully_correlated_reading_adds_no_information(anew: float) -> None:
    second = inflated_variance(0.2 + anew, 0.2, 2)
    assert np.isfinite(second)
    assert second > 1e9


def number_of(repeats: Used, sonar: int, turret_rad: float = 0.0) -> int:
    """Of a reading that is taken in: 1 for the first from this place."""
    count = count_used(repeats, sonar, turret_rad) + 1
    record_used(repeats, sonar, turret_rad, count)
    return count


def test_a_robot_that_stands_counts_each_sonar() -> None:
    repeats = new_used()
    counts = []
    for _ in range(3):
        move_on(repeats, 0.0, 0.0)
        counts.append((number_of(repeats, 0, 0.1), number_of(repeats, 1, 0.1)))
    assert counts == [(1, 1), (2, 2), (3, 3)]


def test_unrecorded_readings_are_not_counted() -> None:
    repeats = new_used()
    assert [count_used(repeats, 0, 0.0) for _ in range(3)] == [0, 0, 0]
    assert [number_of(repeats, 0), count_used(repeats, 0, 0.0), number_of(repeats, 0)] == [1, 1, 2]


@pytest.mark.parametrize(
    ("step", "turret_rad", "again"),
    [
        ((0.9 * SAME_POSE_IN, 0.0), 0.0, True),
        ((-1.1 * SAME_POSE_IN, 0.0), 0.0, False),
        ((0.0, 0.9 * SAME_POSE_RAD), 0.0, True),
        ((0.0, -1.1 * SAME_POSE_RAD), 0.0, False),
        ((0.0, 0.0), 1.1 * SAME_POSE_RAD, False),
        ((0.0, 2.0 * SAME_POSE_RAD), -2.0 * SAME_POSE_RAD, False),
        ((0.0, 0.0), 2 * np.pi, True),
    ],
)
def test_count_restarts_at_another_pose(step: tuple[float, float], turret_rad: float, again: bool) -> None:
    repeats = new_used()
    record_used(repeats, 3, 0.0, 1)
    move_on(repeats, *step)
    assert number_of(repeats, 3, turret_rad) == (2 if again else 1)


def test_a_robot_that_turns_below_its_turret_measures_along_the_same_axis() -> None:
    repeats = new_used()
    record_used(repeats, 3, 0.2, 1)
    move_on(repeats, 0.0, 1.5)
    assert count_used(repeats, 3, -1.3) == 0
    assert count_along_axis(repeats, 3, -1.3) == 1
    assert count_along_axis(repeats, 3, -1.3 + 1.1 * SAME_POSE_RAD) == 0
    move_on(repeats, 1.1 * SAME_POSE_IN, 0.0)
    assert count_along_axis(repeats, 3, -1.3) == 0


def test_a_creeping_robot_is_elsewhere_after_a_while() -> None:
    repeats = new_used()
    counts = []
    for _ in range(7):
        counts.append(number_of(repeats, 0))
        move_on(repeats, 0.4 * SAME_POSE_IN, 0.0)
    assert counts == [1, 2, 3, 1, 2, 3, 1]


def test_to_and_fro_is_not_the_same_place() -> None:
    repeats = new_used()
    record_used(repeats, 0, 0.0, 1)
    for distance in (0.6, -0.6):
        move_on(repeats, distance * SAME_POSE_IN, 0.0)
    assert count_used(repeats, 0, 0.0) == 0
