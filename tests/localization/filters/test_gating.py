"""Which beams may correct: every reason once, and the choice of walls against a search over the whole ellipsoid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, independent
from localization.filters.sonar_ray import (
    IDEAL_SONAR,
    STRICT,
    WIRE_SONAR,
    Beams,
    Gate,
    RaySonar,
    WallMap,
    associate,
    meet,
    observe,
    pick,
    rays,
    ring,
    sight,
    wall_map,
)
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.robots import N150

ROOM = wall_map(load_world("thesis_room").walls)
RING = ring(N150)
AHEAD = pick(RING, 0)


def ranges_from(belief: Belief, beams: Beams = RING) -> Floats:
    aimed = rays(belief.mean[..., None, :], beams)
    return sight(aimed, ROOM.lines[meet(aimed, ROOM)]).ranges_in


def only_reason(belief: Belief, reading: float, sonar: RaySonar = IDEAL_SONAR, gate: Gate = STRICT) -> Refusal:
    (reason,) = observe(belief, AHEAD, np.array([reading]), ROOM, sonar, gate).reasons()
    return reason


def facing(x: float, y: float, heading: float, std: tuple[float, float, float] = (0.1, 0.1, 0.01)) -> Belief:
    return independent((x, y, heading), std)


def test_a_good_beam_is_used_as_it_is() -> None:
    belief = facing(40.0, 40.0, 0.1)
    expected = ranges_from(belief, AHEAD)
    observation = observe(belief, AHEAD, expected + 0.2, ROOM, IDEAL_SONAR)
    assert observation.reasons() == (Refusal.NONE,)
    assert observation.innovation == pytest.approx([0.2])
    assert observation.variance == pytest.approx(np.maximum(0.01 * expected, 0.05) ** 2)
    far = 102.17 - 40.0
    assert observation.jacobian[0] == pytest.approx([-1 / math.cos(0.1), 0.0, far * math.sin(0.1) / math.cos(0.1) ** 2])


@pytest.mark.parametrize("reading", [6.0, 5.0, 255.0, 300.0, float("nan"), float("inf")])
def test_a_limit_is_no_measurement(reading: float) -> None:
    assert only_reason(facing(40.0, 40.0, 0.0), reading, WIRE_SONAR) is Refusal.LIMIT


@pytest.mark.parametrize("reading", [6.5, 254.0])
def test_within_the_limits_it_is_judged_by_its_size(reading: float) -> None:
    assert only_reason(facing(40.0, 40.0, 0.0), reading, WIRE_SONAR) is Refusal.GATE


def test_nothing_to_meet() -> None:
    assert only_reason(facing(200.0, 40.0, 0.0), 50.0) is Refusal.NO_WALL


def test_towards_a_corner_the_wall_is_ambiguous() -> None:
    assert only_reason(facing(50.0, 50.0, math.pi / 4), 60.0) is Refusal.AMBIGUOUS_WALL


def test_a_flat_angle_is_refused() -> None:
    belief = facing(-5.0, 80.0, math.radians(-98.0), (0.01, 0.01, 0.001))
    assert ranges_from(belief, AHEAD)[0] < 60.0
    assert only_reason(belief, float(ranges_from(belief, AHEAD)[0])) is Refusal.GRAZING
    assert only_reason(belief, float(ranges_from(belief, AHEAD)[0]), gate=Gate(min_cos_incidence=0.1)) is Refusal.NONE


@pytest.mark.parametrize(("sigmas_off", "reason"), [(3.2, Refusal.NONE), (3.4, Refusal.GATE), (-3.4, Refusal.GATE)])
def test_the_gate_opens_at_the_square_root_of_its_quantile(sigmas_off: float, reason: Refusal) -> None:
    """sqrt(10.828) = 3.29 standard deviations of the innovation: of pose and reading together."""
    belief = facing(40.0, 40.0, 0.0, (0.5, 0.2, 0.0))
    expected = ranges_from(belief, AHEAD)[0]
    std = math.hypot(0.5, 0.01 * expected)
    assert only_reason(belief, expected + sigmas_off * std) is reason


def test_a_wider_gate_lets_more_pass() -> None:
    belief = facing(40.0, 40.0, 0.0, (0.0, 0.0, 0.0))
    expected = ranges_from(belief, AHEAD)[0]
    assert only_reason(belief, expected * 1.035) is Refusal.GATE
    assert only_reason(belief, expected * 1.035, gate=Gate(probability=0.99999)) is Refusal.NONE


def test_a_beam_left_out_says_nothing() -> None:
    belief = facing(50.0, 50.0, math.pi / 4)
    observation = observe(belief, RING, ranges_from(belief), ROOM, IDEAL_SONAR)
    silent = ~observation.used
    assert silent.any()
    assert (observation.innovation[silent] == 0).all()
    assert (observation.jacobian[silent] == 0).all()
    assert (observation.variance[silent] == 1).all()
    assert np.abs(observation.jacobian[~silent]).sum(axis=-1).min() > 0.5


def test_association_needs_no_reading() -> None:
    belief = facing(50.0, 50.0, math.pi / 4)
    pairs = associate(belief, pick(RING, [0, 2]), ROOM)
    assert pairs.refusals.tolist() == [Refusal.AMBIGUOUS_WALL, Refusal.NONE]
    assert pairs.lines[1] == pytest.approx(ROOM.lines[2])


def on_the_ellipsoid(belief: Belief, sigmas: float) -> Floats:
    """Many poses (k, 3) spread over the ellipsoid so many standard deviations around the mean."""
    directions = np.random.default_rng(5).standard_normal((4000, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return np.asarray(belief.mean + sigmas * directions @ np.linalg.cholesky(belief.cov).T)


def test_no_pose_of_the_ellipsoid_meets_another_wall_than_a_beam_that_is_used() -> None:
    """The two poses looked at stand for all of the ellipsoid: checked by looking at four thousand.

    Inside of 0.9 of it nothing may be overlooked; what is refused must be found by 1.15 of it (the search is coarse,
    and the two poses are right to first order).
    """
    world = wall_map(load_world("centre_vertex").walls)
    rng = np.random.default_rng(6)
    refused = kept = 0
    for _ in range(40):
        mix = rng.normal(scale=(0.3, 0.3, 0.03), size=(3, 3))
        pose = np.array([rng.uniform(0, 90), rng.uniform(25, 90), rng.uniform(-3, 3)])
        belief = Belief(pose, mix.T @ mix + np.diag([0.01, 0.01, 1e-4]))
        met = meet(rays(pose[None], RING), world)
        ambiguous = associate(belief, RING, world).refusals == Refusal.AMBIGUOUS_WALL.value
        near, far = (
            (meet(rays(on_the_ellipsoid(belief, share * 3.0)[:, None, :], RING), world) != met).any(axis=0)
            for share in (0.9, 1.15)
        )
        assert not (near & ~ambiguous & (np.abs(_cosines(pose, world)) >= 0.3)).any()
        assert not (ambiguous & ~far).any()
        refused += int(ambiguous.sum())
        kept += int((~near).sum())
    assert refused > 50
    assert kept > 300


def _cosines(pose: Floats, world: WallMap) -> Floats:
    aimed = rays(pose[None], RING)
    return sight(aimed, world.lines[meet(aimed, world)]).cos_incidence


def test_a_batch_is_judged_as_each_alone() -> None:
    rng = np.random.default_rng(7)
    means = np.column_stack([rng.uniform(0, 90, 20), rng.uniform(0, 90, 20), rng.uniform(-3, 3, 20)])
    beliefs = independent(means, (0.3, 0.3, 0.03))
    readings = ranges_from(beliefs) + rng.normal(scale=1.0, size=(20, 16))
    together = observe(beliefs, RING, readings, ROOM, IDEAL_SONAR)
    assert set(np.unique(together.refusals)) >= {Refusal.NONE, Refusal.AMBIGUOUS_WALL, Refusal.GRAZING, Refusal.GATE}
    for row in range(20):
        alone = observe(Belief(means[row], beliefs.cov[row]), RING, readings[row], ROOM, IDEAL_SONAR)
        assert alone.refusals.tolist() == together.refusals[row].tolist()
        assert alone.innovation == pytest.approx(together.innovation[row])
        assert alone.jacobian == pytest.approx(together.jacobian[row])


def test_a_belief_without_doubt_refuses_no_wall_as_ambiguous() -> None:
    belief = facing(50.0, 50.3, math.pi / 4, (0.0, 0.0, 0.0))
    assert (associate(belief, RING, ROOM).refusals != Refusal.AMBIGUOUS_WALL.value).all()
