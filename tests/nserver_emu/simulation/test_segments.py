"""Paths against the circle, against adaptive quadrature, and cut anywhere."""

from __future__ import annotations

from math import cos, sin

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from nserver_emu.simulation.segments import GAUSS_POINTS, ConstantAccelerationSegment

rates = st.floats(-2.0, 2.0)
stretches = st.builds(
    ConstantAccelerationSegment, st.floats(1e-3, 3.0), st.floats(-20, 20), st.floats(-60, 60), rates, rates
)


def test_the_gauss_rule_is_numpys() -> None:
    abscissas, weights = np.polynomial.legendre.leggauss(5)
    np.testing.assert_allclose([point[0] for point in GAUSS_POINTS], (abscissas + 1.0) / 2.0, atol=2e-16)
    np.testing.assert_allclose([point[1] for point in GAUSS_POINTS], weights / 2.0, atol=2e-16)


def test_constant_velocities_draw_the_circle() -> None:
    # Constant speed and turn rate: an arc of radius v / w.
    speed, rate, heading, time = 10.0, 0.8, 0.3, 2.5
    radius = speed / rate
    expected = (
        radius * (sin(heading + rate * time) - sin(heading)),
        radius * (cos(heading) - cos(heading + rate * time)),
    )
    assert ConstantAccelerationSegment(time, speed, 0.0, rate, 0.0).displacement(heading, time) == pytest.approx(
        expected, abs=1e-12
    )


@pytest.mark.parametrize("rate", [0.0, 1e-12, 1e-6, 1.9e-4, 2.1e-4])
def test_a_faint_turn_is_nearly_straight(rate: float) -> None:
    dx, dy = ConstantAccelerationSegment(1.0, 10.0, 0.0, rate, 0.0).displacement(0.0, 1.0)
    assert dx == pytest.approx(10.0 * (1.0 - rate**2 / 6.0), abs=1e-13)
    assert dy == pytest.approx(10.0 * rate / 2.0, abs=1e-11)


def test_an_accelerated_straight_path() -> None:
    segment = ConstantAccelerationSegment(2.0, 3.0, 4.0, 0.0, 0.0)
    assert segment.distance_at(2.0) == 14.0
    assert segment.displacement(0.5, 2.0) == pytest.approx((14.0 * cos(0.5), 14.0 * sin(0.5)))


@settings(max_examples=40)
@given(stretches, st.floats(-4.0, 4.0))
def test_any_path_is_the_integral_of_its_velocity(segment: ConstantAccelerationSegment, heading: float) -> None:
    time = segment.duration_s

    def along(wave: np.ufunc, at: float) -> float:
        angle = heading + segment.turn_rate * at + segment.turn_acceleration * at * at / 2.0
        return float((segment.speed + segment.acceleration * at) * wave(angle))

    expected = [quad(lambda at, f=wave: along(f, at), 0.0, time, epsabs=1e-11)[0] for wave in (np.cos, np.sin)]
    assert segment.displacement(heading, time) == pytest.approx(expected, abs=1e-9)


@settings(max_examples=40)
@given(stretches, st.floats(0.0, 1.0))
def test_two_pieces_make_the_whole(segment: ConstantAccelerationSegment, share: float) -> None:
    # Cut the segment: the second piece starts with the velocities at the cut.
    time = segment.duration_s
    cut = share * time
    rest = ConstantAccelerationSegment(
        time - cut,
        segment.velocity_at(cut),
        segment.acceleration,
        segment.turn_rate + segment.turn_acceleration * cut,
        segment.turn_acceleration,
    )
    # The second piece starts at the heading that the first reached.
    first = segment.displacement(0.4, cut)
    second = rest.displacement(0.4 + segment.turn_at(cut), time - cut)
    whole = segment.displacement(0.4, time)
    assert (first[0] + second[0], first[1] + second[1]) == pytest.approx(whole, abs=1e-9)


@settings(max_examples=40)
@given(stretches)
def test_bounds_hold(segment: ConstantAccelerationSegment) -> None:
    times = np.linspace(0.0, segment.duration_s, 200)
    places = np.array([segment.displacement(0.0, time) for time in times])
    path = np.hypot(*np.diff(places, axis=0).T).sum()
    turned = np.abs(np.diff([segment.turn_at(time) for time in times])).sum()
    assert path <= segment.length_bound(segment.duration_s) + 1e-9
    assert turned <= segment.turn_bound(segment.duration_s) + 1e-9


def test_at_rest_means_nothing_changes() -> None:
    assert ConstantAccelerationSegment(1.0, 0.0, 0.0, 0.0, 0.0).at_rest
    for number in range(1, 5):
        values = [1.0, 0.0, 0.0, 0.0, 0.0]
        values[number] = -1e-9
        assert not ConstantAccelerationSegment(*values).at_rest
