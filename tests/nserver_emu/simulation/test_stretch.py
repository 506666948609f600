"""Paths against the circle, against adaptive quadrature, and cut anywhere."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from nserver_emu.simulation.segments import GAUSS_POINTS, Stretch

rates = st.floats(-2.0, 2.0)
stretches = st.builds(Stretch, st.floats(1e-3, 3.0), st.floats(-20, 20), st.floats(-60, 60), rates, rates)


def test_the_gauss_rule_is_numpys() -> None:
    abscissas, weights = np.polynomial.legendre.leggauss(5)
    np.testing.assert_allclose([point[0] for point in GAUSS_POINTS], (abscissas + 1.0) / 2.0, atol=2e-16)
    np.testing.assert_allclose([point[1] for point in GAUSS_POINTS], weights / 2.0, atol=2e-16)


def test_constant_velocities_draw_the_circle() -> None:
    speed, rate, heading, time = 10.0, 0.8, 0.3, 2.5
    radius = speed / rate
    expected = (
        radius * (sin(heading + rate * time) - sin(heading)),
        radius * (cos(heading) - cos(heading + rate * time)),
    )
    assert Stretch(time, speed, 0.0, rate, 0.0).displacement(heading, time) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("rate", [0.0, 1e-12, 1e-6, 1.9e-4, 2.1e-4])
def test_a_faint_turn_is_nearly_straight(rate: float) -> None:
    dx, dy = Stretch(1.0, 10.0, 0.0, rate, 0.0).displacement(0.0, 1.0)
    assert dx == pytest.approx(10.0 * (1.0 - rate**2 / 6.0), abs=1e-13)
    assert dy == pytest.approx(10.0 * rate / 2.0, abs=1e-11)


def test_an_accelerated_straight_way() -> None:
    stretch = Stretch(2.0, 3.0, 4.0, 0.0, 0.0)
    assert stretch.distance_at(2.0) == 14.0
    assert stretch.displacement(0.5, 2.0) == pytest.approx((14.0 * cos(0.5), 14.0 * sin(0.5)))


@settings(max_examples=40)
@given(stretches, st.floats(-4.0, 4.0))
def test_any_path_is_the_integral_of_its_velocity(stretch: Stretch, heading: float) -> None:
    time = stretch.duration_s

    def along(wave: np.ufunc, at: float) -> float:
        angle = heading + stretch.turn_rate * at + stretch.turn_acceleration * at * at / 2.0
        return float((stretch.speed + stretch.acceleration * at) * wave(angle))

    expected = [quad(lambda at, f=wave: along(f, at), 0.0, time, epsabs=1e-11)[0] for wave in (np.cos, np.sin)]
    assert stretch.displacement(heading, time) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=40)
@given(stretches, st.floats(0.0, 1.0))
def test_two_pieces_make_the_whole(stretch: Stretch, share: float) -> None:
    time = stretch.duration_s
    cut = share * time
    rest = Stretch(
        time - cut,
        stretch.velocity_at(cut),
        stretch.acceleration,
        stretch.turn_rate + stretch.turn_acceleration * cut,
        stretch.turn_acceleration,
    )
    first = stretch.displacement(0.4, cut)
    second = rest.displacement(0.4 + stretch.turn_at(cut), time - cut)
    whole = stretch.displacement(0.4, time)
    assert (first[0] + second[0], first[1] + second[1]) == pytest.approx(whole, abs=1e-9)


@settings(max_examples=40)
@given(stretches)
def test_bounds_hold(stretch: Stretch) -> None:
    times = np.linspace(0.0, stretch.duration_s, 200)
    places = np.array([stretch.displacement(0.0, time) for time in times])
    path = np.hypot(*np.diff(places, axis=0).T).sum()
    turned = np.abs(np.diff([stretch.turn_at(time) for time in times])).sum()
    assert path <= stretch.length_bound(stretch.duration_s) + 1e-9
    assert turned <= stretch.turn_bound(stretch.duration_s) + 1e-9


def test_at_rest_means_nothing_changes() -> None:
    assert Stretch(1.0, 0.0, 0.0, 0.0, 0.0).at_rest
    for number in range(1, 5):
        values = [1.0, 0.0, 0.0, 0.0, 0.0]
        values[number] = -1e-9
        assert not Stretch(*values).at_rest
