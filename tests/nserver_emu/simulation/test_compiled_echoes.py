"""The compiled acoustics against the same source in plain Python, to the bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nserver_emu.simulation import acoustics, echo_paths
from nserver_emu.simulation.acoustics import FIRST_ECHO, Ping, Polaroid, ReflectorMap
from nserver_emu.simulation.noise import BUILDING, MEASURED
from worlds.compiled import CompiledFunction
from worlds.geometry import NO_DISCS, FloatArray
from worlds.io import load_world
from worlds.robots import N150

pytestmark = pytest.mark.long

assert isinstance(MEASURED.sonar, Polaroid)
assert isinstance(BUILDING.sonar, Polaroid)
LOUD = replace(MEASURED.sonar, margin_db=80.0, edge_loss_db=5.0)


@pytest.fixture(scope="module")
def compiled() -> CompiledFunction:
    """Compiled code, of this module alone."""
    pytest.importorskip("numba")
    function = CompiledFunction(echo_paths.first_echo, FIRST_ECHO._sources, FIRST_ECHO._example)
    assert function.load()
    return function


def pings_in(walls: FloatArray, rng: np.random.Generator) -> tuple[Ping, list[Ping], FloatArray]:
    """Return a ping, earlier ones of its ring, and other robots near it."""
    x, y = rng.uniform(walls.reshape(-1, 2).min(axis=0), walls.reshape(-1, 2).max(axis=0)).tolist()
    direction, now_ps = rng.uniform(-np.pi, np.pi), 10**12
    noise = tuple(rng.standard_normal(2).tolist())
    earlier = [
        Ping(x + 0.1 * number, y, direction + turn, now_ps - number * 4 * 10**9, noise)
        for number, turn in enumerate(rng.choice([-0.39, 0.39, 3.1], rng.integers(0, 5)).tolist(), 1)
    ]
    count = rng.integers(0, 3)
    discs = np.column_stack((np.array((x, y)) + rng.uniform(-80.0, 80.0, (count, 2)), rng.uniform(7.0, 12.0, count)))
    return Ping(x, y, direction, now_ps, noise), earlier, discs if count else NO_DISCS


@pytest.mark.parametrize("model", [MEASURED.sonar, BUILDING.sonar, LOUD])
def test_compiled_and_plain_ranges_have_the_same_bits(
    compiled: CompiledFunction, monkeypatch: pytest.MonkeyPatch, model: Polaroid
) -> None:
    rng, finite = np.random.default_rng(1), 0
    for name in ("thesis_room", "several_walls", "centre_vertex", "hall"):
        reflectors = ReflectorMap(load_world(name).walls, model.surfaces(5))
        for _ in range(60):
            ping, earlier, discs = pings_in(reflectors.walls, rng)
            plain = model.measured_range(ping, earlier, reflectors, N150, discs)
            with monkeypatch.context() as patched:
                patched.setattr(acoustics, "FIRST_ECHO", compiled)
                found = model.measured_range(ping, earlier, reflectors, N150, discs)
            assert found.hex() == plain.hex()
            finite += plain < np.inf
    assert finite >= 100
