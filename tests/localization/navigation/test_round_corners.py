"""Rounded corners: tangent to both sides, near the corner, faster, and with the required clearance."""

from __future__ import annotations

from math import cos, hypot, sin

import numpy as np
import pytest

from localization.navigation.control_law import MODEL_LIMITS
from localization.navigation.path import SpeedProfile, round_corners, split_into_sections

AXES = MODEL_LIMITS["n150"]
NO_WALLS = np.zeros((0, 4))
BEND = [(0.0, 0.0), (40.0, 0.0), (40.0 + 40.0 * cos(1.0), 40.0 * sin(1.0))]


@pytest.mark.parametrize("within", [0.5, 1.0, 4.0])
def test_arc_passes_corner_at_given_distance_without_gaps(within: float) -> None:
    (section,) = split_into_sections(round_corners(BEND, within, AXES, NO_WALLS, 10.0))
    assert [bool(element.curvature) for element in section.elements] == [False, True, False]
    near = section.at(section.nearest(40.0, 0.0))
    assert hypot(near.x_in - 40.0, near.y_in) == pytest.approx(within, abs=1e-6)
    assert section.at(section.length_in)[:2] == pytest.approx(BEND[2])
    places = np.array([section.at(along)[:2] for along in np.linspace(0.0, section.length_in, 2000)])
    assert np.hypot(*np.diff(places, axis=0).T).max() < section.length_in / 1900


def test_round_is_quicker_than_stopping_to_turn() -> None:
    """The whole path: speeds by the profile, the turn in place by a trapezoid of the steering."""
    (round_one,) = split_into_sections(round_corners(BEND, 4.0, AXES, NO_WALLS, 10.0))
    sharp = split_into_sections(round_corners(BEND, 1e-6, AXES, NO_WALLS, 10.0))
    turning = 1.0 / AXES.steering_rad_s + AXES.steering_rad_s / AXES.steering_rad_s2
    assert len(sharp) == 2
    stopping = sum(SpeedProfile(section, AXES).duration_s for section in sharp) + turning
    assert SpeedProfile(round_one, AXES).duration_s < stopping


def test_corner_stays_if_its_arc_would_be_slow() -> None:
    assert len(split_into_sections(round_corners(BEND, 1e-3, AXES, NO_WALLS, 10.0))) == 2


def test_corner_stays_at_reversal_straight_or_nearby_wall() -> None:
    there_and_back = [(0.0, 0.0), (40.0, 0.0), (1.0, 1.0)]
    assert len(split_into_sections(round_corners(there_and_back, 4.0, AXES, NO_WALLS, 10.0))) == 2
    on = round_corners([(0.0, 0.0), (40.0, 0.0), (40.0, 0.0), (80.0, 0.0)], 4.0, AXES, NO_WALLS, 10.0)
    assert [element.length_in for element in on] == [40.0, 40.0]
    inside = np.array([[38.0, 13.9, 38.0, 14.0]])
    assert len(split_into_sections(round_corners(BEND, 4.0, AXES, inside, 8.0))) == 1
    assert len(split_into_sections(round_corners(BEND, 4.0, AXES, inside, 13.0))) == 2


def test_small_turns_have_their_own_time() -> None:
    slight = [(0.0, 0.0), (40.0, 0.0), (40.0 + 40.0 * cos(0.1), 40.0 * sin(0.1))]
    assert len(split_into_sections(round_corners(slight, 1.0, AXES, NO_WALLS, 10.0))) == 1
