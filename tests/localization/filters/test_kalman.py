"""The Kalman filter: the health that it reports, and repeated readings from one pose."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.base import measurement_model
from localization.filters.belief import Belief, independent, unpack
from localization.filters.ekf import KalmanFilter
from localization.filters.global_localization import GlobalLocalizer
from localization.filters.health import HEALTHY, HealthLimits, HealthStatus
from localization.filters.odometry import OdometryNoise
from localization.filters.pose_search import TableSearch
from localization.filters.range_table import build_range_table
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import RaySonar
from localization.filters.update import Association, Covariance, MeasurementUpdate, Refusal, State
from worlds.io import load_world
from worlds.robots import N150

WINDOW = HealthLimits().window
HERE = independent([20.0, 35.0, 0.3], [0.2, 0.2, 0.01])


class Refusing:
    """A measurement model that refuses every reading for one reason."""

    def __init__(self, refusal: Refusal) -> None:
        self._refusal = refusal

    def associate(
        self, x: State, P: Covariance, sonar: int, turret_offset_rad: float, reading_in: float
    ) -> Association:
        del P
        assert (sonar, turret_offset_rad, reading_in) == (0, 0.0, 50.0)
        return Association(self._refusal, x[0])


def refusing_filter(refusal: Refusal, readings: int) -> KalmanFilter:
    kalman = KalmanFilter(HERE, MeasurementUpdate(Refusing(refusal)), OdometryNoise())
    for _ in range(readings):
        kalman.update(0, 0.0, 50.0)
    return kalman


@pytest.mark.parametrize("refusal", [Refusal.GATE, Refusal.NO_WALL])
def test_enough_unexplained_readings_degrade(refusal: Refusal) -> None:
    assert refusing_filter(refusal, WINDOW - 1).health == HEALTHY
    health = refusing_filter(refusal, WINDOW).health
    assert health == (HealthStatus.DEGRADED, f"only 0% of the last {WINDOW} echoes are explained")


@pytest.mark.parametrize("refusal", [Refusal.LIMIT, Refusal.AMBIGUOUS_WALL, Refusal.GRAZING])
def test_uninformative_refusals_do_not_degrade(refusal: Refusal) -> None:
    assert refusing_filter(refusal, 3 * WINDOW).health == HEALTHY


def test_a_ring_away_from_its_estimate_degrades() -> None:
    """Ranges that the map itself gives: at the believed place, and 12 in off it."""
    model = measurement_model(load_world("thesis_room").walls, N150, ConeSonar())

    def readings(at: Belief) -> list[tuple[int, float]]:
        found = [(sonar, model.associate(*unpack(at), sonar, 0.0, 50.0)) for sonar in range(16)]
        return [(sonar, nearest(association)) for sonar, association in found if association.refusal is Refusal.NONE]

    def nearest(association: Association) -> float:
        return association.ranges_in[int(np.argmax(association.probability))]

    # Readings of either place are given to a filter that believes to be at HERE.
    there = independent([32.0, 29.0, 0.3], HERE.std)
    for place, status in ((HERE, HealthStatus.OK), (there, HealthStatus.DEGRADED)):
        readings_there = readings(place)
        kalman = KalmanFilter(HERE, MeasurementUpdate(model), OdometryNoise(0.0, 0.0, 0.0))
        # As many rounds of the ring as fill the window of the monitor.
        for sonar, reading_in in readings_there * (WINDOW // len(readings_there) + 1):
            kalman.update(sonar, 0.0, round(reading_in))
            # Keep the belief: a filter this certain would hardly move.
            kalman._x, kalman._P = unpack(HERE)
        assert kalman.health.status is status, place


def test_wide_estimate_is_degraded() -> None:
    wide = KalmanFilter(
        independent([0.0, 0.0, 0.0], [0.2, 4.0, 0.01]), MeasurementUpdate(Refusing(Refusal.GATE)), OdometryNoise()
    )
    assert wide.health == (HealthStatus.DEGRADED, "the position is known to 4.0 in only")
    np.testing.assert_array_equal(wide.predicted(0.0, 0.0).mean, wide.belief.mean)


ROOM = [(0, 0, 100, 0), (100, 0, 100, 100), (100, 100, 0, 100), (0, 100, 0, 0)]
MIDST = independent([50.0, 50.0, 0.0], [0.2, 0.2, 0.01])
AHEAD_IN = round(50.0 - N150.sonar_ring_radius_in)


def tracking(kind: str) -> KalmanFilter | GlobalLocalizer:
    """Of exact rays in whole inches: their error is the same each time."""
    rays = RaySonar(range_std_relative=0.0, range_std_floor_in=0.02, rounding_var_in2=1.0 / 12.0)
    update = update_for(ROOM, N150, rays)
    if kind == "kalman":
        return KalmanFilter(MIDST, update, OdometryNoise())
    poses = TableSearch(lambda: build_range_table(ROOM, N150, rays, 9.0), update, OdometryNoise())
    return GlobalLocalizer(MIDST, update, OdometryNoise(), poses, N150.sonar_angles_rad)


@pytest.mark.parametrize("kind", ["kalman", "finder"])
def test_a_repeated_echo_adds_nothing_until_the_robot_moves(kind: str) -> None:
    kalman = tracking(kind)
    # The first echo reduces the variance along the beam.
    kalman.update(0, 0.0, AHEAD_IN)
    once = kalman.belief
    assert once.cov[0, 0] < 0.8 * MIDST.cov[0, 0]
    # The same echo from the same place has the same rounding and noise of the map: no information.
    for _ in range(5):
        assert kalman.update(0, 0.0, AHEAD_IN).refusal is Refusal.NONE
    np.testing.assert_allclose(kalman.belief.cov, once.cov, rtol=1e-6)
    # Half an inch on, part of the error is new.
    kalman.predict(0.5, 0.0)
    before = kalman.belief.cov
    kalman.update(0, 0.0, AHEAD_IN)
    assert kalman.belief.cov[0, 0] < 0.9 * before[0, 0]


@pytest.mark.parametrize("kind", ["kalman", "finder"])
@pytest.mark.parametrize("refused_in", [AHEAD_IN - 20.0, 255.0])
def test_a_refused_reading_does_not_count_as_repeated(kind: str, refused_in: float) -> None:
    kalman, once = tracking(kind), tracking(kind)
    assert kalman.update(0, 0.0, refused_in).refusal is not Refusal.NONE
    for each in (kalman, once):
        each.update(0, 0.0, AHEAD_IN)
    np.testing.assert_array_equal(kalman.belief.cov, once.belief.cov)
