"""Posts on walls with levels, which explain the echoes of a post nearly as well."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest

from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.association import MapEstimate
from localization.mapping.learn import learn_map
from localization.mapping.problem import PARAMETER_STDS, MapProblem, Reflection
from localization.mapping.revision import _post_places, add_posts, release_stretches, tie_points
from tests.localization.mapping.drives import ROOM, drive

POST = 35.0, 74.0
"""In the frame of the first pose, an inch before the north wall."""


def with_levels(estimate: MapEstimate, points: list[int]) -> MapEstimate:
    """Return a map of the same drive with some of the points, and walls that have levels."""
    found = estimate.copy()
    for number in reversed(range(len(estimate.state.points))):
        if number not in points:
            found.remove(len(found.state.walls) + number)
    reflection = Reflection(half_cone_rad=radians(12.5), surface_std_in=1.75)
    trajectory = estimate.problem.trajectory
    found.problem = MapProblem(trajectory, 16, parameter_stds=PARAMETER_STDS, reflection=reflection)
    found.expects_first_echoes = False
    for _ in range(2):
        found.associate()
        tie_points(found)
        found.optimize()
    found.associate()
    return found


@pytest.fixture(scope="module")
def posted() -> MapEstimate:
    outlines = ROOM, ((60.0, 99.0), (60.1, 99.0))
    return learn_map(drive(1, outlines=outlines), OdometryNoise(0.05, 0.05, 0.002), ConeSonar())


def nearest(estimate: MapEstimate, place: tuple[float, float]) -> int:
    """Return the number of the point nearest to a place."""
    return int(np.hypot(*(estimate.state.points - place).T).argmin())


@pytest.mark.parametrize("place", [POST, (95.0, 75.0)])
def test_post_and_corner_that_walls_had_explained_are_found(
    posted: MapEstimate, place: tuple[float, float]
) -> None:
    missing = nearest(posted, place)
    known = posted.state.points[missing]
    assert known == pytest.approx(place, abs=1.5)
    others = [number for number in range(len(posted.state.points)) if number != missing]
    found = with_levels(posted, others)
    before = found.cost
    assert add_posts(found) >= 1
    assert found.cost < before
    assert found.state.points[nearest(found, place)] == pytest.approx(known, abs=1.5)


def test_only_walls_with_levels_get_posts_and_each_once(posted: MapEstimate) -> None:
    others = [number for number in range(len(posted.state.points)) if number != nearest(posted, POST)]
    found = with_levels(posted, others)
    # Planes and exact rays, with the same point missing.
    planes = replace(found, problem=posted.problem)
    rays = MapProblem(found.problem.trajectory, 16, rays=True, reflection=found.problem.reflection)
    for made in (planes, replace(found, problem=rays)):
        assert len(_post_places(found, np.empty((0, 2))))
        assert add_posts(made) == 0
    assert add_posts(found) >= 1
    count = len(found.state.points)
    assert add_posts(found) == 0
    assert len(found.state.points) == count


def test_level_of_the_echoes_of_a_post_is_left_to_the_post(posted: MapEstimate) -> None:
    missing = nearest(posted, (-25.0, 75.0))
    others = [number for number in range(len(posted.state.points)) if number != missing]
    found = with_levels(posted, others)
    # 1. Without the corner a wall has levels for its echoes, and keeps some of them when the corner is known.
    found.add_point(posted.state.points[missing])
    found.associate()
    assert found.state.levels.is_new.sum() == 1
    before, cost = len(found.echoes_of(found.state.features - 1)), found.cost
    # 2. They are the corner's.
    assert release_stretches(found) == 1
    assert found.state.levels.is_new.sum() == 0
    assert len(found.echoes_of(found.state.features - 1)) > before
    assert found.cost < cost - 5.0
    # 3. No more than that, and nothing of planes.
    assert release_stretches(found) == 0
    assert release_stretches(posted) == 0
