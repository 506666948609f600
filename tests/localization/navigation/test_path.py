"""Path elements and sections: against points computed one small step after another."""

from __future__ import annotations

from math import cos, hypot, pi, sin

import numpy as np
import pytest

from localization.navigation.path import (
    PathElement,
    PathSection,
    angle_difference,
    line_between,
    sample_waypoints,
    split_into_sections,
    total_length_in,
)

ARC = PathElement(10.0, -5.0, 0.7, 0.08, 30.0)


def walked(element: PathElement, along: float, steps: int = 20_000) -> tuple[float, float, float]:
    x, y, heading, step = element.x_in, element.y_in, element.heading_rad, along / steps
    for _ in range(steps):
        middle = heading + 0.5 * step * element.curvature
        x, y, heading = x + step * cos(middle), y + step * sin(middle), heading + step * element.curvature
    return x, y, heading


@pytest.mark.long
@pytest.mark.parametrize("curvature", [0.08, -0.15, 0.0])
def test_a_leg_is_where_small_steps_lead(curvature: float) -> None:
    element = ARC._replace(curvature=curvature)
    for along in (0.0, 7.5, 30.0):
        assert element.at(along) == pytest.approx((*walked(element, along), curvature), abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("curvature", [0.08, -0.15, 0.0, 0.2])
def test_nearest_point_of_element_agrees_with_sampling(curvature: float) -> None:
    element, rng = ARC._replace(curvature=curvature), np.random.default_rng(5)
    along = np.linspace(0.0, element.length_in, 3001)
    places = np.array([element.at(float(value))[:2] for value in along])
    for x, y in rng.uniform(-30.0, 50.0, (60, 2)):
        far = np.hypot(*(places - [x, y]).T)
        found = element.at(element.nearest(float(x), float(y)))
        assert hypot(found.x_in - x, found.y_in - y) == pytest.approx(far.min(), abs=1e-3)


def test_a_straight_leg_between_two_points() -> None:
    element = line_between((1.0, 2.0), (4.0, 6.0))
    assert element.at(5.0)[:2] == pytest.approx((4.0, 6.0))
    assert element.length_in == 5.0


def test_corners_split_path_into_sections() -> None:
    # A line, a quarter circle of radius 10 in and a line without a corner; then a corner.
    first = line_between((0.0, 0.0), (10.0, 0.0))
    arc = PathElement(10.0, 0.0, 0.0, 0.1, 0.5 * pi / 0.1)
    up = line_between((20.0, 10.0), (20.0, 30.0))
    path = split_into_sections(
        [first, line_between((10, 0), (10, 0)), arc, up, line_between((20.0, 30.0), (0.0, 30.0))]
    )
    # The line of no length is dropped, the corner starts a new section.
    assert [len(section.elements) for section in path] == [3, 1]
    assert total_length_in(path) == pytest.approx(10.0 + 5.0 * pi + 20.0 + 20.0)
    joined = path[0]
    # 4 in into the second line.
    assert joined.at(10.0 + 5.0 * pi + 4.0) == pytest.approx((20.0, 14.0, 0.5 * pi, 0.0))
    # Beyond the ends, the ends.
    assert joined.at(1e9)[:2] == pytest.approx((20.0, 30.0))
    assert joined.at(-1.0)[:2] == (0.0, 0.0)
    assert split_into_sections([]) == ()


def test_a_stretch_is_looked_at_between_two_places_only() -> None:
    # Up and back at a distance of 10 in: two places are near.
    there_and_back = PathSection(
        (line_between((0, 0), (20, 0)), line_between((20, 0), (20, 10)), line_between((20, 10), (0, 10)))
    )
    # The nearest of all, then only between two lengths of the path.
    assert there_and_back.nearest(5.0, 4.0) == pytest.approx(5.0)
    assert there_and_back.nearest(5.0, 4.0, 22.0) == pytest.approx(45.0)
    assert there_and_back.nearest(5.0, 4.0, 22.0, 30.0) == pytest.approx(24.0)
    assert there_and_back.nearest(5.0, 4.0, 26.0, 30.0) == pytest.approx(26.0)
    # Points at most 1.5 in apart, from 18 in on.
    points = there_and_back.points(1.5, 18.0)
    assert points[0] == pytest.approx((18.0, 0.0))
    assert points[-1] == pytest.approx((0.0, 10.0))
    assert np.hypot(*np.diff(points, axis=0).T).max() <= 1.5 + 1e-9


@pytest.mark.parametrize(("one", "other", "turn"), [(3.0, -3.0, 2 * pi - 6.0), (0.1, 0.3, 0.2), (9.0, 9.5, 0.5)])
def test_turns_go_the_short_path(one: float, other: float, turn: float) -> None:
    assert angle_difference(one, other) == pytest.approx(turn)


def test_waypoints_are_ends_of_lines_and_samples_of_arcs() -> None:
    elements = [line_between((0.0, 0.0), (10.0, 0.0)), PathElement(10.0, 0.0, 0.0, 0.1, 5.0 * pi)]
    found = sample_waypoints(elements, step_in=4.0)
    assert found[0] == pytest.approx((10.0, 0.0))
    assert len(found) == 5
    for x, y in found[1:]:
        assert hypot(x - 10.0, y - 10.0) == pytest.approx(10.0)
    assert found[-1] == pytest.approx((20.0, 10.0))
