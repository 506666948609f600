"""Walls between two points that no sound has crossed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import radians, tan
from pathlib import Path

import numpy as np
import pytest

from localization.filters.belief import Floats, rotate, wrap_angle
from localization.filters.odometry import OdometryNoise
from localization.filters.sonar_cone import ConeSonar
from localization.mapping import association, output, revision, spans, walls
from localization.mapping.association import MapEstimate
from localization.mapping.explore import _span_places
from localization.mapping.features import MIN_DIFFERENCE
from localization.mapping.learn import learn_map
from localization.mapping.merging import find_undecided, split_surfaces
from localization.mapping.output import describe, summary
from localization.mapping.problem import LEVEL_CELL_IN, NO_LEVEL, PARAMETER_STDS, Levels, MapProblem, Reflection
from localization.mapping.reflectors import MAX_GAP_IN, residual_matrix, segments_of
from localization.mapping.revision import close_wall_ends, drop_corner_cuts, join_points, prune, swallow
from localization.mapping.spans import Span, find_wall_ends, pass_through, uncrossed_spans
from localization.mapping.surfaces import costs_of_turns
from localization.mapping.walls import (
    covariance_of,
    extract_walls,
    find_outlines,
    free_paths,
    level_weights,
    passed_walls,
    surface_line,
)
from tests.localization.mapping.drives import ROOM, drive
from worlds.io import format_world, load_world
from worlds.validate import Finding, validate_world
from worlds.world import StartPose, SurfaceSpot, World


@pytest.fixture
def opened(estimate: MapEstimate) -> MapEstimate:
    """The map of the room without its wall at y = -25, of which two points 26 in apart are known."""
    found = estimate.copy()
    south = int(np.argmax(np.abs(pass_through(estimate.state.walls, np.array([[0.0, -25.0, 40.0, -25.0]]), 2.0))[:, 0]))
    found.remove(south)
    found.add_point(np.array((10.0, -25.0)))
    found.add_point(np.array((36.0, -25.0)))
    found.associate()
    return found


def test_points_without_sound_between_them_are_a_wall(opened: MapEstimate) -> None:
    spans = uncrossed_spans(opened, free_paths(opened))
    # With the corners at both sides; the shortest first.
    assert len(spans) == 3
    (span,) = (span for span in spans if {span.one, span.other} == {4, 5})
    np.testing.assert_allclose(np.sort(span.ends.reshape(2, 2), axis=0), [(10.0, -25.0), (36.0, -25.0)])
    assert span.is_wall
    assert join_points(opened) == 1
    assert pass_through(opened.state.walls, span.ends[None], 1.0).any()
    prune(opened)
    (wall,) = (piece for piece in extract_walls(opened) if np.abs(piece.ends[:, 1] + 25.0).max() < 1.0)
    assert wall.ends[:, 0].min() < 11.0
    assert wall.ends[:, 0].max() > 35.0


@pytest.mark.parametrize("half_in", [2.5, 3.5])
def test_short_piece_across_a_wall_is_none(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, half_in: float
) -> None:
    # 5 and 7 in at 40 degrees across the wall at x = 95: both of its ends are nearer to that than SMALL_GAP_IN.
    found, angle, measured_feet = estimate.copy(), 0.7, walls._feet
    place = np.array((95.0, 20.0))
    middle = float(place @ (-np.sin(angle), np.cos(angle)))
    found.add_wall(
        np.array((angle, place @ (np.cos(angle), np.sin(angle)))), np.array((middle - half_in, middle + half_in))
    )
    short, feet = len(estimate.state.walls), np.linspace(middle - half_in, middle + half_in, 8)
    clear = feet, np.ones(len(feet), dtype=np.bool_)
    monkeypatch.setattr(walls, "_feet", lambda of, wall: clear if wall == short else measured_feet(of, wall))
    # Nothing ends at it either.
    before, after = ([piece.ends for piece in extract_walls(each)] for each in (estimate, found))
    np.testing.assert_array_equal(after, before)


@pytest.mark.parametrize("stops_sound", [True, False])
def test_wall_that_stops_sound_is_no_point(
    opened: MapEstimate, monkeypatch: pytest.MonkeyPatch, stops_sound: bool
) -> None:
    join_points(opened)
    # As if a point were always cheaper.
    monkeypatch.setattr(revision, "SWALLOW_IN", np.inf)
    monkeypatch.setattr(spans, "MIN_STOPPED", 1)
    monkeypatch.setitem(association.PENALTY, "wall", 1e6)
    monkeypatch.setattr(revision, "_have_ends", lambda found: np.zeros(len(found.state.walls), dtype=np.bool_))
    if not stops_sound:
        monkeypatch.setattr(revision, "_are_spans", lambda found: np.zeros(len(found.state.walls), dtype=np.bool_))
    swallow(opened)
    south = np.array([[10.0, -25.0, 36.0, -25.0]])
    assert pass_through(opened.state.walls, south, 1.0).any() == stops_sound


@pytest.mark.parametrize(("moved_in", "walls_added"), [(0.5, 1), (5.0, 2)])
def test_wall_that_turns_away_from_its_points_is_added_once(
    opened: MapEstimate, monkeypatch: pytest.MonkeyPatch, moved_in: float, walls_added: int
) -> None:
    """The points move when everything is optimized, and change their order; 5 in farther there are others."""
    first, second = (10.0, -25.0), (36.0, -25.0)
    spans = [
        Span(0, 1, np.array((*first, *second)), 9),
        *(Span(0, 1, np.array((*second, *first)) + moved_in, 9) for _ in range(9)),
    ]
    monkeypatch.setattr(revision, "uncrossed_spans", lambda *_: [spans.pop(0)])
    monkeypatch.setattr(revision, "_with_span", lambda found, _: found.copy())
    assert join_points(opened) == walls_added


def test_best_span_of_those_in_one_direction_is_joined(opened: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    """From (0, 0): a point beside the line comes first, the wall's end costs least, and others are of other walls."""
    spans = [
        Span(1, 0, np.array((18.0, 3.0, 0.0, 0.0)), 9),
        Span(0, 2, np.array((0.0, 0.0, 22.0, 0.0)), 9),
        Span(0, 3, np.array((0.0, 0.0, 22.0, -6.0)), 9),
        Span(0, 4, np.array((0.0, 0.0, 0.0, 30.0)), 9),
        Span(0, 5, np.array((0.0, 0.0, -25.0, 1.0)), 9),
        Span(2, 6, np.array((22.0, 0.0, 40.0, 1.0)), 9),
    ]
    costs = {1: 50.0, 2: 40.0, 4: 1.0, 5: 2.0, 6: 3.0}
    trials, taken = {number: opened.copy() for number in costs}, list[MapEstimate]()
    for number, trial in trials.items():
        trial.label = number  # type: ignore[attr-defined]
    monkeypatch.setattr(MapEstimate, "cost", property(lambda self: costs[self.label]))
    monkeypatch.setattr(MapEstimate, "replace_by", lambda _, other: taken.append(other))
    found = iter([spans, []])
    monkeypatch.setattr(revision, "uncrossed_spans", lambda *_: next(found))
    # The third is no wall.
    monkeypatch.setattr(revision, "_with_span", lambda _, span: trials.get(span.other or span.one))
    assert join_points(opened) == 1
    (best,) = taken
    assert best is trials[2]


def test_points_with_sound_between_them_are_none(estimate: MapEstimate, opened: MapEstimate) -> None:
    found = estimate.copy()
    found.add_point(np.array((20.0, 25.0)))
    found.add_point(np.array((50.0, 25.0)))
    assert uncrossed_spans(found, free_paths(found)) == []
    # Two paths decide it; a single one may be a mistaken echo.
    across = np.array(((20.0, 0.0), (30.0, 0.0), (31.0, 0.0))), np.array(((20.0, -50.0), (30.0, -50.0), (31.0, -10.0)))
    assert {4, 5} not in [{span.one, span.other} for span in uncrossed_spans(opened, across)]
    single = (across[0][1:], across[1][1:])
    assert {4, 5} in [{span.one, span.other} for span in uncrossed_spans(opened, single)]


@pytest.mark.parametrize(("beyond_in", "surface_in", "is_open"), [
    (3.0, 0.0, True), (3.0, 3.5, False), (4.0, 3.5, True),
])  # fmt: skip
def test_sound_that_ends_where_a_surface_may_be_has_not_passed(
    opened: MapEstimate, monkeypatch: pytest.MonkeyPatch, beyond_in: float, surface_in: float, is_open: bool
) -> None:
    monkeypatch.setattr(MapEstimate, "surface_in", surface_in)
    starts = np.array(((20.0, 0.0), (30.0, 0.0)))
    paths = starts, starts - (0.0, 25.0 + beyond_in)
    assert ({4, 5} not in [{span.one, span.other} for span in uncrossed_spans(opened, paths)]) == is_open


def test_what_is_measured_behind_a_span_leaves_it_open(opened: MapEstimate) -> None:
    # The wall is 6 in behind two points, as a door is behind its posts.
    opened.add_point(np.array((10.0, -19.0)))
    opened.add_point(np.array((50.0, -19.0)))
    opened.associate()
    pairs = [{span.one, span.other} for span in uncrossed_spans(opened, free_paths(opened))]
    assert {4, 5} in pairs
    assert {6, 7} not in pairs


def test_span_belongs_to_the_line_nearest_to_it(opened: MapEstimate) -> None:
    assert join_points(opened) == 1
    before = len(extract_walls(opened))
    angle, offset = opened.state.walls[-1]
    opened.add_wall(np.array((angle, offset + 1.0)), opened.extents[-1])
    assert len(extract_walls(opened)) == before


