"""What a reading may be of: ranges elsewhere than at the mean, against the readings sensed there and differences."""

from __future__ import annotations

import numpy as np
import pytest

from localization.filters.base import measurement_model
from localization.filters.belief import Belief, Floats, independent
from localization.filters.sonar_cone import ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RaySonar, associate, pick, ring, wall_map
from localization.filters.update import Association, Hypotheses, Refusal
from worlds.io import load_world
from worlds.robots import N150

WALLS = load_world("centre_vertex").walls
POSE = np.array([40.0, 45.0, 0.2])
STD = (0.1, 0.1, 0.01)
KINDS: list[RaySonar | ConeSonar] = [WIRE_SONAR, ConeSonar()]


def sensed(kind: RaySonar | ConeSonar, sonar: int, belief: Belief) -> Association:
    """What is sensed of the reading that a ray would bring."""
    aimed = associate(belief, pick(ring(N150, 0.3), sonar), wall_map(WALLS))
    return measurement_model(WALLS, N150, kind).sense(belief, sonar, 0.3, float(aimed.seen.ranges_in[0]))


def all_candidates(kind: RaySonar | ConeSonar, pose: Floats) -> dict[int, Hypotheses]:
    """Of each sonar that may hear anything from there."""
    found = {sonar: sensed(kind, sonar, independent(pose, STD)).candidates for sonar in range(16)}
    return {sonar: candidates for sonar, candidates in found.items() if candidates is not None}


@pytest.mark.parametrize("kind", KINDS)
def test_candidates_know_their_ranges_and_slopes_everywhere(kind: RaySonar | ConeSonar) -> None:
    every = all_candidates(kind, POSE)
    assert len(every) > 8
    for here in every.values():
        ranges, jacobian = here.expect(POSE[None, :])
        np.testing.assert_allclose(ranges, here.ranges_in, atol=1e-12)
        np.testing.assert_allclose(jacobian, here.jacobian, atol=1e-12)
        other = POSE + np.array([0.3, -0.2, 0.02])
        poses = np.stack([other + change for change in 1e-5 * np.vstack([np.eye(3), -np.eye(3)])])
        moved, _ = here.expect(poses[:, None, :])
        _, slope = here.expect(np.broadcast_to(other, (len(here.ranges_in), 3)))
        np.testing.assert_allclose(((moved[:3] - moved[3:]) / 2e-5).T, slope, atol=1e-5)


def test_a_cone_moved_senses_what_its_candidates_foretold() -> None:
    there = POSE + np.array([0.02, -0.01, 0.001])
    here, moved = all_candidates(ConeSonar(), POSE), all_candidates(ConeSonar(), there)
    same = [sonar for sonar in here if sonar in moved and len(here[sonar].ranges_in) == len(moved[sonar].ranges_in)]
    assert len(same) > 8
    for sonar in same:
        np.testing.assert_allclose(here[sonar].expect(there[None, :])[0], moved[sonar].ranges_in, atol=1e-12)


def test_a_cone_hears_faces_and_vertices() -> None:
    assert max(len(found.ranges_in) for found in all_candidates(ConeSonar(), POSE).values()) > 1


def test_chances_are_shares_of_one_and_a_ray_is_sure() -> None:
    for found in all_candidates(ConeSonar(), POSE).values():
        assert 0.0 < found.probability.sum() <= 1.0
    for ray in all_candidates(WIRE_SONAR, POSE).values():
        assert ray.probability.tolist() == [1.0]


def test_a_limit_is_the_likelier_the_less_there_is_to_hear() -> None:
    belief, sense = independent(POSE, STD), measurement_model(WALLS, N150, ConeSonar())
    every = all_candidates(ConeSonar(), POSE)
    for sonar in range(16):
        found = sense.sense(belief, sonar, 0.3, 255.0)
        assert (found.refusal, found.candidates) == (Refusal.LIMIT, None)
        heard = every[sonar].probability.sum() if sonar in every else 0.0
        assert found.likelihood == pytest.approx(1.0 - 0.9 * heard)
