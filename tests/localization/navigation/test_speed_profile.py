"""Speeds along a section: against the axis limits, and against the closed form of a trapezoid."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest

from localization.navigation.control_law import MODEL_LIMITS, AxisLimits
from localization.navigation.path import (
    CREEP_IN_S,
    LATERAL_SHIFT_IN,
    PLANNED_ACCELERATION,
    PathElement,
    PathSection,
    SpeedProfile,
    line_between,
    max_arc_speed_in_s,
)

AXES = MODEL_LIMITS["n150"]
BEND = PathSection(
    (line_between((0, 0), (40, 0)), PathElement(40.0, 0.0, 0.0, 0.1, 5.0 * pi), line_between((50, 10), (50, 60)))
)


def test_a_straight_line_is_driven_as_a_trapezoid() -> None:
    push = PLANNED_ACCELERATION * AXES.translation_in_s2
    line = PathSection((line_between((0, 0), (100, 0)),))
    exact = 100.0 / 20.0 + 20.0 / push
    assert SpeedProfile(line, AXES).duration_s == pytest.approx(exact, rel=0.01)
    short = PathSection((line_between((0, 0), (10, 0)),))
    assert SpeedProfile(short, AXES).duration_s == pytest.approx(2.0 * sqrt(10.0 / push), rel=0.03)


def test_no_speed_is_beyond_an_axis() -> None:
    profile = SpeedProfile(BEND, AXES)
    along = np.linspace(0.0, BEND.length_in, 400)
    speeds = np.array([profile.speed_in_s(float(value)) for value in along])
    # Limits of the axes: translation, and steering in the arc of curvature 0.1.
    assert speeds.max() <= AXES.translation_in_s
    curved = (along > 40.0) & (along < 40.0 + 5.0 * pi)
    assert (speeds[curved] * 0.1).max() <= AXES.steering_rad_s + 1e-9
    # v dv / ds = a: acceleration from the differences of v^2.
    moving = speeds > CREEP_IN_S + 0.1
    gained = np.diff(speeds**2) / (2.0 * np.diff(along))
    assert gained[moving[1:]].max() <= PLANNED_ACCELERATION * AXES.translation_in_s2 + 0.6
    # It ends at the creeping speed, which the goal tolerance absorbs.
    assert speeds[-1] == CREEP_IN_S
    assert speeds[0] > 0.0


def test_steering_ramp_shifts_arc_within_limit() -> None:
    """Simulated: a heading that ramps up and down again around an arc, half of each ramp before its ends."""
    curvature, turn = 0.1, 1.2
    # The time of the ramp and of the constant rate, for the whole turn.
    speed = max_arc_speed_in_s(curvature, AXES)
    ramp = speed * curvature / AXES.steering_rad_s2
    hold = turn / (speed * curvature) - ramp
    # Integrate the heading and the position in 40,000 steps.
    time = np.linspace(0.0, 2.0 * ramp + hold, 40_001)
    rate = speed * curvature * np.interp(time, [0.0, ramp, ramp + hold, 2.0 * ramp + hold], [0.0, 1.0, 1.0, 0.0])
    heading = np.concatenate(([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(time))))
    step = speed * np.diff(time)
    x = np.concatenate(([0.0], np.cumsum(step * np.cos(0.5 * (heading[1:] + heading[:-1]))))) - 0.5 * speed * ramp
    y = np.concatenate(([0.0], np.cumsum(step * np.sin(0.5 * (heading[1:] + heading[:-1])))))
    # The distance of the middle of the arc from the circle's centre is the shift.
    middle = len(time) // 2
    from_centre = np.hypot(x[middle] - 0.0, y[middle] - 1.0 / curvature)
    assert abs(from_centre - 1.0 / curvature) <= 1.3 * LATERAL_SHIFT_IN
    assert max_arc_speed_in_s(-curvature, AXES) == speed
    assert max_arc_speed_in_s(0.0, AXES) == AXES.translation_in_s


def test_gentle_arc_is_limited_by_steering_or_translation() -> None:
    quick = AxisLimits(50.0, 30.0, 0.2, 100.0)
    assert max_arc_speed_in_s(0.1, quick) == pytest.approx(2.0)
    assert max_arc_speed_in_s(0.001, quick) == 50.0


def test_limits_are_capped_and_no_model_is_missing() -> None:
    assert AXES.capped(5.0) == AxisLimits(5.0, 30.0, AXES.steering_rad_s, AXES.steering_rad_s2)
    assert AXES.capped(50.0, 0.5).steering_rad_s == 0.5
    assert AXES.capped(50.0).translation_in_s == 20.0
    scout = MODEL_LIMITS["scout"]
    assert scout.translation_in_s + 0.5 * 13.590 * scout.steering_rad_s <= 39.0
    assert scout.translation_in_s2 + 0.5 * 13.590 * scout.steering_rad_s2 <= 30.0
    assert sorted(MODEL_LIMITS) == ["n150", "n200", "scout"]
