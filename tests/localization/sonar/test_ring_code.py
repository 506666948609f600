"""The loop for machine code against arrays, as it stands and compiled; and who has no numba."""

from __future__ import annotations

import builtins
from collections import Counter

import numpy as np
import pytest

from localization.estimation.belief import Belief, Floats
from localization.estimation.observation import Refusal
from localization.sonar import gating, ring_code
from localization.sonar.gating import observe
from localization.sonar.measurement import WIRE_SONAR, Beams, fired_at, ring, wall_map
from localization.sonar.ring_code import Loop, RingCode, judge_ring
from worlds.bodies import N150
from worlds.files import load_world

ROOM = wall_map(load_world("several_walls").walls)
OPEN = wall_map([[30.0, -40.0, 30.0, 40.0], [10.0, 20.0, 50.0, 20.0]])
RING = ring(N150, 0.2)
SHIFTED = fired_at(RING, np.array([0.5, -0.2, 0.03]))


def cases(count: int) -> list[tuple[Belief, Floats]]:
    """Beliefs all over the room, and readings good, bad and at the limits."""
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        root = rng.normal(size=(3, 3)) * rng.uniform(0.0, 0.4) * np.array([[1.0], [1.0], [0.03]])
        pose = np.array([*rng.uniform(5.0, 85.0, size=2), rng.uniform(-np.pi, np.pi)])
        found.append((Belief(pose, root @ root.T), rng.choice([0.0, 0.5, 20.0, 400.0], size=16)))
    return found


def with_loop(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare what `observe` says with the loop and without, from many places."""
    code, reasons = RingCode(), Counter[Refusal]()
    for walls in (ROOM, OPEN):
        for beams in (RING, SHIFTED):
            for belief, off in cases(60):
                readings = np.nan_to_num(expected(belief, beams), nan=77.0) + off
                monkeypatch.setattr(gating, "RING", RingCode())
                plain = observe(belief, beams, readings, walls, WIRE_SONAR)
                code.run = loop
                monkeypatch.setattr(gating, "RING", code)
                mine = observe(belief, beams, readings, walls, WIRE_SONAR)
                assert mine.refusals.tolist() == plain.refusals.tolist()
                np.testing.assert_allclose(mine.innovation, plain.innovation, atol=1e-9)
                np.testing.assert_allclose(mine.jacobian, plain.jacobian, atol=1e-9)
                np.testing.assert_allclose(mine.variance, plain.variance, rtol=1e-10)
                reasons.update(plain.reasons())
    assert set(reasons) == set(Refusal)


def expected(belief: Belief, beams: Beams) -> Floats:
    return gating.associate(belief, beams, ROOM).seen.ranges_in


def test_the_loop_judges_as_arrays_do(monkeypatch: pytest.MonkeyPatch) -> None:
    with_loop(judge_ring, monkeypatch)


def test_machine_code_judges_as_arrays_do(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    code = RingCode()
    assert code.load()
    assert code.load()
    assert code.run is not None
    with_loop(code.run, monkeypatch)


def test_a_ray_beside_its_wall_is_ambiguous_and_a_certain_pose_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    code = RingCode()
    code.run = judge_ring
    monkeypatch.setattr(gating, "RING", code)
    along = wall_map([[20.0, 0.0, 40.0, 0.0], [90.0, -50.0, 90.0, 50.0]])
    ahead = Beams(np.zeros((1, 2)), np.array([[1.0, 0.0]]), 9.0)
    certain = Belief(np.zeros(3), np.zeros((3, 3)))
    assert observe(certain, ahead, np.array([11.0]), along, WIRE_SONAR).reasons() == (Refusal.AMBIGUOUS_WALL,)
    beside = Belief(np.array([0.0, 1.0, 0.0]), np.zeros((3, 3)))
    seen = observe(beside, ahead, np.array([81.5]), along, WIRE_SONAR)
    assert seen.reasons() == (Refusal.NONE,)
    assert seen.innovation.tolist() == [0.5]
    assert seen.jacobian.tolist() == [[-1.0, 0.0, 0.0]]


def test_without_numba_there_are_arrays(monkeypatch: pytest.MonkeyPatch) -> None:
    found = builtins.__import__

    def without(name: str, *rest: object, **more: object) -> object:
        if name.startswith("numba"):
            raise ImportError(name)
        return found(name, *rest, **more)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without)
    monkeypatch.setattr(ring_code, "RING", RingCode())
    assert not ring_code.load()
    assert ring_code.RING.run is None