def test_span_along_a_surface_belongs_to_what_was_measured_there() -> None:
    # Two parts of a wall along x, with lines at y = 0 and y = 2, and a wall across it.
    x, y = np.array((1.0, 0.0)), np.array((0.0, 1.0))
    lines = [walls._Line(n, a, at, np.zeros(0), np.zeros(0)) for n, a, at in ((y, x, 0.0), (y, x, 2.0), (x, -y, 30.0))]
    runs_of = [[(50.0, 90.0, 20)], [(0.0, 10.0, 5), (14.0, 20.0, 5)], [(-80.0, 0.0, 30)]]

    def owner(
        first: float, last: float, at: float, *, has_levels: bool = True, other: float | None = None
    ) -> int | None:
        ends = np.array((first, at, last, at if other is None else other))
        return walls._owner_of(Span(0, 1, ends, 4), lines, runs_of, 6.0, has_levels)

    # A post of the second part is nearer to the line of the first one.
    assert owner(5.0, 30.0, 0.5) == 1
    assert owner(5.0, 30.0, 0.5, has_levels=False) == 0
    assert owner(40.0, 60.0, 0.5) == 0
    # Nothing was measured between both parts, so the level there is unknown; and not this far from a line.
    assert owner(25.0, 45.0, 0.5) is None
    assert owner(5.0, 30.0, 8.1) is None
    # What leads across the wall is no part of it.
    assert owner(14.0, 20.0, -3.0, other=3.0) is None
    # A wall that no echo is of is as known as its two points.
    runs_of[0] = []
    assert owner(25.0, 45.0, 0.5) == 0
    # Of both faces of a thick wall the nearer one, however little of it was measured there.
    runs_of[:2] = [(0.0, 30.0, 9)], [(0.0, 60.0, 20)]
    assert owner(25.0, 55.0, 0.2) == 0
    assert owner(25.0, 55.0, 1.8) == 1


