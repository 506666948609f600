"""One beam in plain numbers against the same beam in arrays: any pose, any spread, every reason to refuse."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from localization.filters.belief import Belief, independent
from localization.filters.sonar_ray import (
    STRICT,
    WIRE_SONAR,
    Beams,
    RayModel,
    WallMap,
    associate,
    judged,
    pick,
    predict_beam,
    ring,
    wall_map,
)
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.robots import N150

ROOM = wall_map(load_world("several_walls").walls)
OPEN = wall_map([[30.0, -40.0, 30.0, 40.0]])


def beam(direction_rad: float) -> Beams:
    return pick(ring(N150, direction_rad), 0)


def beliefs(count: int) -> list[Belief]:
    """Poses all over the room, spread in all directions, some of them little."""
    rng = np.random.default_rng(11)
    found = []
    for _ in range(count):
        root = rng.normal(size=(3, 3)) * rng.uniform(0.0, 0.6) * np.array([[1.0], [1.0], [0.05]])
        found.append(Belief(np.array([*rng.uniform(5.0, 85.0, size=2), rng.uniform(-np.pi, np.pi)]), root @ root.T))
    return found


@pytest.mark.parametrize("walls", [ROOM, OPEN])
def test_a_beam_is_paired_as_in_arrays(walls: WallMap) -> None:
    reasons: Counter[Refusal] = Counter()
    for at, belief in enumerate(beliefs(400)):
        plain = associate(belief, beam(0.1 * at), walls)
        mine = predict_beam(belief, 0.1 * at, N150.sonar_ring_radius_in, walls, STRICT.sigmas, STRICT.min_cos_incidence)
        assert mine.refusal == plain.refusals[0]
        reasons[mine.refusal] += 1
        if mine.refusal in (Refusal.NONE, Refusal.GRAZING):
            assert mine.range_in == pytest.approx(plain.seen.ranges_in[0], abs=1e-9)
            assert mine.jacobian == pytest.approx(plain.jacobian[0], abs=1e-9)
            spread = float((plain.jacobian @ belief.cov @ plain.jacobian.T)[0, 0])
            assert mine.spread_in2 == pytest.approx(spread, rel=1e-9, abs=1e-12)
            np.testing.assert_array_equal(walls.lines[mine.row], plain.lines[0])
    assert reasons[Refusal.NONE] > 20
    assert (reasons[Refusal.NO_WALL] > 20) == (walls is OPEN)


def test_a_reading_is_judged_as_in_arrays() -> None:
    sense, rng = RayModel(ROOM.segments, N150, WIRE_SONAR), np.random.default_rng(2)
    reasons: Counter[Refusal] = Counter()
    for at, belief in enumerate(beliefs(300)):
        sonar, offset = at % 16, 0.01 * at
        paired = associate(belief, pick(ring(N150, offset), sonar), ROOM)
        reading = round(float(paired.seen.ranges_in[0]) + rng.choice([0.0, 0.3, 30.0, 300.0]))
        plain = judged(paired, belief, np.array([reading]), WIRE_SONAR)
        mine = sense.sense(belief, sonar, offset, float(reading))
        assert mine.refusal == plain.refusals[0]
        reasons[mine.refusal] += 1
        if mine.candidates is not None:
            assert reading - mine.candidates.ranges_in == pytest.approx(plain.innovation, abs=1e-9)
            assert mine.candidates.variance == pytest.approx(plain.variance, rel=1e-12)
            assert mine.candidates.jacobian == pytest.approx(plain.jacobian, abs=1e-9)
    assert min(reasons[refusal] for refusal in (Refusal.NONE, Refusal.LIMIT, Refusal.GATE, Refusal.GRAZING)) > 0


def test_a_certain_pose_and_a_beam_beside_its_wall() -> None:
    certain = independent([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    head_on = predict_beam(certain, 0.0, 9.0, OPEN, 3.0, 0.3)
    assert (head_on.refusal, head_on.range_in, head_on.jacobian) == (Refusal.NONE, 21.0, (-1.0, 0.0, 0.0))
    along = independent([30.0, -60.0, 0.5 * np.pi], [0.1, 0.1, 0.01])
    beside = wall_map([[-40.0, 0.0, 40.0, 0.0]])
    assert predict_beam(independent([-60.0, 0.0, 0.0], [0.1, 0.1, 0.01]), 0.0, 9.0, beside, 3.0, 0.3).refusal == (
        Refusal.AMBIGUOUS_WALL
    )
    assert associate(along, beam(0.0), OPEN).refusals[0] == predict_beam(along, 0.0, 9.0, OPEN, 3.0, 0.3).refusal
