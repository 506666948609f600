"""Plans: the shortest path with cheap clearance, along given points, and around obstacles."""

from __future__ import annotations

import numpy as np
import pytest

from localization.navigation.control_law import MODEL_LIMITS
from localization.navigation.path import total_length_in, wall_distances
from localization.navigation.roadmap import DETOUR, MARGINS_IN, NoPathError, PlannedPath, Planner, Roadmap
from worlds.io import load_world
from worlds.robots import N150

WALLS = np.array(load_world("several_walls").walls)
PLANNER = Planner(WALLS, N150.radius_in)


def least_room(plan: PlannedPath) -> float:
    points = np.concatenate([section.points(0.2) for section in plan.sections])
    return float(wall_distances(points, WALLS).min()) - N150.radius_in


@pytest.mark.parametrize("goal", [(90.0, 55.0), (90.0, 0.0), (40.0, 90.0), (0.0, 60.0)])
def test_plan_keeps_margin_and_is_nearly_shortest(goal: tuple[float, float]) -> None:
    plan = PLANNER.plan((5.0, 5.0), goal)
    assert plan.margin_in in MARGINS_IN
    assert least_room(plan) >= plan.margin_in - 1e-4
    shortest = total_length_in(Roadmap(WALLS, N150.radius_in).path((5.0, 5.0), goal))
    assert plan.length_in <= shortest * (1.0 + DETOUR) + 1e-6 or plan.margin_in == MARGINS_IN[0]
    assert plan.length_in <= shortest * 1.05


def test_tight_passage_uses_smallest_margin() -> None:
    plan = PLANNER.plan((5.0, 5.0), (90.0, 9.0))
    assert plan.margin_in == MARGINS_IN[0]


def test_min_margin_option_lengthens_plan() -> None:
    wide = PLANNER.plan((5.0, 5.0), (90.0, 60.0), min_margin_in=3.0)
    assert wide.margin_in >= 3.0
    assert wide.length_in > PLANNER.plan((5.0, 5.0), (90.0, 60.0)).length_in
    assert PLANNER.plan((5.0, 5.0), (40.0, 60.0), min_margin_in=7.5).margin_in == 7.5


def test_obstacles_are_avoided_or_leave_no_path() -> None:
    find = np.array([[28.0, 22.0, 24.0, 26.0]])
    straight, around = PLANNER.plan((5.0, 5.0), (40.0, 60.0)), PLANNER.plan((5.0, 5.0), (40.0, 60.0), find)
    assert around.length_in > straight.length_in
    points = np.concatenate([section.points(0.2) for section in around.sections])
    assert wall_distances(points, find).min() >= N150.radius_in + MARGINS_IN[0] - 1e-4
    with pytest.raises(NoPathError, match="no path from"):
        PLANNER.plan((5.0, 5.0), (90.0, 0.0), np.array([[50.0, 35.0, 60.0, 75.0], [60.0, 75.0, 102.0, 60.0]]))


def test_given_points_are_passed_by_on_straight_paths() -> None:
    points = [(5.0, 5.0), (35.0, 55.0), (90.0, 55.0)]
    plan = PLANNER.along(points, 1.0, MODEL_LIMITS["n150"])
    (section,) = plan.sections
    place = section.at(section.nearest(35.0, 55.0))
    assert np.hypot(place.x_in - 35.0, place.y_in - 55.0) <= 1.0 + 1e-9
    with pytest.raises(NoPathError, match=r"\(5, 5\).*\(90, 0\).* 0\.0 in .*wall"):
        PLANNER.along([(5.0, 5.0), (90.0, 0.0)], 1.0, MODEL_LIMITS["n150"])


def test_around_finds_there_is_the_widest_room_there_is() -> None:
    find = np.array([[28.0, 22.0, 24.0, 26.0]])
    walls = np.concatenate((WALLS, find))
    # The wider margins have no path: the planner took the widest that has one.
    plan = PLANNER.plan((5.0, 5.0), (60.0, 55.0), find)
    wider = [margin for margin in MARGINS_IN if margin > plan.margin_in]
    for margin in wider[:1]:
        with pytest.raises(NoPathError):
            Roadmap(walls, N150.radius_in + margin).path((5.0, 5.0), (60.0, 55.0), N150.radius_in)
    narrow = PLANNER.plan((5.0, 5.0), (60.0, 55.0), np.array([[50.0, 35.0, 50.0, 51.0], [62.0, 75.0, 62.0, 74.9]]))
    # 26 in between (50, 51) and (60, 75): 3.28 in on either side.
    assert narrow.margin_in == 3.0