def test_span_is_a_wall_if_sound_is_stopped_all_along(opened: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    (span,) = (span for span in uncrossed_spans(opened, free_paths(opened)) if {span.one, span.other} == {4, 5})
    # Between the outermost sonars and the ends, and between neighbours, less than a robot needs.
    assert 4.0 <= span.gap_in <= MAX_GAP_IN
    monkeypatch.setattr(spans, "MAX_GAP_IN", 0.9 * span.gap_in)
    assert not span.is_wall


def test_span_that_too_few_sonars_were_directed_at_is_visited(
    opened: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    def visited() -> set[tuple[str, int, int]]:
        places = _span_places(opened, free_paths(opened))
        return {(place.kind, round(place.x_in), round(place.y_in)) for place in places}

    before_both_sides = {("span", 23, -43), ("span", 23, -7)}
    assert not before_both_sides & visited()
    monkeypatch.setattr(spans, "MIN_STOPPED", 1000)
    assert len(visited()) == 6
    assert before_both_sides <= visited()


def test_diagonals_of_a_box_are_no_walls(estimate: MapEstimate) -> None:
    found, first = estimate.copy(), len(estimate.state.points)
    corners = [(20.0, 100.0), (32.0, 100.0), (32.0, 112.0), (20.0, 112.0)]
    for corner in corners[:3]:
        found.add_point(np.array(corner))

    def lengths(paths: tuple[Floats, Floats]) -> list[int]:
        spans = [span for span in uncrossed_spans(found, paths) if min(span.one, span.other) >= first]
        return [round(float(np.hypot(*(span.ends[2:] - span.ends[:2])))) for span in spans]

    # Without its fourth corner nothing tells a diagonal from a side.
    assert lengths(free_paths(found)) == [12, 12, 17]
    found.add_point(np.array(corners[3]))
    assert lengths(free_paths(found)) == [12] * 4
    # Sound has passed one side: no box, and what crosses may be a wall.
    across = np.array(((26.0, 90.0), (27.0, 90.0))), np.array(((26.0, 101.0), (27.0, 101.0)))
    assert lengths(across) == [12, 12, 12, 17, 17]


def test_fourth_side_of_a_box_closes_its_outline(estimate: MapEstimate) -> None:
    # A box that nothing was measured of, but that three of its sides are walls.
    found = estimate.copy()
    for corner in ((20.0, 100.0), (32.0, 100.0), (32.0, 112.0), (20.0, 112.0)):
        found.add_point(np.array(corner))
    first = len(found.state.points) - 4
    for line, extent in (((np.pi / 2.0, 100.0), (-32.0, -20.0)), ((0.0, 32.0), (100.0, 112.0)),
                         ((np.pi / 2.0, 112.0), (-32.0, -20.0))):  # fmt: skip
        spans = uncrossed_spans(found, free_paths(found))
        assert not any(span.closes_outline for span in spans)
        found.add_wall(np.array(line), np.array(extent))
    (fourth,) = (span for span in uncrossed_spans(found, free_paths(found)) if span.closes_outline)
    assert {fourth.one, fourth.other} == {first, first + 3}
    assert fourth.is_wall


@pytest.mark.parametrize("count", [1, 2])
def test_map_of_one_or_two_walls_is_a_world(estimate: MapEstimate, tmp_path: Path, count: int) -> None:
    # Few walls fix their own frame: nothing is left of their offsets, and a file states deviations above 0.
    few = estimate.copy()
    while len(few.state.walls) > count:
        few.remove(len(few.state.walls) - 1)
    few.associate()
    # Points that the same map has tell how well the walls are known.
    assert len(few.state.points)
    assert min(wall.std_in for wall in describe(few).walls) > 0.02
    while len(few.state.points):
        few.remove(len(few.state.walls))
    few.associate()
    found = describe(few)
    assert len(found.walls) == count
    assert max(wall.std_in for wall in found.walls) < 1e-6
    file = tmp_path / "few.toml"
    file.write_text(format_world(found.world("few")))
    # A file has degrees.
    for row, accuracy in load_world(file).accuracies.items():
        assert accuracy[:3] == pytest.approx(found.world("few").accuracies[row][:3], rel=1e-12)


@pytest.mark.parametrize(("spots", "pieces"), [((19.0, 36.0), 2), ((19.0, 28.0, 36.0), 1)])
def test_two_spots_between_posts_make_no_wall_across_a_door(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, spots: tuple[float, ...], pieces: int
) -> None:
    # The wall at y = -25 with the posts of a door at x = 10 and 45: no gap between the spots is wider than 20 in.
    found, measured_feet = estimate.copy(), walls._feet
    south = int(np.argmax(pass_through(estimate.state.walls, np.array([[0.0, -25.0, 40.0, -25.0]]), 2.0)[:, 0]))
    for x in (10.0, 45.0):
        found.add_point(np.array((x, -25.0)))
    angle = float(found.state.walls[south, 0])
    measured = np.concatenate((np.linspace(-20.0, 9.0, 15), spots, np.linspace(46.0, 90.0, 20)))
    feet = np.stack((measured, np.full(len(measured), -25.0)), axis=-1) @ (-np.sin(angle), np.cos(angle))
    clear = np.sort(feet), np.ones(len(feet), dtype=np.bool_)
    monkeypatch.setattr(walls, "_feet", lambda of, wall: clear if wall == south else measured_feet(of, wall))
    monkeypatch.setattr(walls, "uncrossed_spans", lambda *_: [])
    assert sum(piece.wall == south for piece in extract_walls(found)) == pieces


def test_wall_behind_which_something_was_measured_is_passed(estimate: MapEstimate) -> None:
    pieces = extract_walls(estimate)
    assert passed_walls(estimate, pieces) == []
    # The same wall once more, 5 in before it, as of a robot that came back and did not recognize it.
    longest = pieces[0]
    middle = longest.ends.mean(axis=0)
    inward = estimate.state.poses[:, :2].mean(axis=0) - middle
    double = replace(longest, ends=longest.ends + 5.0 * inward / np.hypot(*inward))
    assert passed_walls(estimate, [*pieces, double]) == [double]
    # A robot that stands behind it has measured nothing behind it.
    behind = replace(longest, ends=longest.ends - 5.0 * inward / np.hypot(*inward))
    assert passed_walls(estimate, [behind]) == []


@pytest.mark.parametrize(("others", "behind_in", "dropped"), [(0, 50.0, 1), (1, 50.0, 1), (2, 50.0, 0), (0, 8.0, 0)])
def test_what_is_seen_through_an_unmeasured_part_of_a_wall_alone_is_none(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, others: int, behind_in: float, dropped: int
) -> None:
    found = estimate.copy()
    south = int(np.argmax(pass_through(estimate.state.walls, np.array([[0.0, -25.0, 40.0, -25.0]]), 2.0)[:, 0]))
    # A wall behind the one at y = -25, and nothing of that from x = 15 to 45. One 8 in behind is a door.
    found.add_wall(np.array((-0.5 * np.pi, 25.0 + behind_in)), np.array((15.0, 45.0)))
    echoes = estimate.echoes_of(south)
    x = residual_matrix(estimate.problem, estimate.state, estimate.extents, echoes)[2][:, south, 0]
    feature = found.assignment.feature.copy()
    feature[echoes[(x > 15.0) & (x < 45.0)]] = ghost = len(found.state.walls) - 1
    found.assignment = replace(found.assignment, feature=feature)
    assert len(found.echoes_of(ghost)) > 5
    # Paths through the gap that are of something else, and an end at which there is a corner, make it a wall.
    starts, ends = free_paths(found)
    through = np.array([(20.0, 0.0)] * others).reshape(-1, 2), np.array([(20.0, -60.0)] * others).reshape(-1, 2)
    is_inside = ends[:, 1] > -24.0
    paths = np.concatenate((starts[is_inside], through[0])), np.concatenate((ends[is_inside], through[1]))
    monkeypatch.setattr(walls, "free_paths", lambda _: paths)
    assert revision.drop_hidden(found) == dropped


def test_walls_of_uncertain_place_are_not_written(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    found = describe(estimate)
    assert found.uncertain == ()
    stds = sorted(wall.std_in for wall in found.walls)
    # With the smooth surface of 0.15 in.
    assert output.highest_std_in(estimate) == pytest.approx((0.5**2 + 0.15**2) ** 0.5)
    monkeypatch.setattr(output, "highest_std_in", lambda _: 0.5 * (stds[-2] + stds[-1]))
    fewer = describe(estimate)
    assert [wall.std_in for wall in fewer.uncertain] == [stds[-1]]
    assert len(fewer.world("fewer").inner_walls) == len(fewer.walls) == len(found.walls) - 1
    assert fewer.reason_to_refuse() == ""
    assert "not written" in summary(fewer)
    assert len(fewer.as_json()["uncertain_in"]) == 1
    # Of a map that is known only in part nothing is written.
    monkeypatch.setattr(output, "highest_std_in", lambda _: 0.5 * (stds[0] + stds[1]))
    assert "of its 4 walls are known well enough" in describe(estimate).reason_to_refuse()


# Closed outlines.

BOX = ((20.0, 100.0), (32.0, 100.0), (32.0, 112.0), (20.0, 112.0))


def boxed(estimate: MapEstimate, sides: int) -> tuple[MapEstimate, list[walls.Piece]]:
    """Return the map with the corners of a box that no path has reached, and its walls along so many sides."""
    found = estimate.copy()
    for corner in BOX:
        found.add_point(np.array(corner))
    pieces = extract_walls(estimate)
    for one, other in list(zip(BOX, (*BOX[1:], BOX[0]), strict=True))[:sides]:
        pieces.append(walls.Piece(99, 0.0, 0.0, np.array((one, other)), [True, True], 9))
    return found, pieces


def test_three_walls_of_a_box_are_a_closed_outline(estimate: MapEstimate) -> None:
    found, pieces = boxed(estimate, 3)
    (outline,) = find_outlines(found, pieces)
    assert sorted(outline.corners.tolist()) == sorted(map(list, BOX))
    assert sorted(outline.walls) == [len(pieces) - 3, len(pieces) - 2, len(pieces) - 1]
    # In order: along the sides, not along a diagonal.
    closed = np.concatenate((outline.corners, outline.corners[:1]))
    np.testing.assert_allclose(np.hypot(*np.diff(closed, axis=0).T), 12.0)
    # Two walls and four corners are none while nothing tells that the other sides stop sound.
    assert find_outlines(*boxed(estimate, 2)) == []


@pytest.mark.parametrize("end", [(26.0, 108.0), (45.0, 106.0)])  # inside, and beyond
def test_outline_is_not_closed_through_free_space(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, end: tuple[float, float]
) -> None:
    found, pieces = boxed(estimate, 3)
    # A single path may be a mistaken echo, and the same from a place beside it is no other one.
    for starts, outlines in (((10.0,), 1), ((10.0, 2.0), 1), ((10.0, -3.0), 0)):
        paths = np.array([(x, 106.0) for x in starts]), np.tile(end, (len(starts), 1))
        monkeypatch.setattr(walls, "free_paths", lambda _, paths=paths: paths)
        assert len(find_outlines(found, pieces)) == outlines
    # Two steps of a robot cross it, each of them a different side.
    steps = np.array([(18.0, 106.0), (30.0, 105.0)]), np.array([(22.0, 106.0), (34.0, 105.0)])
    monkeypatch.setattr(walls, "free_paths", lambda _: steps)
    assert len(find_outlines(found, pieces)) == 1
    monkeypatch.setattr(walls, "free_paths", lambda _: tuple(np.repeat(part, 2, axis=0) for part in steps))
    assert not find_outlines(found, pieces)


def test_outline_of_walls_measured_from_inside_is_no_box(estimate: MapEstimate) -> None:
    # The room itself, if it were as small as a box.
    pieces = extract_walls(estimate)
    assert find_outlines(estimate, pieces) == []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walls, "MAX_BOX_IN", 200.0)
        patch.setattr(walls, "free_paths", lambda _: (np.zeros((0, 2)), np.zeros((0, 2))))
        assert find_outlines(estimate, pieces) == []
        patch.setattr(walls, "OUTSIDE", 0.0)
        assert len(find_outlines(estimate, pieces)) == 1


@pytest.mark.parametrize(("stopped", "outlines"), [
    ((4, 4, 0, 0), 1), ((4, 4, None, None), 0), ((4, 4, 4, None), 1),  # two and three silent sides
    ((2, 1, 1, 0), 1), ((1, 1, 1, 0), 0), ((2, 2, 2, None), 0),  # all four together; one has been crossed
])  # fmt: skip
def test_corners_that_let_no_sound_pass_are_a_closed_outline(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch, stopped: tuple[int | None, ...], outlines: int
) -> None:
    found, pieces = boxed(estimate, 0)
    first = len(found.state.points) - 4
    assert find_outlines(found, pieces) == []
    spans = [
        Span(first + k, first + (k + 1) % 4, np.array((*BOX[k], *BOX[(k + 1) % 4])), count)
        for k, count in enumerate(stopped) if count is not None
    ]  # fmt: skip
    monkeypatch.setattr(walls, "uncrossed_spans", lambda *_: spans)
    assert len(find_outlines(found, pieces)) == outlines


def test_points_in_a_row_make_no_box(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    found, first = estimate.copy(), len(estimate.state.points)
    row = [(20.0, 100.0), (30.0, 101.0), (40.0, 100.0), (50.0, 101.0)]
    for point in row:
        found.add_point(np.array(point))
    spans = [
        Span(first + one, first + other, np.array((*row[one], *row[other])), 9)
        for one in range(4) for other in range(one)
    ]  # fmt: skip
    monkeypatch.setattr(walls, "uncrossed_spans", lambda *_: spans)
    assert find_outlines(found, extract_walls(estimate)) == []


def test_box_is_an_obstacle_of_the_world(estimate: MapEstimate, tmp_path: Path) -> None:
    found = describe(estimate)
    corners = np.array(BOX)
    sides = [
        walls.Piece(99, 0.0, 9.0, np.array(ends), [False, True], 9, 0.1, 0.01)
        for ends in (BOX[:2], BOX[1:3], BOX[2:])
    ]
    count = len(found.walls)
    outline = walls.Outline(corners, (count, count + 1, count + 2))
    points = np.concatenate((found.points, corners + np.array((3.0, 0.0))))
    found = replace(found, walls=(*found.walls, *sides), outlines=(outline,), points=points)
    world = found.world("boxes")
    assert [(solid.name, solid.corners_in) for solid in world.obstacles] == [("box 1", BOX)]
    # Each wall once: in an outline, or by itself with its accuracy.
    assert len(world.inner_walls) == len(world.accuracies) == count
    file = tmp_path / "box.toml"
    file.write_text(format_world(world))
    assert load_world(file).walls.shape == (count + 4, 4)
    assert found.as_json()["outlines_in"] == [corners.tolist()]
    assert "closed outline: (20.0, 100.0), (32.0, 100.0)" in summary(found)
    # Points at a box are no posts, and its sides have no open ends.
    assert not len(found.posts)
    assert found.open_ends == describe(estimate).open_ends


# Surfaces.


def with_surface(estimate: MapEstimate, seed: int) -> MapEstimate:
    """Return the map with levels of its first two walls, the second one's a single cell."""
    rng = np.random.default_rng(seed)
    found, cells = estimate.copy(), np.array([*range(-6, 9), 3])
    levels = Levels(np.array([0] * 15 + [1]), cells, 1.6 * rng.normal(size=16), np.zeros(16), rng.random(16) < 0.3)
    found.state = replace(found.state, levels=levels)
    return found


def test_line_of_a_surface_has_the_mean_level_of_its_cells(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: numpy's weighted average, and the distances of the levels from a wall in the same direction."""
    found = with_surface(estimate, 3)
    variances = np.random.default_rng(5).uniform(0.0, 1.0, 16)
    monkeypatch.setattr(MapProblem, "level_variances", lambda *_: variances)
    state, weights = found.state, level_weights(found)
    for number, count in ((0, 15), (1, 1)):
        own = state.levels.of(number)
        assert own.stop - own.start == count
        mean = np.average(state.levels.value_in[own], weights=1.0 / (variances[own] + 0.4**2))
        assert surface_line(found, number, weights)[0] == pytest.approx(state.walls[number] + (0.0, mean))
    np.testing.assert_array_equal(surface_line(found, 2, weights)[0], state.walls[2])
    # A part has that of the cells whose middles are on it, here two; between two middles it has none of its own.
    part = np.average(state.levels.value_in[4:6], weights=1.0 / (variances[4:6] + 0.4**2))
    low = LEVEL_CELL_IN * (state.levels.cell[4] + 0.5)
    line, _ = surface_line(found, 0, weights, (low - 0.1, low + LEVEL_CELL_IN + 0.1))
    assert line == pytest.approx(state.walls[0] + (0.0, part))
    between, _ = surface_line(found, 0, weights, (low + 0.1, low + LEVEL_CELL_IN - 0.1))
    np.testing.assert_array_equal(between, surface_line(found, 0, weights)[0])


def test_parts_of_a_wall_with_a_step_have_lines_of_their_own(estimate: MapEstimate) -> None:
    """The wall y = -25 has a step of 4 in at x = 40, and nothing was measured from x = 32 to 46."""
    found = with_levels(estimate)
    south = int(np.abs(np.sin(found.state.walls[:, 0]) * found.state.walls[:, 1] + 25.0).argmin())
    angle, offset = found.state.walls[south]
    own = found.state.levels.of(south)
    at = LEVEL_CELL_IN * (found.state.levels.cell[own] + 0.5)
    x = -np.sin(angle) * at
    values = found.state.levels.value_in.copy()
    values[own] = np.where(x > 40.0, 4.0, 0.0)
    found.state = replace(found.state, levels=replace(found.state.levels, value_in=values))
    feet = np.sort(-np.sin(angle) * np.concatenate((np.arange(0.0, 34.0, 2.0), np.arange(46.0, 80.0, 2.0))))
    measured, nothing = ((some, np.ones(len(some), dtype=np.bool_)) for some in (feet, feet[:0]))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(walls, "_feet", lambda _, wall: measured if wall == south else nothing)
        patch.setattr(walls, "MAX_GAP_IN", 8.0)
        pieces = [piece for piece in extract_walls(found) if piece.wall == south]
    assert len(pieces) == 2
    for piece, level in zip(sorted(pieces, key=lambda piece: piece.ends[:, 0].min()), (0.0, 4.0), strict=True):
        np.testing.assert_allclose(piece.measured_ends @ (np.cos(angle), np.sin(angle)), offset + level, atol=1e-9)


def test_measured_spots_of_a_surface_are_part_of_the_map(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: each spot is a level beside the plane of its wall, in the middle of a cell that echoes measured."""
    found = with_surface(with_levels(estimate), 3)
    measured = np.arange(2, 9)
    level = np.full(len(found.assignment.feature), NO_LEVEL)
    level[: len(measured)] = measured
    found.assignment = replace(found.assignment, level=level)
    monkeypatch.setattr(MapProblem, "level_variances", lambda *_: np.full(16, 0.09))
    angle, offset = found.state.walls[0]
    n, u = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    pieces = [piece for piece in extract_walls(found) if piece.wall == 0]
    spots = np.concatenate([piece.surface for piece in pieces])
    assert len(spots)
    expected = {
        LEVEL_CELL_IN * (cell + 0.5): value
        for cell, value in zip(found.state.levels.cell[measured], found.state.levels.value_in[measured], strict=True)
    }
    for x, y, std_in in spots:
        assert expected[round(u @ (x, y), 6)] == pytest.approx(n @ (x, y) - offset)
        assert std_in == pytest.approx(0.3)
    # In the frame of the map they are turned with the wall: as far along it and beside it.
    learned = describe(found)
    turned = [wall for wall in (*learned.walls, *learned.uncertain) if wall.wall == 0]
    for wall, piece in zip(turned, pieces, strict=True):
        coordinates = []
        for ends, surface in ((wall.ends, wall.surface), (piece.ends, piece.surface)):
            along = (ends[1] - ends[0]) / np.hypot(*(ends[1] - ends[0]))
            coordinates.append((surface[:, :2] - ends[0]) @ np.array((along, (-along[1], along[0]))).T)
        np.testing.assert_allclose(coordinates[0], coordinates[1], atol=1e-9)
        assert wall.accuracy.surface == tuple(SurfaceSpot(*spot) for spot in np.round(wall.surface, 3).tolist())


@pytest.mark.parametrize("slope_deg", [2.0, 4.0])
def test_wall_of_echoes_that_others_explain_is_none(estimate: MapEstimate, slope_deg: float) -> None:
    found, walls_before = estimate.copy(), len(estimate.state.walls)
    assert revision.drop_spurious_walls(found) == 0
    # Through the middle of the wall at y = -25, whose echoes are within the noise of both lines.
    angle = -0.5 * np.pi + radians(slope_deg)
    normal = np.array((np.cos(angle), np.sin(angle)))
    middle = np.array((35.0, -25.0))
    at = float(middle @ (-normal[1], normal[0]))
    found.add_wall(np.array((angle, middle @ normal)), np.array((at - 15.0, at + 15.0)))
    found.associate()
    found.optimize()
    found.associate()
    assert len(found.echoes_of(walls_before)) > 5
    assert revision.drop_spurious_walls(found) == 1
    assert len(found.state.walls) == walls_before
    assert found.cost == pytest.approx(estimate.cost, abs=1.0)


def test_slanted_walls_must_show_in_the_ranges(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall across a corner, 45 and 20 in from it, takes some echoes of both walls; without it these explain them."""
    slanted = np.array(((-25.0, 30.0), (-5.0, 75.0)))
    along = slanted[1] - slanted[0]
    angle = float(np.arctan2(-along[0], along[1]))
    line = np.array((angle, slanted[0] @ (np.cos(angle), np.sin(angle))))
    extent = np.sort(slanted @ (-np.sin(angle), np.cos(angle)))

    def with_slanted(made: MapEstimate) -> MapEstimate:
        made.add_wall(line, extent)
        made.associate()
        made.optimize(3)
        return made

    made = with_slanted(with_levels(estimate))
    count = len(made.state.walls)
    assert len(made.echoes_of(count - 1)) > 0
    # What the wall saves: the cost of ranges, odometry and levels without it, less that with it.
    settled, without = made.copy(), made.copy()
    without.remove(count - 1)
    costs = []
    for of_map in (without, settled):
        revision._settle(of_map)
        costs.append(of_map.problem.cost(of_map.state, of_map.assignment) + float(of_map._level_penalties.sum()))
    saved = costs[0] - costs[1] + float(settled.surface_costs[-1])
    for limit, dropped in ((saved - 1.0, 0), (saved + 1.0, 1)):
        monkeypatch.setattr(revision, "MIN_SLANTED_GAIN", limit)
        trial = made.copy()
        assert revision.drop_slanted(trial) == dropped
        assert len(trial.state.walls) == count - dropped
    # Planes are left to `prune`.
    assert revision.drop_slanted(with_slanted(estimate.copy())) == 0
    # Of two slanted walls with others between them the one that explains many ranges stays.
    monkeypatch.undo()
    second = revision._turned_wall(made, 1, radians(5.0))
    monkeypatch.setattr(revision, "_off_axes", lambda _: np.radians((0.0, 20.0, 0.0, 0.0, 30.0)))
    assert revision.drop_slanted(second) == 1
    assert len(second.state.walls) == count - 1
    assert len(second.echoes_of(1)) > 20


def test_measured_part_of_a_wall_moves_with_it() -> None:
    piece = walls.Piece(0, 12.0, 30.0, np.array(((10.0, 5.0), (34.0, 5.0))), [True, True], 9, spots=(15.0, 26.0))
    np.testing.assert_allclose(piece.measured_ends, ((15.0, 5.0), (26.0, 5.0)))
    assert piece.measured_in == 11.0
    quarter, shift = np.array(((0.0, 1.0), (-1.0, 0.0))), np.array((100.0, -40.0))
    moved = piece.placed(lambda points: np.asarray(points @ quarter + shift, dtype=np.float64))
    np.testing.assert_allclose(moved.measured_ends, piece.measured_ends @ quarter + shift)
    assert moved.high - moved.low == pytest.approx(18.0)


X, Y = np.array((1.0, 0.0)), np.array((0.0, 1.0))
"""Along an outer wall, and along the inner wall that divides it."""


def line_at(normal: Floats, offset: float, crossed: Sequence[float] = ()) -> walls._Line:
    """Return a line across X or Y, with the coordinates where paths have crossed it."""
    return walls._Line(normal, X if normal is Y else Y, offset, np.zeros(0), np.array(crossed))


def piece_on(line: walls._Line, wall: int, low: float, high: float, *spots: float) -> walls.Piece:
    """Return an open piece of a line, with the spots at its ends unless they are `spots`."""
    ends = np.array((line.at(low), line.at(high)))
    return walls.Piece(wall, low, high, ends, [False, False], 9, spots=(spots[0], spots[1]) if spots else None)


NO_PATHS = np.zeros((0, 2)), np.zeros((0, 2))


def with_ends(
    pieces: list[walls.Piece], lines: list[walls._Line], points: Sequence[tuple[float, float]] = (),
    paths: tuple[Floats, Floats] = NO_PATHS,
) -> list[walls.Piece]:  # fmt: skip
    return walls._with_ends(pieces, lines, np.array(points).reshape(-1, 2), paths, 3.5)[0]


def check(pieces: Sequence[walls.Piece]) -> list[Finding]:
    """Return what `nomad map check` reports of walls, but for the space behind what is a part of a room only."""
    segments = np.array([piece.ends.reshape(4) for piece in pieces])
    found = validate_world(World("own", inner_walls=segments, starts=(StartPose(-40.0, 30.0),)), 1.0)
    return [finding for finding in found if finding.kind != "closed off"]


@pytest.mark.parametrize(("step_in", "from_in"), [
    (0.0, 2.0), (0.3, 2.0), (3.0, 2.0), (5.0, 2.0), (-0.3, 2.0), (-3.0, 2.0), (-5.0, 2.0), (0.3, 15.0), (-3.0, 15.0),
])  # fmt: skip
def test_both_parts_of_a_wall_with_a_step_end_at_the_wall_that_divides_them(step_in: float, from_in: float) -> None:
    lines = [line_at(Y, 0.0), line_at(Y, step_in), line_at(X, 0.0)]
    spots = [(-50.0, -2.0), (from_in, 50.0), (7.0, 60.0)]
    pieces = [piece_on(line, wall, *spot) for wall, spot, line in zip((0, 0, 1), spots, lines, strict=True)]
    left, right, inner = with_ends(pieces, lines)
    assert left.closed[1]
    assert right.closed[0]
    assert inner.closed[0]
    np.testing.assert_allclose([left.ends[1], right.ends[0]], [(0.0, 0.0), (0.0, step_in)], atol=1e-9)
    # The inner wall reaches the farther one, beside which it would leave a gap.
    np.testing.assert_allclose(inner.ends, [(0.0, min(step_in, 0.0)), (0.0, 60.0)], atol=1e-9)
    assert check([left, right, inner]) == []


SPANS = (-50.0, 30.0), (-30.0, 50.0)
"""Two parts of a wall that are divided at 0, each with a span past that, to a post."""


@pytest.mark.parametrize("step_in", [0.0, 0.3, 2.0, 5.0])
@pytest.mark.parametrize("spots", [((-50.0, -2.0), (2.0, 50.0)), ((-50.0, 1.0), (-3.0, 50.0))])
@pytest.mark.parametrize("has_posts", [False, True])
def test_spans_end_at_the_wall_behind_which_they_are_hidden(
    step_in: float, spots: Sequence[tuple[float, float]], has_posts: bool
) -> None:
    lines = [line_at(Y, 0.0), line_at(Y, step_in), line_at(X, 0.0)]
    pieces = [piece_on(lines[row], row, *SPANS[row], *spots[row]) for row in range(2)]
    posts = [(30.0, 0.0), (-30.0, step_in)] if has_posts else []
    left, right, inner = found = with_ends([*pieces, piece_on(lines[2], 2, 7.0, 60.0)], lines, posts)
    np.testing.assert_allclose([left.ends[1], right.ends[0]], [(0.0, 0.0), (0.0, step_in)], atol=1e-9)
    np.testing.assert_allclose(inner.ends[0], (0.0, 0.0), atol=1e-9)
    assert left.closed[1]
    assert right.closed[0]
    # What was measured is within.
    assert left.measured[1] <= 1e-9
    assert right.measured[0] >= -1e-9
    assert check(found) == []


@pytest.mark.parametrize(("inner", "crossed", "ahead_in", "end_in"), [
    ((7.0, 60.0), (), None, 0.0),
    ((7.0, 60.0), (), 12.0, 30.0),  # something was measured behind it
    ((-60.0, -7.0), (), 12.0, 30.0),  # it is a wall of the next room
    ((7.0, 60.0), (), 30.0, 0.0),  # what was measured is past it
    ((27.0, 60.0), (), None, 30.0),  # it ends far from there
    ((17.0, 60.0), (5.0, 8.0, 10.0), None, 30.0),  # paths lead between both
])  # fmt: skip
def test_a_span_is_cut_only_where_it_is_hidden(
    inner: tuple[float, float], crossed: Sequence[float], ahead_in: float | None, end_in: float
) -> None:
    lines = [line_at(Y, 0.0), line_at(X, 0.0, crossed), line_at(X, 30.0)]
    pieces = [
        piece_on(lines[0], 0, -50.0, 30.0, -50.0, -2.0), piece_on(lines[1], 1, *inner),
        piece_on(lines[2], 2, 5.0, 60.0),
    ]  # fmt: skip
    paths = NO_PATHS
    if ahead_in is not None:
        paths = np.tile((2.0, ahead_in), (3, 1)), np.tile((29.0, ahead_in), (3, 1))
    left, *_ = with_ends(pieces, lines, [(30.0, 0.0)], paths)
    np.testing.assert_allclose(left.ends[1], (end_in, 0.0), atol=1e-9)


def test_a_line_along_a_span_does_not_cut_it() -> None:
    slanted = np.array((np.sin(radians(8.0)), np.cos(radians(8.0))))
    along = np.array((slanted[1], -slanted[0]))
    lines = [line_at(Y, 0.0), walls._Line(slanted, along, 0.0, np.zeros(0), np.zeros(0))]
    pieces = [piece_on(lines[0], 0, -50.0, 30.0, -50.0, -2.0), piece_on(lines[1], 1, -40.0, -10.0)]
    assert with_ends(pieces, lines)[0].ends[1].tolist() == [30.0, 0.0]


@pytest.mark.parametrize(("apart_in", "count"), [(0.2, 1), (1.5, 2)])
def test_sides_of_a_wall_over_one_another_are_one(apart_in: float, count: int) -> None:
    # The second line leads the other way, as the opposite side of a wall does; the third one is beyond both.
    lines = [line_at(Y, 0.0), replace(line_at(-Y, -apart_in), along=-X), line_at(Y, 0.1)]
    pieces = [
        piece_on(lines[0], 0, 0.0, 40.0, 4.0, 38.0), piece_on(lines[1], 1, -62.0, -20.0, -60.0, -22.0),
        piece_on(lines[2], 2, 90.0, 130.0),
    ]  # fmt: skip
    found, its = walls._without_doubled(pieces, lines)
    assert [piece.wall for piece in found] == [[0, 1, 2], [1, 2]][count == 1]
    assert all(one is other for one, other in zip(its, lines[2 - count :], strict=True))
    if count == 1:
        # What was measured, and the spots of its surface, are those of the longer one.
        assert found[0].measured == (-60.0, -22.0)
        assert found[0].echoes == 18
        np.testing.assert_allclose(found[0].ends, [(62.0, apart_in), (0.0, apart_in)])


def test_short_wall_at_an_angle_is_not_one_with_a_long_one() -> None:
    slanted = np.array((-np.sin(radians(10.0)), np.cos(radians(10.0))))
    lines = [line_at(Y, 0.0), walls._Line(slanted, np.array((slanted[1], -slanted[0])), 0.0, np.zeros(0), np.zeros(0))]
    pieces = [piece_on(lines[0], 0, -30.0, 40.0), piece_on(lines[1], 1, -2.0, 60.0, -2.0, 2.7)]
    assert len(walls._without_doubled(pieces, lines)[0]) == 2


def test_only_walls_that_are_written_are_without_doubled_ones(
    estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot that drives needs the runs of each wall of the map."""
    calls = []

    def counted(pieces: list[walls.Piece], lines: list[walls._Line]) -> tuple[list[walls.Piece], list[walls._Line]]:
        calls.append(len(pieces))
        return pieces, lines

    monkeypatch.setattr(walls, "_without_doubled", counted)
    extract_walls(estimate, with_accuracy=False)
    assert calls == []
    extract_walls(estimate)
    assert calls == [4]


@pytest.mark.parametrize(("gap_in", "aside_in", "crossed", "is_closed"), [
    (3.6, 0.1, (), True), (3.6, 1.0, (), True), (3.6, 3.0, (), False), (9.0, 0.1, (), False),
    (3.6, 0.1, (1.5, 2.0, 2.1), False),
])  # fmt: skip
def test_a_wall_goes_on_behind_the_end_of_a_thick_one(
    gap_in: float, aside_in: float, crossed: Sequence[float], is_closed: bool
) -> None:
    """Two parts of an outer wall end at the faces of an inner one."""
    lines = [line_at(Y, 0.0, crossed), line_at(Y, aside_in), line_at(X, 0.0), line_at(X, gap_in)]
    ends = [(-50.0, -2.0), (gap_in + 2.0, 50.0), (7.0, 60.0), (7.0, 60.0)]
    pieces = [piece_on(line, wall, *own) for wall, (line, own) in enumerate(zip(lines, ends, strict=True))]
    left, right, *_ = found = with_ends(pieces, lines)
    np.testing.assert_allclose(left.ends[1], (gap_in if is_closed else 0.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(right.ends[0], (gap_in, aside_in), atol=1e-9)
    if is_closed:
        # The other end of the thick wall is open.
        assert [finding for finding in check(found) if finding.place_in[1] < 30.0] == []


@pytest.mark.parametrize("order", [(1, 2), (2, 1)])
def test_an_end_reaches_the_nearest_of_two_walls(order: Sequence[int]) -> None:
    lines = [line_at(Y, 0.0), line_at(X, 0.0), line_at(X, 2.9)]
    pieces = [piece_on(lines[0], 0, -40.0, -1.0), *(piece_on(lines[row], row, -30.0, 30.0) for row in order)]
    walls._close_small_gaps(pieces, 3.5)
    np.testing.assert_allclose(pieces[0].ends[1], (0.0, 0.0), atol=1e-9)


def test_walls_of_no_length_close_no_gap() -> None:
    lines = [line_at(Y, 0.0), line_at(X, 0.0)]
    pieces = [piece_on(lines[0], 0, -40.0, -1.0), piece_on(lines[1], 1, 5.0, 5.0)]
    walls._close_small_gaps(pieces, 3.5)
    np.testing.assert_allclose(pieces[0].ends[1], (-1.0, 0.0))


def test_accuracy_of_parts_does_not_depend_on_their_order(estimate: MapEstimate) -> None:
    found = with_levels(estimate)
    weights, paths, levels = level_weights(found), free_paths(found), found.state.levels
    own = levels.of(2)
    low, high = LEVEL_CELL_IN * levels.cell[[own.start, own.stop - 1]] + (0.0, LEVEL_CELL_IN)
    middle = 0.5 * (low + high)
    whole = [(wall, *found.extents[wall].tolist()) for wall in (0, 1, 3)]
    of_walls = [whole[0], whole[1], (2, float(low), float(middle)), (2, float(middle), float(high)), whole[2]]

    def accuracy(order: Sequence[int]) -> list[tuple[float, ...]]:
        rows = [of_walls[part] for part in order]
        lines = [walls._line(found, wall, weights, paths, (first, last)) for wall, first, last in rows]
        pieces = [
            walls.Piece(wall, first, last, np.array((line.at(first), line.at(last))), [False, False], 9)
            for (wall, first, last), line in zip(rows, lines, strict=True)
        ]
        pieces, lines = walls._with_ends(pieces, lines, found.state.points[:0], paths, 3.5)
        walls._add_accuracy(found, pieces, lines)
        return [(piece.std_in, piece.std_rad, *(std or 0.0 for std in piece.end_stds_in)) for piece in pieces]

    in_order = accuracy(range(5))
    assert min(stds[0] for stds in in_order) > 0.01
    assert sum(std > 0.0 for stds in in_order for std in stds[2:]) >= 4
    order = (3, 0, 4, 2, 1)
    np.testing.assert_allclose(accuracy(order), [in_order[part] for part in order], rtol=1e-6, atol=1e-9)


def test_covariance_of_lines_is_that_of_all_unknowns_propagated(estimate: MapEstimate) -> None:
    """Oracle: derivatives of the lines as difference quotients, C' = J C J'."""
    found, h = with_levels(estimate), 1e-6
    state, weights, paths = found.state, level_weights(found), free_paths(found)
    first, last = state.levels.of(1).start, state.levels.of(1).stop - 1
    low, high = LEVEL_CELL_IN * (state.levels.cell[[first, last]] + 0.5)
    parts = [(1, (low - 1.0, 0.5 * (low + high))), (0, walls.WHOLE), (1, (0.5 * (low + high), high + 1.0))]
    pieces = [walls.Piece(wall, 0.0, 9.0, np.zeros((2, 2)), [True, True], 9) for wall, _ in parts]
    lines = [walls._line(found, wall, weights, paths, part) for wall, part in parts]

    def quantities(changed: MapEstimate) -> Floats:
        ends = [surface_line(changed, wall, weights, part)[0] for wall, part in parts]
        return np.concatenate((*ends, changed.state.points.reshape(-1)))

    # Walls, points, parameters, levels.
    count = len(covariance_of(found))
    unknown = [np.eye(count)[row] for row in range(count)]
    J = np.stack([
        (quantities(moved(found, h * row)) - quantities(moved(found, -h * row))) / (2.0 * h) for row in unknown
    ], axis=1)  # fmt: skip
    expected = J @ covariance_of(found) @ J.T
    np.testing.assert_allclose(walls._covariance_of_lines(found, pieces, lines), expected, rtol=1e-5, atol=1e-9)
    # Both parts of a wall have levels of their own.
    assert lines[0].by_levels @ lines[2].by_levels < 0.5 * (lines[0].by_levels @ lines[0].by_levels)


def moved(estimate: MapEstimate, by: Floats) -> MapEstimate:
    """Return a map whose walls, points, parameters and levels are moved by a vector (m,)."""
    found, state = estimate.copy(), estimate.state
    steps = np.split(by, np.cumsum((state.walls.size, state.points.size, len(state.parameters))))
    found.state = replace(
        state, walls=state.walls + steps[0].reshape(-1, 2), points=state.points + steps[1].reshape(-1, 2),
        parameters=state.parameters + steps[2],
        levels=replace(state.levels, value_in=state.levels.value_in + steps[3]),
    )  # fmt: skip
    return found


def with_levels(estimate: MapEstimate) -> MapEstimate:
    """Return a map of the same drive whose walls have levels."""
    problem = estimate.problem
    reflection = Reflection(half_cone_rad=radians(25.0), surface_std_in=1.75, surface_length_in=24.0)
    found = estimate.copy()
    found.problem = MapProblem(problem.trajectory, 16, parameter_stds=PARAMETER_STDS, reflection=reflection)
    found.expects_first_echoes = False
    found.associate()
    return found


def test_echoes_from_beyond_an_end_are_of_the_end(opened: MapEstimate) -> None:
    found = with_levels(opened)
    line = np.array((-0.5 * np.pi, 25.0))
    found.add_wall(line, np.array((10.0, 36.0)))
    wall, west, east = len(found.state.walls) - 1, *(len(found.state.walls) + number for number in (4, 5))
    found.associate()
    echoes = found.echoes()
    residual, _, spots = residual_matrix(found.problem, found.state, found.extents, echoes)
    feature, feet = found.assignment.feature[echoes], spots[:, wall, 0]
    # Their ranges would fit the wall as well.
    fits = np.abs(residual[:, wall]) < 2.0
    for point, beyond_in in ((west, 10.0 - feet), (east, feet - 36.0)):
        of_end = (beyond_in > 0.0) & (beyond_in < 20.0) & (np.abs(residual[:, point]) < 2.0)
        assert (of_end & fits).sum() >= 3
        assert not (feature[of_end] == wall).any()
    within = (feet > 15.0) & (feet < 31.0) & fits
    assert (feature[within] == wall).sum() > 4


@pytest.mark.parametrize(("y_in", "is_measured"), [(-25.0, True), (-22.5, True), (-19.0, False)])
def test_surface_between_two_points_is_measured_by_sonars_that_face_it(
    opened: MapEstimate, y_in: float, is_measured: bool
) -> None:
    opened.state = replace(opened.state, points=np.array(((5.0, y_in), (51.0, y_in))))
    found = with_levels(opened)
    spans = {(span.one, span.other): span for span in uncrossed_spans(found, free_paths(found))}
    # Too long to be a wall by what is silent alone; 6 in before the wall there is nothing.
    assert spans.keys() == ({(0, 1)} if is_measured else set())
    assert all(span.is_measured and span.is_wall for span in spans.values())
    # Planes are told from points by their cost.
    opened.associate()
    planes = uncrossed_spans(opened, free_paths(opened))
    assert not any(span.is_measured or span.is_wall for span in planes)


@pytest.mark.parametrize(("first", "last", "cuts"), [
    ((-25.0, -17.0), (-13.0, -25.0), True),  # two posts, 8 and 12 in from the corner at (-25, -25)
    ((-25.0, -8.0), (-14.0, -25.0), True),  # the corner is 9 in behind the line
    ((-25.0, -9.0), (-3.0, -25.0), False),  # 13 in
    ((-25.0, -5.0), (15.0, -25.0), False),  # farther from the corner: sound would have come back from there
    ((-31.0, -18.0), (-18.0, -31.0), True),  # through the corner, from behind one wall to behind the other
    ((-17.0, -17.0), (-31.0, -31.0), False),  # out of the room
])  # fmt: skip
def test_what_leads_across_a_corner_is_no_wall(
    estimate: MapEstimate, first: tuple[float, float], last: tuple[float, float], cuts: bool
) -> None:
    ends = np.array([(*first, *last)])
    found = with_levels(estimate)
    assert spans.cut_corners(found, ends).tolist() == [cuts]
    # A wall that ends in the corner is none across it, and planes have no posts.
    assert not spans.cut_corners(found, np.array([(-25.0, -17.0, -25.0, -25.0)])).any()
    assert not spans.cut_corners(estimate, ends).any()
    # Of a wall that was measured from both sides no place is behind.
    inner = replace(found, sides=np.zeros(4))
    assert spans.cut_corners(inner, ends).tolist() == [cuts and abs(first[0] + 25.0) < 1.0]
    # Nor one from a wall that is shorter, such as a reveal.
    short = found.copy()
    short.extents = np.minimum(short.extents, short.extents[:, :1] + 10.0)
    assert not spans.cut_corners(short, ends).any()
    # Such a wall is dropped, but not where walls are planes.
    (x1, y1, x2, y2), = ends
    angle = float(np.arctan2(x1 - x2, y2 - y1))
    line = np.array((angle, x1 * np.cos(angle) + y1 * np.sin(angle)))
    extent = np.sort(ends.reshape(2, 2) @ np.array((-np.sin(angle), np.cos(angle))))
    for made, drops in ((with_levels(estimate), cuts), (estimate.copy(), False)):
        count = len(made.state.walls)
        made.add_wall(line, extent)
        assert drop_corner_cuts(made) == int(drops)
        assert len(made.state.walls) == count + int(not drops)


def test_a_path_along_a_span_does_not_open_it(opened: MapEstimate) -> None:
    def pairs(starts: Sequence[Sequence[float]], ends: Sequence[Sequence[float]]) -> list[set[int]]:
        return [{span.one, span.other} for span in uncrossed_spans(opened, (np.array(starts), np.array(ends)))]

    # It leads along the line within 8 degrees, and crosses it by a small error of either end.
    along = ((60.0, -22.0), (60.0, -23.0)), ((12.0, -28.0), (12.0, -28.0))
    assert {4, 5} in pairs(*along)
    steep = ((40.0, -20.0), (40.0, -21.0)), ((14.0, -28.0), (14.0, -29.0))
    assert {4, 5} not in pairs(*steep)


@pytest.mark.parametrize(("turn_deg", "turned"), [(4.0, 1), (0.5, 0), (20.0, 0)])
def test_walls_with_levels_turn_to_the_axes_where_that_costs_hardly_more(
    estimate: MapEstimate, turn_deg: float, turned: int
) -> None:
    """A wall of a square room, turned with levels that make up for it; 0.5 degrees are left to the optimizer."""
    found = with_levels(estimate)
    found.optimize(3)
    slanted = revision._turned_wall(found, 1, radians(turn_deg))
    # The surface stays where it is: as far from the turned line as its levels say.
    own = slanted.state.levels.of(1)
    (angle, offset), (turned_rad, turned_offset) = found.state.walls[1], slanted.state.walls[1]
    t = LEVEL_CELL_IN * (found.state.levels.cell[own] + 0.5)
    n, u = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
    places = (offset + found.state.levels.value_in[own])[:, None] * n + t[:, None] * u
    off_line = places @ (np.cos(turned_rad), np.sin(turned_rad)) - turned_offset
    np.testing.assert_allclose(slanted.state.levels.value_in[own], off_line)
    assert revision.square(slanted) == turned
    off = np.degrees(wrap_angle(4.0 * (slanted.state.walls[1, 0] - slanted.state.walls[0, 0])) / 4.0)
    assert (abs(off) < 0.5) == (turned == 1 or turn_deg < 1.0)
    # Planes have no levels that could make up for it.
    assert revision.square(estimate) == 0


def test_a_slope_that_saves_little_is_no_slope(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    found = with_levels(estimate)
    found.optimize(3)
    # How much more the map costs after a turn by 1 degree, with levels that make up for it.
    turned = found.copy()
    assert revision._try_turn(turned, 1, radians(1.0), allowed=np.inf)
    more = turned.cost - found.cost
    assert not revision._try_turn(found.copy(), 1, radians(1.0), allowed=more - 0.1)
    assert revision._try_turn(found.copy(), 1, radians(1.0), allowed=more + 0.1)
    # Of short walls off the axes so much is allowed; each is turned by the angle that it is off.
    tried: list[tuple[int, float, float]] = []

    def keep(_: MapEstimate, wall: int, by_rad: float, allowed: float) -> bool:
        tried.append((wall, by_rad, allowed))
        return True

    monkeypatch.setattr(revision, "_try_turn", keep)
    monkeypatch.setattr(revision, "_off_axes", lambda _: np.radians((0.0, 5.0, -14.0, 21.0)))
    assert revision.square(found) == 2
    assert tried == [(1, -radians(5.0), 0.0), (2, radians(14.0), 0.0)]
    found.extents = found.extents.copy()
    found.extents[2] = 3.0, 42.9
    assert revision.square(found) == 2
    assert tried[2:] == [(1, -radians(5.0), 0.0), (2, radians(14.0), MIN_DIFFERENCE)]


@pytest.mark.parametrize("turn_deg", [-4.0, 3.0])
def test_walls_with_levels_turn_to_the_direction_of_their_stretches(estimate: MapEstimate, turn_deg: float) -> None:
    """Oracle: the direction that a wall of a square room had before it was turned, its levels with it."""
    found = with_levels(estimate)
    found.optimize(3)
    # A map that has settled stays as it is.
    while revision.turn_walls(found):
        pass
    slanted = revision._turned_wall(found, 1, radians(turn_deg))
    middle = float(slanted.extents[1].mean())
    costs = costs_of_turns(slanted.problem, slanted.state, slanted.assignment, 1, middle, revision.TURNS_RAD)
    assert np.degrees(revision.TURNS_RAD[costs.argmin()]) == pytest.approx(-turn_deg, abs=0.5)
    before = slanted.cost
    assert revision.turn_walls(slanted) == 1
    assert slanted.cost < before
    off = np.degrees(wrap_angle(4.0 * (slanted.state.walls[1, 0] - slanted.state.walls[0, 0])) / 4.0)
    assert abs(off) < 0.5
    # Planes have no levels.
    assert revision.turn_walls(estimate) == 0


@pytest.mark.parametrize("turn_deg", [-0.9, 0.6])
def test_square_walls_turn_together_to_the_direction_of_their_surfaces(estimate: MapEstimate, turn_deg: float) -> None:
    """Oracle: straight lines by numpy through the surfaces of a room whose true walls are planes."""
    found = with_levels(estimate)
    found.optimize(3)

    def slopes_deg(of: MapEstimate) -> Floats:
        levels = of.state.levels
        weights = np.sqrt(of.problem.level_information(levels, of.assignment))
        slopes = [
            np.polyfit(LEVEL_CELL_IN * levels.cell[own], levels.value_in[own], 1, w=weights[own])[0]
            for own in (levels.of(wall) for wall in range(len(of.state.walls)))
        ]
        return np.asarray(np.degrees(np.arctan(slopes)), dtype=np.float64)

    # All by one angle, and each by an angle of its own.
    turns_deg = turn_deg + np.array((0.3, -0.3, 0.3, -0.3)) - slopes_deg(found)
    for wall, by_deg in enumerate(turns_deg.tolist()):
        found = revision._turned_wall(found, wall, radians(by_deg))
    assert slopes_deg(found).mean() == pytest.approx(turn_deg, abs=0.02)
    revision.square_together(found)
    assert slopes_deg(found).mean() == pytest.approx(0.0, abs=0.1)
    off_axes = np.degrees(wrap_angle(4.0 * (found.state.walls[:, 0] - found.state.walls[0, 0]))) / 4.0
    np.testing.assert_allclose(off_axes, 0.0, atol=0.1)


def test_planes_and_a_single_wall_are_not_turned(estimate: MapEstimate) -> None:
    plane = estimate.copy()
    revision.square_together(plane)
    np.testing.assert_array_equal(plane.state.walls, estimate.state.walls)
    assert plane.problem is estimate.problem
    alone = with_levels(estimate)
    alone.optimize(3)
    while len(alone.state.walls) > 1:
        alone.remove(len(alone.state.walls) - 1)
    alone.associate()
    before = alone.state.walls.copy()
    revision.square_together(alone)
    np.testing.assert_array_equal(alone.state.walls, before)


@pytest.mark.parametrize("slant_deg", [3.0, 6.0])
def test_slanted_walls_stay_when_the_others_turn(slant_deg: float) -> None:
    """Oracle: the true angles between the walls of a room one of which is slanted."""
    outline = (*ROOM[:3], (0.0, 100.0 + 120.0 * tan(radians(slant_deg))))
    planes = learn_map(drive(1, outlines=(outline,)), OdometryNoise(0.05, 0.05, 0.002), ConeSonar())
    found = with_levels(planes)
    found.optimize(3)
    assert len(found.state.walls) == 4
    revision.square_together(found)
    off = np.degrees(wrap_angle(4.0 * (found.state.walls[:, 0] - found.state.walls[0, 0])) / 4.0)
    slanted = np.abs(off) > 1.0
    assert np.abs(off[~slanted]).max() < 0.15
    # Seen from any of the walls, the slanted one among them.
    assert sorted(np.round(np.abs(off[slanted]) / slant_deg).tolist()) in ([1.0], [1.0] * 3)
    np.testing.assert_allclose(np.abs(off[slanted]), slant_deg, atol=0.7)


def test_a_wall_turns_about_its_middle_wherever_the_origin_is(estimate: MapEstimate) -> None:
    """Oracle: ends and spots of the surface in the plane, of a map that was shifted by 300 in."""
    found, shift = with_levels(estimate), np.array((300.0, -200.0))
    state = found.state
    normals = np.stack((np.cos(state.walls[:, 0]), np.sin(state.walls[:, 0])), axis=-1)
    moved = np.column_stack((state.walls[:, 0], state.walls[:, 1] + normals @ shift))
    found.state = replace(state, walls=moved)
    by_rad = radians(4.0)
    turned = revision._turned_wall(found, 1, by_rad)

    def surface(of: MapEstimate) -> tuple[Floats, Floats]:
        (angle, offset), levels = of.state.walls[1], of.state.levels
        own = levels.of(1)
        n, u = np.array((np.cos(angle), np.sin(angle))), np.array((-np.sin(angle), np.cos(angle)))
        t = LEVEL_CELL_IN * (levels.cell[own] + 0.5)
        return segments_of(of.state.walls, of.extents)[1], (offset + levels.value_in[own])[:, None] * n + t[:, None] * u

    (ends, spots), (turned_ends, turned_spots) = surface(found), surface(turned)
    middle, half = ends.reshape(2, 2).mean(axis=0), 0.5 * (ends[2:] - ends[:2])
    c, s = np.cos(by_rad), np.sin(by_rad)
    after = np.array((c * half[0] - s * half[1], s * half[0] + c * half[1]))
    np.testing.assert_allclose(turned_ends, np.concatenate((middle - after, middle + after)))
    # Along the wall to half a cell, since cells are counted from the foot of the origin.
    off = turned_spots - spots
    along = after / np.hypot(*after)
    assert np.abs(off @ along).max() <= 0.5 * LEVEL_CELL_IN + 0.5
    np.testing.assert_allclose(off @ (-along[1], along[0]), 0.0, atol=1e-9)


def test_posts_stay_on_a_wall_with_levels(opened: MapEstimate) -> None:
    for made, left in ((opened, 6), (with_levels(opened), 7)):
        made.add_point(np.array((23.0, -24.0)))
        line, extent = np.array((-0.5 * np.pi, 25.0)), np.array((10.0, 36.0))
        assert len(revision._with_wall(made, line, extent).state.points) == left
    # What the wall explains as well is tried without them.
    assert len(revision._with_wall(made, line, extent, 5.0).state.points) == 6
    assert len(revision._with_wall(made, line, extent, 0.5).state.points) == 7


def test_spots_at_posts_on_a_surface_fill_gaps(estimate: MapEstimate, monkeypatch: pytest.MonkeyPatch) -> None:
    """Posts along a part of the wall at y = -25 explain its echoes as well: of a plane those are theirs."""
    south = int(np.abs(np.sin(estimate.state.walls[:, 0]) * estimate.state.walls[:, 1] + 25.0).argmin())
    monkeypatch.setattr(walls, "uncrossed_spans", lambda *_: [])
    posts = [(x, -25.0) for x in range(15, 55, 5)]
    for made, parts in ((estimate.copy(), 2), (with_levels(estimate), 1)):
        made.state = replace(made.state, points=np.concatenate((made.state.points, posts)))
        assert sum(piece.wall == south for piece in extract_walls(made)) == parts


@pytest.mark.parametrize(
    ("posts_x", "others_x", "runs"),
    [
        # Clear feet from 20 to 30 and from 60 to 70 in, and posts 15 in apart or none.
        ((15.0, 30.0, 45.0, 60.0, 75.0), np.arange(0.0, 100.0, 5.0), [(20.0, 70.0)]),
        ((15.0, 30.0, 45.0, 60.0, 75.0), (33.0, 36.0, 39.0), [(20.0, 30.0), (60.0, 70.0)]),
        ((15.0, 75.0), np.arange(0.0, 100.0, 5.0), [(20.0, 30.0), (60.0, 70.0)]),
        ((), np.arange(0.0, 100.0, 5.0), [(20.0, 30.0), (60.0, 70.0)]),
        ((90.0, 100.0, 110.0), np.arange(90.0, 110.0), [(20.0, 30.0), (60.0, 70.0)]),
    ],
)
def test_spots_at_posts_fill_gaps_between_these_and_end_no_wall(
    posts_x: Sequence[float], others_x: Sequence[float], runs: list[tuple[float, float]]
) -> None:
    line = walls._Line(np.array((0.0, 1.0)), np.array((1.0, 0.0)), 0.0, np.zeros(0), crossed=np.zeros(0))
    clear = np.concatenate((np.arange(20.0, 31.0), np.arange(60.0, 71.0)))
    feet = np.concatenate((clear, others_x))
    order = np.argsort(feet, kind="stable")
    posts = np.array([(x, 0.0) for x in posts_x]).reshape(-1, 2)
    found = walls._pieces(line, feet[order], (np.arange(len(feet)) < len(clear))[order], posts)
    assert [run[:2] for run in found] == runs


def test_parts_of_a_surface_with_a_gap_are_walls_of_their_own(estimate: MapEstimate) -> None:
    low, high = estimate.extents[0]
    parts = np.array([(0.0, low, low + 30.0), (0.0, high - 30.0, high)])
    for made, count in ((estimate.copy(), 4), (with_levels(estimate), 5)):
        made.runs = np.concatenate((made.runs[made.runs[:, 0] != 0.0], parts))
        split_surfaces(made)
        assert len(made.state.walls) == count


def test_measured_part_of_a_wall_between_two_points_is_where_spots_are(
    opened: MapEstimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert join_points(opened) == 1
    span = Span(0, 1, np.array((-20.0, -25.0, 90.0, -25.0)), stopped=0, is_measured=True)
    monkeypatch.setattr(walls, "uncrossed_spans", lambda *_: [span])
    (wall,) = (piece for piece in extract_walls(opened) if np.abs(piece.ends[:, 1] + 25.0).max() < 1.0)
    assert wall.spots is not None
    assert wall.low < wall.spots[0] < wall.spots[1] < wall.high
    first, last = np.sort(wall.measured_ends[:, 0])
    assert np.sort(wall.ends[:, 0])[0] < first < last < np.sort(wall.ends[:, 0])[1]
    assert last - first == pytest.approx(wall.spots[1] - wall.spots[0], abs=0.01)


# Ends of thick walls.

CORNERS = ((0.0, 100.0), (5.0, 100.3))
NOTHING = np.zeros((0, 2)), np.zeros((0, 2))


def thick_wall(
    like: MapEstimate, turn: float, points: Sequence[tuple[float, float]], sides: tuple[float, float] = (-1.0, 1.0)
) -> MapEstimate:
    """Return a map of the faces x = 0 and x = 5 from y = 0 to 100, measured from outside, and points, all turned."""
    made = like.copy()
    places = rotate(np.array(points).reshape(-1, 2), np.full(len(points), turn))
    # The robot was far away.
    far = like.state.poses + np.array((1000.0, 0.0, 0.0))
    made.state = replace(like.state, poses=far, walls=np.array([(turn, 0.0), (turn, 5.0)]), points=places)
    made.extents, made.sides = np.array([(0.0, 98.0), (0.0, 97.0)]), np.array(sides)
    made.runs = np.array([(0.0, 0.0, 98.0), (1.0, 0.0, 97.0)])
    return made


@pytest.mark.parametrize("turn", [0.0, 1.0, -2.5])
def test_a_thick_wall_ends_where_both_faces_do(estimate: MapEstimate, turn: float) -> None:
    (span,) = find_wall_ends(thick_wall(estimate, turn, CORNERS), NOTHING)
    assert {span.one, span.other} == {0, 1}
    np.testing.assert_allclose(rotate(span.ends.reshape(2, 2), np.full(2, -turn)), CORNERS, atol=1e-9)
    # The other ends of the faces are not known.
    both = [*CORNERS, (0.0, 0.5), (5.0, -0.5)]
    assert {(span.one, span.other) for span in find_wall_ends(thick_wall(estimate, turn, both), NOTHING)} == {
        (0, 1), (2, 3)}  # fmt: skip
    # Of a corner that is two points the squarest end counts.
    (span,) = find_wall_ends(thick_wall(estimate, turn, [(0.0, 101.2), (0.2, 100.2), CORNERS[1]]), NOTHING)
    assert {span.one, span.other} == {1, 2}


@pytest.mark.parametrize(("points", "sides"), [
    (((0.0, 100.0), (5.0, 104.0)), (-1.0, 1.0)),  # not opposite one another
    (((0.0, 50.0), (5.0, 50.0)), (-1.0, 1.0)),  # on the faces
    (((0.0, 100.0), (16.0, 100.0)), (-1.0, 1.0)),  # too far apart
    (CORNERS, (1.0, -1.0)),  # a slit of 5 in
    (CORNERS, (-1.0, 0.0)),  # measured from both sides: no face
    (CORNERS, (-1.0, -1.0)),  # one wall, 5 in behind another
])  # fmt: skip
def test_what_is_no_end_of_a_thick_wall(
    estimate: MapEstimate, points: tuple[tuple[float, float], ...], sides: tuple[float, float]
) -> None:
    assert find_wall_ends(thick_wall(estimate, 0.7, points, sides), NOTHING) == []


def test_faces_on_opposite_sides_of_a_door_have_no_common_end(estimate: MapEstimate) -> None:
    # The one face ends at y = 100, and the other one begins there.
    made = thick_wall(estimate, 0.0, CORNERS)
    made.extents, made.runs = np.array([(0.0, 98.0), (102.0, 200.0)]), np.array([(0.0, 0.0, 98.0), (1.0, 102.0, 200.0)])
    assert find_wall_ends(made, NOTHING) == []


def test_nothing_ends_at_a_junction_or_where_sound_has_passed(estimate: MapEstimate) -> None:
    made = thick_wall(estimate, 0.0, CORNERS)
    # 1. Two paths between the corners; one may be a mistake.
    starts, ends = np.array([(2.0, 120.0), (3.0, 120.0)]), np.array([(2.0, 90.0), (3.0, 90.0)])
    assert find_wall_ends(made, (starts, ends)) == []
    assert len(find_wall_ends(made, (starts[:1], ends[:1]))) == 1
    assert len(find_wall_ends(made, (starts - (2.0, 0.0), ends - (2.0, 0.0)))) == 1
    # One of the robot is none.
    driven = replace(made.state, poses=np.column_stack((np.concatenate((starts[:1], ends[:1])), np.zeros(2))))
    assert find_wall_ends(replace(made, state=driven), NOTHING) == []
    # 2. The wall y = 100, which goes on beyond the corner: the faces meet it.
    made.add_wall(np.array((np.pi / 2.0, 100.1)), np.array((-60.0, -5.0)), -1.0)
    assert find_wall_ends(made, NOTHING) == []
    # One that was measured between the corners alone is the end itself.
    made.narrow(2, np.array((-5.0, 0.0)))
    assert len(find_wall_ends(made, NOTHING)) == 1
    # One that is far away on the same line is another wall.
    made.narrow(2, np.array((-400.0, -300.0)))
    assert len(find_wall_ends(made, NOTHING)) == 1


def test_ends_of_thick_walls_are_walls_of_the_map(estimate: MapEstimate) -> None:
    # Beside the room of the map, so that nothing else changes.
    made, first = estimate.copy(), len(estimate.state.walls)
    points = len(made.state.points)
    for x, side in ((-100.0, -1.0), (-95.0, 1.0)):
        made.add_wall(np.array((0.0, x)), np.array((0.0, 60.0)), side)
        made.add_point(np.array((x, 60.0)))
    assert close_wall_ends(made) == 1
    assert len(made.state.walls) == first + 3
    assert {(points, first + 2), (points + 1, first + 2)} <= set(map(tuple, made.assignment.ties.tolist()))
    np.testing.assert_allclose(np.abs(np.sin(made.state.walls[-1, 0])), 1.0, rtol=1e-4)
    pieces = [piece for piece in extract_walls(made, with_accuracy=False) if piece.wall == first + 2]
    corners = made.state.points[points:]
    np.testing.assert_allclose([np.sort(piece.ends, axis=0) for piece in pieces], [corners], atol=0.05)
    angle = made.state.walls[-1, 0]
    np.testing.assert_allclose(made.extents[-1], np.sort(corners @ (-np.sin(angle), np.cos(angle))), atol=0.01)
    # Once is enough.
    assert close_wall_ends(made) == 0


def test_ends_of_thick_walls_leave_nothing_undecided(estimate: MapEstimate) -> None:
    # An end of 10 in that is 6 in beside a wall of the room: without it nothing costs more.
    made = estimate.copy()
    assert find_undecided(made) == []
    x = min(float(wall.ends[:, 0].max()) for wall in extract_walls(made, with_accuracy=False)) - 6.0
    for y, side in ((20.0, -1.0), (30.0, 1.0)):
        made.add_wall(np.array((np.pi / 2.0, y)), np.array((-x, 60.0 - x)), side)
        made.add_point(np.array((x, y)))
    assert close_wall_ends(made) == 1
    assert find_undecided(made) == []
