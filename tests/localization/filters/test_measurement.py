"""What a sonar would read, against the ray caster, which shares no formula with it, and central differences."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.belief import Floats
from localization.filters.odometry import move
from localization.filters.sonar_ray import (
    WIRE_SONAR,
    Beams,
    RaySonar,
    WallMap,
    fired_at,
    left_of,
    meet,
    pick,
    range_jacobian,
    rays,
    ring,
    sight,
    wall_map,
)
from worlds.io import load_world
from worlds.raycast import cast_rays
from worlds.robots import N150

WALLS = wall_map(load_world("several_walls").walls)


def cast_readings(poses: Floats, beams: Beams, walls: WallMap) -> tuple[Floats, Floats]:
    """Readings and walls met from poses (..., 1, 3), by the ray caster alone."""
    aimed = rays(poses, beams)
    ranges, met = cast_rays(aimed.axes_in, aimed.directions, walls.segments)
    return ranges - beams.standoff_in, met.astype(np.float64)


def some_poses(count: int) -> Floats:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(0, 90, count), rng.uniform(0, 90, count), rng.uniform(-3, 3, count)])


def odd_beams() -> Beams:
    """A ring on a turned turret, each sonar fired from somewhere else."""
    rng = np.random.default_rng(4)
    return fired_at(ring(N150, turret_offset_rad=0.8), rng.normal(scale=(1.0, 0.5, 0.2), size=(16, 3)))


@pytest.mark.parametrize("beams", [ring(N150), ring(N150, 0.3), odd_beams()], ids=["ring", "turret", "fired apart"])
def test_ranges_are_those_of_the_ray_caster(beams: Beams) -> None:
    poses = some_poses(200)[:, None, :]
    readings, met = cast_readings(poses, beams, WALLS)
    aimed = rays(poses, beams)
    walls = meet(aimed, WALLS)
    assert walls.tolist() == met.tolist()
    assert sight(aimed, WALLS.lines[walls]).ranges_in == pytest.approx(readings, abs=1e-6)


@pytest.mark.parametrize("beams", [ring(N150), ring(N150, 0.3), odd_beams()], ids=["ring", "turret", "fired apart"])
def test_the_jacobian_is_that_of_central_differences_of_the_ray_caster(beams: Beams) -> None:
    poses = some_poses(200)[:, None, :]
    aimed = rays(poses, beams)
    walls = meet(aimed, WALLS)
    seen = sight(aimed, WALLS.lines[walls])
    jacobian = range_jacobian(seen, WALLS.lines[walls])
    width = 1e-5
    for column, unit in enumerate(np.eye(3)):
        ahead, ahead_met = cast_readings(poses + width * unit, beams, WALLS)
        behind, behind_met = cast_readings(poses - width * unit, beams, WALLS)
        same = (ahead_met == walls) & (behind_met == walls) & (np.abs(seen.cos_incidence) > 0.1)
        assert same.mean() > 0.9
        assert jacobian[..., column][same] == pytest.approx((ahead - behind)[same] / (2 * width), rel=1e-5, abs=1e-4)


def test_straight_at_a_wall() -> None:
    walls = wall_map([[20.0, -50.0, 20.0, 50.0]])
    beams = pick(ring(N150), 0)
    aimed = rays(np.array([[0.0, 0.0, 0.0]]), beams)
    seen = sight(aimed, walls.lines[meet(aimed, walls)])
    assert seen.ranges_in == pytest.approx([20.0 - 9.06])
    assert abs(seen.cos_incidence) == pytest.approx([1.0])
    assert range_jacobian(seen, walls.lines[meet(aimed, walls)]) == pytest.approx(np.array([[-1.0, 0.0, 0.0]]))


def test_a_wall_within_the_ring_is_still_the_first() -> None:
    walls = wall_map([[5.0, -50.0, 5.0, 50.0], [20.0, -50.0, 20.0, 50.0]])
    aimed = rays(np.array([[0.0, 0.0, 0.0]]), pick(ring(N150), 0))
    assert meet(aimed, walls).tolist() == [0]
    assert sight(aimed, walls.lines[[0]]).ranges_in == pytest.approx([5.0 - 9.06])


def test_a_beam_beside_a_line_has_no_range() -> None:
    walls = wall_map([[0.0, 5.0, 50.0, 5.0]])
    aimed = rays(np.array([[0.0, 0.0, 0.0]]), pick(ring(N150), 0))
    seen = sight(aimed, walls.lines[:1])
    assert np.isnan([seen.ranges_in[0], seen.cos_incidence[0]]).all()
    assert np.isnan(range_jacobian(seen, walls.lines[:1])).all()
    assert meet(aimed, walls).tolist() == [-1]
    assert np.isnan(sight(aimed, walls.lines[[-1]]).ranges_in).all()


def test_a_turned_turret_turns_the_sonars_not_the_robot() -> None:
    """Sonar 4 stands at 90 degrees; with the turret 90 degrees to the right of the steering it looks ahead."""
    beams = pick(ring(N150, turret_offset_rad=-math.pi / 2), [4, 0])
    aimed = rays(np.array([[1.0, 2.0, 0.5]]), beams)
    assert aimed.directions[0] == pytest.approx([math.cos(0.5), math.sin(0.5)])
    assert aimed.directions[1] == pytest.approx([math.sin(0.5), -math.cos(0.5)])
    assert aimed.axes_in == pytest.approx(np.array([[1.0, 2.0], [1.0, 2.0]]))


def test_a_beam_fired_a_moment_ago_stands_where_it_was_fired() -> None:
    past = np.array([10.0, 20.0, 0.5])
    present = move(move(past, np.array([2.0, 0.3])), np.array([1.0, -0.8]))
    cos, sin = math.cos(present[2]), math.sin(present[2])
    shift = past - present
    back = np.array([cos * shift[0] + sin * shift[1], -sin * shift[0] + cos * shift[1], shift[2]])
    then = rays(past[None], ring(N150))
    now = rays(present[None], fired_at(ring(N150), back))
    assert now.directions == pytest.approx(then.directions)
    assert now.axes_in == pytest.approx(np.broadcast_to(then.axes_in, (16, 2)))
    assert now.arms_in == pytest.approx(np.tile((past - present)[:2], (16, 1)))


def test_each_beam_may_have_its_own_pose() -> None:
    poses = some_poses(3)
    together = rays(poses, pick(ring(N150), [1, 5, 9]))
    for row, number in enumerate([1, 5, 9]):
        alone = rays(poses[row, None], pick(ring(N150), number))
        assert together.directions[row] == pytest.approx(alone.directions[0])
        assert together.axes_in[row] == pytest.approx(alone.axes_in[0])


def test_left_is_a_quarter_turn() -> None:
    assert left_of(np.array([[1.0, 0.0], [0.0, 1.0]])).tolist() == [[0.0, 1.0], [-1.0, 0.0]]


def test_lines_hold_both_ends_of_their_walls() -> None:
    ends = WALLS.segments.reshape(-1, 2, 2)
    offsets = (ends * WALLS.lines[:-1, None, :2]).sum(axis=-1)
    assert offsets == pytest.approx(np.repeat(WALLS.lines[:-1, 2:], 2, axis=1))
    assert np.hypot(*WALLS.lines[:-1, :2].T) == pytest.approx(np.ones(len(ends)))
    assert WALLS.lines[-1].tolist() == [0.0, 0.0, 0.0]


def test_a_world_without_walls_is_met_nowhere() -> None:
    empty = wall_map(np.empty((0, 4)))
    assert meet(rays(np.zeros((1, 3)), ring(N150)), empty).tolist() == [-1] * 16


def test_a_wall_without_length_is_refused_by_its_number() -> None:
    with pytest.raises(ValueError, match=r"wall 1 has no length"):
        wall_map([[0.0, 0.0, 1.0, 0.0], [2.0, 3.0, 2.0, 3.0]])


def test_the_variance_of_a_reading() -> None:
    ranges = np.array([2.0, 5.0, 100.0])
    assert RaySonar().variance(ranges) == pytest.approx([0.0025, 0.0025, 1.0])
    assert WIRE_SONAR.variance(ranges) == pytest.approx(np.array([0.0025, 0.0025, 1.0]) + 1 / 12)
