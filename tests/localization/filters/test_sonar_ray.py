"""The ray model against the ray caster, central differences, and a search over the whole ellipsoid of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, independent, unpack
from localization.filters.sonar_ray import (
    IDEAL_SONAR,
    STRICT,
    WIRE_SONAR,
    Gate,
    Observation,
    RayModel,
    RaySonar,
    WallMap,
    intersect_line,
    line_of,
    observe_ring,
    predict_beam,
    predicted_variance,
    range_variance,
    ranges_from,
    wall_map,
)
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.raycast import NO_WALL
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

ROOM = wall_map(load_world("thesis_room").walls)
WALLS = wall_map(load_world("several_walls").walls)
OPEN = wall_map([[30.0, -40.0, 30.0, 40.0]])
ANGLES = np.array(N150.sonar_angles_rad)
AHEAD = ANGLES[:1]


# The expected range.


def cast_readings(poses: Floats, angles: Floats, walls: WallMap) -> tuple[Floats, Floats]:
    """Return readings and rows of walls from poses (..., 3) by the ray caster alone."""
    direction = poses[..., 2, None] + angles
    along = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    ranges, rows = cast_rays(poses[..., None, :2], along, walls.segments)
    return ranges - N150.sonar_ring_radius_in, rows.astype(np.float64)


def some_poses(count: int) -> Floats:
    rng = np.random.default_rng(3)
    return np.column_stack([rng.uniform(0, 90, count), rng.uniform(0, 90, count), rng.uniform(-3, 3, count)])


@pytest.mark.long
@pytest.mark.parametrize("turret_rad", [0.0, 0.3, 0.8])
def test_ranges_are_those_of_the_ray_caster(turret_rad: float) -> None:
    poses = some_poses(200)
    readings, rows = cast_readings(poses, ANGLES + turret_rad, WALLS)
    beams = ranges_from(poses, ANGLES + turret_rad, N150, WALLS)
    assert beams.row.tolist() == rows.tolist()
    assert beams.range_in == pytest.approx(readings, abs=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("turret_rad", [0.0, 0.3, 0.8])
def test_the_derivative_is_that_of_central_differences(turret_rad: float) -> None:
    poses, angles, width = some_poses(200), ANGLES + turret_rad, 1e-5
    beams = ranges_from(poses, angles, N150, WALLS)
    for column, unit in enumerate(np.eye(3)):
        ahead, ahead_row = cast_readings(poses + width * unit, angles, WALLS)
        behind, behind_row = cast_readings(poses - width * unit, angles, WALLS)
        normals = WALLS.lines[beams.row, :2]
        direction = poses[:, 2, None] + angles
        # At flat angles the range changes too fast for differences of this width.
        steep = np.abs(normals[..., 0] * np.cos(direction) + normals[..., 1] * np.sin(direction)) > 0.1
        # Only rays that hit the same wall at both poses have a derivative.
        same = (ahead_row == beams.row) & (behind_row == beams.row) & steep
        assert same.mean() > 0.9
        assert beams.H[column][same] == pytest.approx((ahead - behind)[same] / (2 * width), rel=1e-5, abs=1e-4)


def test_straight_at_a_wall() -> None:
    walls = wall_map([[20.0, -50.0, 20.0, 50.0]])
    beams = ranges_from(np.zeros(3), AHEAD, N150, walls)
    assert beams.range_in == pytest.approx([20.0 - 9.06])
    assert np.stack(beams.H, axis=-1) == pytest.approx(np.array([[-1.0, 0.0, 0.0]]))
    _, _, cosine = intersect_line(0.0, 0.0, 1.0, 0.0, line_of(0, walls))
    assert abs(cosine) == pytest.approx(1.0)


def test_a_wall_within_the_ring_is_still_the_first() -> None:
    walls = wall_map([[5.0, -50.0, 5.0, 50.0], [20.0, -50.0, 20.0, 50.0]])
    beams = ranges_from(np.zeros(3), AHEAD, N150, walls)
    assert beams.row.tolist() == [0]
    assert beams.range_in == pytest.approx([5.0 - 9.06])


def test_a_ray_parallel_to_a_line_has_no_range() -> None:
    walls = wall_map([[0.0, 5.0, 50.0, 5.0]])
    distance, H, cosine = intersect_line(0.0, 0.0, 1.0, 0.0, line_of(0, walls))
    assert np.isnan([distance, *H, cosine]).all()
    beams = ranges_from(np.zeros(3), AHEAD, N150, walls)
    assert beams.row.tolist() == [NO_WALL]
    assert np.isnan(beams.range_in).all()


def test_a_turned_turret_turns_the_sonars_not_the_robot() -> None:
    """Sonar 4 stands at 90 degrees; with the turret 90 degrees to the right of the steering it looks ahead."""
    pose = np.array([40.0, 45.0, 0.5])
    turned = ranges_from(pose, ANGLES[[4, 0]] - math.pi / 2, N150, WALLS)
    assert turned.range_in == pytest.approx(ranges_from(pose, np.array([0.0, -math.pi / 2]), N150, WALLS).range_in)


def test_lines_hold_both_ends_of_their_walls() -> None:
    ends = WALLS.segments.reshape(-1, 2, 2)
    offsets = (ends * WALLS.lines[:-1, None, :2]).sum(axis=-1)
    assert offsets == pytest.approx(np.repeat(WALLS.lines[:-1, 2:], 2, axis=1))
    assert np.hypot(*WALLS.lines[:-1, :2].T) == pytest.approx(np.ones(len(ends)))
    assert WALLS.lines[-1].tolist() == [0.0, 0.0, 0.0]


def test_a_world_without_walls_is_met_nowhere() -> None:
    beams = ranges_from(np.zeros(3), ANGLES, N150, wall_map(np.empty((0, 4))))
    assert beams.row.tolist() == [NO_WALL] * 16
    assert (beams.refusal == Refusal.NO_WALL).all()


def test_a_wall_without_length_is_refused_by_its_number() -> None:
    with pytest.raises(ValueError, match=r"wall 1"):
        wall_map([[0.0, 0.0, 1.0, 0.0], [2.0, 3.0, 2.0, 3.0]])


def test_the_variance_of_a_reading() -> None:
    ranges = np.array([2.0, 5.0, 100.0])
    assert RaySonar().variance(ranges) == pytest.approx([0.0025, 0.0025, 1.0])
    assert WIRE_SONAR.variance(ranges) == pytest.approx(np.array([0.0025, 0.0025, 1.0]) + 1 / 12 + 0.02)
    assert [range_variance(WIRE_SONAR, float(range_in)) for range_in in ranges] == WIRE_SONAR.variance(ranges).tolist()


# The gate.


def observe(
    belief: Belief, readings: Floats, angles: Floats = AHEAD, sonar: RaySonar = IDEAL_SONAR, gate: Gate = STRICT
) -> Observation:
    return observe_ring(belief, angles, readings, N150, ROOM, sonar, gate)


def only_reason(belief: Belief, reading: float, sonar: RaySonar = IDEAL_SONAR, gate: Gate = STRICT) -> Refusal:
    (reason,) = observe(belief, np.array([reading]), AHEAD, sonar, gate).reasons()
    return reason


def expected(belief: Belief, angles: Floats = AHEAD) -> Floats:
    return np.asarray(ranges_from(belief.mean, angles, N150, ROOM).range_in)


def facing(x: float, y: float, heading: float, std: tuple[float, float, float] = (0.1, 0.1, 0.01)) -> Belief:
    return independent((x, y, heading), std)


def test_consistent_beam_is_used_unchanged() -> None:
    belief = facing(40.0, 40.0, 0.1)
    range_in = expected(belief)
    seen = observe(belief, range_in + 0.2)
    assert seen.reasons() == (Refusal.NONE,)
    assert seen.innovation == pytest.approx([0.2])
    assert pytest.approx(np.maximum(0.01 * range_in, 0.05) ** 2) == seen.R
    far = 102.17 - 40.0
    assert seen.H[0] == pytest.approx([-1 / math.cos(0.1), 0.0, far * math.sin(0.1) / math.cos(0.1) ** 2])


@pytest.mark.parametrize("reading", [6.0, 5.0, 255.0, 300.0, float("nan"), float("inf")])
def test_a_limit_is_no_range(reading: float) -> None:
    assert only_reason(facing(40.0, 40.0, 0.0), reading, WIRE_SONAR) is Refusal.LIMIT


@pytest.mark.parametrize("reading", [6.5, 254.0])
def test_within_the_limits_the_gate_decides(reading: float) -> None:
    assert only_reason(facing(40.0, 40.0, 0.0), reading, WIRE_SONAR) is Refusal.GATE


def test_a_beam_without_a_wall_is_refused() -> None:
    assert only_reason(facing(200.0, 40.0, 0.0), 50.0) is Refusal.NO_WALL


def test_towards_a_corner_the_wall_is_ambiguous() -> None:
    assert only_reason(facing(50.0, 50.0, math.pi / 4), 60.0) is Refusal.AMBIGUOUS_WALL


def test_a_flat_angle_is_refused() -> None:
    belief = facing(-5.0, 80.0, math.radians(-98.0), (0.01, 0.01, 0.001))
    range_in = float(expected(belief)[0])
    assert range_in < 60.0
    assert only_reason(belief, range_in) is Refusal.GRAZING
    assert only_reason(belief, range_in, gate=Gate(min_cos_incidence=0.1)) is Refusal.NONE


@pytest.mark.parametrize(("sigmas_off", "reason"), [(3.2, Refusal.NONE), (3.4, Refusal.GATE), (-3.4, Refusal.GATE)])
def test_the_gate_opens_at_the_square_root_of_its_quantile(sigmas_off: float, reason: Refusal) -> None:
    """sqrt(10.828) = 3.29 standard deviations of the innovation: of pose and reading together."""
    belief = facing(40.0, 40.0, 0.0, (0.5, 0.2, 0.0))
    range_in = expected(belief)[0]
    assert only_reason(belief, range_in + sigmas_off * math.hypot(0.5, 0.01 * range_in)) is reason


def test_a_wider_gate_lets_more_pass() -> None:
    belief = facing(40.0, 40.0, 0.0, (0.0, 0.0, 0.0))
    range_in = expected(belief)[0]
    assert only_reason(belief, range_in * 1.035) is Refusal.GATE
    assert only_reason(belief, range_in * 1.035, gate=Gate(probability=0.99999)) is Refusal.NONE


def test_a_beam_left_out_has_no_innovation() -> None:
    belief = facing(50.0, 50.0, math.pi / 4)
    seen = observe(belief, expected(belief, ANGLES), ANGLES)
    silent = ~seen.used
    assert silent.any()
    assert (seen.innovation[silent] == 0).all()
    assert (seen.H[silent] == 0).all()
    assert (seen.R[silent] == 1).all()
    assert np.abs(seen.H[~silent]).sum(axis=-1).min() > 0.5


def on_the_ellipsoid(belief: Belief, sigmas: float) -> Floats:
    """Return many poses (k, 3) spread over the ellipsoid so many standard deviations around the mean."""
    directions = np.random.default_rng(5).standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(belief.mean + sigmas * directions @ np.linalg.cholesky(belief.cov).T)


def refusals_of(belief: Belief, walls: WallMap) -> Floats:
    x, P = unpack(Belief(belief.mean[None], belief.cov[None]))
    return np.asarray(predict_beam(x, P, ANGLES, N150.sonar_ring_radius_in, walls, STRICT).refusal)


@pytest.mark.long
def test_no_pose_of_the_ellipsoid_meets_another_wall() -> None:
    """The two poses of `sideways_shift` represent the ellipsoid: checked with four thousand.

    Inside of 0.9 of it nothing may be overlooked; what is refused must be found by 1.15 of it (the search is coarse,
    and the two poses are right to first order).
    """
    world = wall_map(load_world("centre_vertex").walls)
    rng = np.random.default_rng(6)
    refused = accepted = 0
    for _ in range(40):
        # A random covariance of some 0.3 in and 0.03 rad, with a small diagonal that makes it definite.
        mix = rng.normal(scale=(0.3, 0.3, 0.03), size=(3, 3))
        pose = np.array([rng.uniform(0, 90), rng.uniform(25, 90), rng.uniform(-3, 3)])
        belief = Belief(pose, mix.T @ mix + np.diag([0.01, 0.01, 1e-4]))
        # Walls as seen from the mean, and what the gate refuses as ambiguous.
        at_mean = ranges_from(pose, ANGLES, N150, world)
        ambiguous = refusals_of(belief, world) == Refusal.AMBIGUOUS_WALL
        # 3 sigma is the size of the ellipsoid that the gate checks.
        near, far = (
            (ranges_from(on_the_ellipsoid(belief, share * 3.0), ANGLES, N150, world).row != at_mean.row).any(axis=0)
            for share in (0.9, 1.15)
        )
        assert not (near & ~ambiguous & (at_mean.refusal == Refusal.NONE)).any()
        assert not (ambiguous & ~far).any()
        refused += int(ambiguous.sum())
        accepted += int((~near).sum())
    # Both answers must have occurred often.
    assert refused > 50
    assert accepted > 300


def test_a_batch_is_judged_as_each_alone() -> None:
    rng = np.random.default_rng(7)
    means = np.column_stack([rng.uniform(0, 90, 20), rng.uniform(0, 90, 20), rng.uniform(-3, 3, 20)])
    beliefs = independent(means, (0.3, 0.3, 0.03))
    # Noise of 1 in makes the gate refuse some readings.
    readings = expected(beliefs, ANGLES) + rng.normal(scale=1.0, size=(20, 16))
    together = observe(beliefs, readings, ANGLES)
    # All reasons occur among the 320 readings.
    assert set(np.unique(together.refusals)) >= {Refusal.NONE, Refusal.AMBIGUOUS_WALL, Refusal.GRAZING, Refusal.GATE}
    for row in range(20):
        alone = observe(Belief(means[row], beliefs.cov[row]), readings[row], ANGLES)
        assert alone.refusals.tolist() == together.refusals[row].tolist()
        assert alone.innovation == pytest.approx(together.innovation[row])
        assert pytest.approx(together.H[row]) == alone.H


def test_a_certain_belief_has_no_ambiguous_wall() -> None:
    belief = facing(50.0, 50.3, math.pi / 4, (0.0, 0.0, 0.0))
    assert (refusals_of(belief, ROOM) != Refusal.AMBIGUOUS_WALL).all()


# One live reading against arrays.


def beliefs(count: int) -> list[Belief]:
    """Return poses all over the room, spread in all directions, some of them little."""
    rng = np.random.default_rng(11)
    found = []
    for _ in range(count):
        root = rng.normal(size=(3, 3)) * rng.uniform(0.0, 0.6) * np.array([[1.0], [1.0], [0.05]])
        found.append(Belief(np.array([*rng.uniform(5.0, 85.0, size=2), rng.uniform(-np.pi, np.pi)]), root @ root.T))
    return found


@pytest.mark.long
@pytest.mark.parametrize("walls", [WALLS, OPEN])
def test_a_beam_in_numbers_is_that_in_arrays(walls: WallMap) -> None:
    reasons = []
    for at, belief in enumerate(beliefs(400)):
        # Angles from 0 to 40 rad go around the ring several times.
        angle = 0.1 * at
        # The same function on numbers and on arrays of one element.
        alone = predict_beam(*unpack(belief), angle, N150.sonar_ring_radius_in, walls, STRICT)
        many = unpack(Belief(belief.mean[None], belief.cov[None]))
        arrays = predict_beam(*many, np.array([angle]), N150.sonar_ring_radius_in, walls, STRICT)
        assert alone.refusal == arrays.refusal[0]
        reasons.append(alone.refusal)
        if alone.refusal in (Refusal.NONE, Refusal.GRAZING):
            assert alone.row == arrays.row[0]
            assert alone.range_in == pytest.approx(arrays.range_in[0], abs=1e-9)
            H = np.array([part[0] for part in arrays.H])
            assert pytest.approx(H, abs=1e-9) == alone.H
            # The scalar H P H' is written out by hand in the product.
            variance = predicted_variance(unpack(belief)[1], alone.H)
            assert variance == pytest.approx(float(H @ belief.cov @ H), rel=1e-9, abs=1e-12)
    # Enough rays with a wall, and for the open world enough without.
    assert reasons.count(Refusal.NONE) > 20
    assert (reasons.count(Refusal.NO_WALL) > 20) == (walls is OPEN)


@pytest.mark.long
def test_a_live_reading_is_judged_as_in_arrays() -> None:
    model, rng = RayModel(WALLS.segments, N150, WIRE_SONAR), np.random.default_rng(2)
    reasons = []
    for at, belief in enumerate(beliefs(300)):
        sonar, offset = at % 16, 0.01 * at
        angle = ANGLES[sonar : sonar + 1] + offset
        range_in = float(ranges_from(belief.mean, angle, N150, WALLS).range_in[0])
        # Exact readings, with noise, off by 30 in, and beyond the limit.
        reading = float(round(range_in + rng.choice([0.0, 0.3, 30.0, 300.0])))
        arrays = observe_ring(belief, angle, np.array([reading]), N150, WALLS, WIRE_SONAR)
        found = model.associate(*unpack(belief), sonar, offset, reading)
        assert found.refusal == arrays.refusals[0]
        reasons.append(found.refusal)
        if found.refusal is Refusal.NONE:
            assert reading - found.ranges_in[0] == pytest.approx(arrays.innovation[0], abs=1e-9)
            assert found.R[0] == pytest.approx(arrays.R[0], rel=1e-12)
            assert found.H[0] == pytest.approx(arrays.H[0], abs=1e-9)
    assert min(reasons.count(one) for one in (Refusal.NONE, Refusal.LIMIT, Refusal.GATE, Refusal.GRAZING)) > 0


def alone(belief: Belief, walls: WallMap) -> tuple[Refusal, float, tuple[float, float, float]]:
    beam = predict_beam(*unpack(belief), 0.0, 9.0, walls, STRICT)
    return Refusal(beam.refusal), beam.range_in, beam.H


def test_a_certain_pose_and_a_wall_seen_end_on() -> None:
    assert alone(independent([0.0, 0.0, 0.0], [0.0, 0.0, 0.0]), OPEN) == (Refusal.NONE, 21.0, (-1.0, 0.0, 0.0))
    along = wall_map([[-40.0, 0.0, 40.0, 0.0]])
    refusal, _, _ = alone(independent([-60.0, 0.0, 0.0], [0.1, 0.1, 0.01]), along)
    assert refusal is Refusal.AMBIGUOUS_WALL
    refusal, _, _ = alone(independent([30.0, -60.0, 0.5 * np.pi], [0.1, 0.1, 0.01]), OPEN)
    assert refusal is Refusal.AMBIGUOUS_WALL
