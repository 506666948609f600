"""Measurement models: the ranges of their hypotheses elsewhere, against differences and other associations."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.base import measurement_model
from localization.filters.belief import Floats, independent, unpack
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar, ranges_from, wall_map
from localization.filters.update import RANGE_PARAMETERS, Association, Refusal, kalman_gain, readings_at
from worlds.io import load_world
from worlds.robots import N150

WALLS = load_world("centre_vertex").walls
POSE = np.array([40.0, 45.0, 0.2])
STD = (0.1, 0.1, 0.01)
KINDS: list[RaySonar | ConeSonar] = [WIRE_SONAR, ConeSonar()]


def associations(kind: RaySonar | ConeSonar, pose: Floats) -> dict[int, Association]:
    """Return the associations of each sonar that may return an echo of the wall on its axis."""
    model, (x, P) = measurement_model(WALLS, N150, kind), unpack(independent(pose, STD))
    ranges = ranges_from(pose, np.array(N150.sonar_angles_rad) + 0.3, N150, wall_map(WALLS)).range_in
    found = {sonar: model.associate(x, P, sonar, 0.3, float(ranges[sonar])) for sonar in range(16)}
    return {sonar: association for sonar, association in found.items() if association.refusal is Refusal.NONE}


@pytest.mark.parametrize("kind", KINDS)
def test_ranges_and_derivatives_elsewhere_match_differences(kind: RaySonar | ConeSonar) -> None:
    every = associations(kind, POSE)
    # Enough of the 16 sonars detect something.
    assert len(every) > 8
    for here in every.values():
        assert here.range_function is not None
        # The range function at the pose of the association gives the ranges of the association.
        ranges, H = here.range_function(POSE[None, :])
        np.testing.assert_allclose(ranges, here.ranges_in, atol=1e-12)
        np.testing.assert_allclose(H, here.H, atol=1e-12)
        # At another pose, derivatives are compared with central differences.
        other = POSE + np.array([0.3, -0.2, 0.02])
        poses = np.stack([other + change for change in 1e-5 * np.vstack([np.eye(3), -np.eye(3)])])
        moved, _ = here.range_function(poses[:, None, :])
        _, slope = here.range_function(np.broadcast_to(other, (len(here.ranges_in), 3)))
        np.testing.assert_allclose(((moved[:3] - moved[3:]) / 2e-5).T, slope, atol=1e-5)


@pytest.mark.parametrize("kind", KINDS)
def test_readings_with_range_parameters_match_differences(kind: RaySonar | ConeSonar) -> None:
    model = measurement_model(WALLS, N150, kind, range_parameters=RANGE_PARAMETERS)
    # Pose, an odometry parameter without effect on readings, offset and scale.
    mean = np.array([*POSE, 0.03, 0.4, -0.02])
    x, P = unpack(independent(mean, (*STD, 0.01, 0.5, 0.015)))
    plain = associations(kind, POSE)
    for sonar, ranges in plain.items():
        reading_in = 0.98 * ranges.ranges_in[0] + 0.4
        found = model.associate(x, P, sonar, 0.3, reading_in)
        if found.refusal is not Refusal.NONE:
            continue
        # The reading is that of the range, 2 % shorter and 0.4 in longer.
        np.testing.assert_allclose(found.ranges_in, 0.98 * np.array(ranges.ranges_in) + 0.4, atol=1e-12)
        steps = 1e-5 * np.vstack([np.eye(6), -np.eye(6)])
        moved = np.stack([readings_at(found, (mean + step)[None, None])[0][0] for step in steps])
        slope = ((moved[:6] - moved[6:]) / 2e-5).T
        np.testing.assert_allclose(slope[:, [0, 1, 2, 4, 5]], found.H, atol=1e-5)
        np.testing.assert_array_equal(slope[:, 3], 0.0)
        # The gain takes the derivative by the odometry parameter for 0: that of the whole vector.
        K, S = kalman_gain(P, found.H[0], 0.3)
        H = slope[0]
        np.testing.assert_allclose(S, H @ np.array(P) @ H + 0.3, rtol=1e-6)
        np.testing.assert_allclose(K, np.array(P) @ H / S, rtol=1e-5, atol=1e-9)


def test_a_cone_elsewhere_is_associated_as_predicted() -> None:
    there = POSE + np.array([0.02, -0.01, 0.001])
    here, moved = associations(ConeSonar(), POSE), associations(ConeSonar(), there)
    same = [sonar for sonar in here if sonar in moved and len(here[sonar].ranges_in) == len(moved[sonar].ranges_in)]
    assert len(same) > 8
    for sonar in same:
        ranges_at = here[sonar].range_function
        assert ranges_at is not None
        np.testing.assert_allclose(ranges_at(there[None, :])[0], moved[sonar].ranges_in, atol=1e-12)


def test_a_cone_may_detect_several_reflectors() -> None:
    assert max(len(found.ranges_in) for found in associations(ConeSonar(), POSE).values()) > 1


def test_probabilities_sum_to_one_at_most() -> None:
    for found in associations(ConeSonar(), POSE).values():
        assert 0.0 < sum(found.probability) <= 1.0
    for ray in associations(WIRE_SONAR, POSE).values():
        assert list(ray.probability) == [1.0]


def test_nothing_is_probable_where_nothing_is_detected() -> None:
    model, (x, P) = measurement_model(WALLS, N150, ConeSonar()), unpack(independent(POSE, STD))
    every = associations(ConeSonar(), POSE)
    for sonar in range(16):
        found = model.associate(x, P, sonar, 0.3, 255.0)
        assert (found.refusal, found.ranges_in) == (Refusal.LIMIT, ())
        detected = sum(every[sonar].probability) if sonar in every else 0.0
        assert found.likelihood == pytest.approx(1.0 - 0.9 * detected)
