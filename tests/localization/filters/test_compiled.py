"""The compiled loop over a ring against the same source in plain Python, and what happens without numba."""

from __future__ import annotations

import builtins
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from localization.filters import compiled
from localization.filters.base import EncoderRow, LocalizationConfig, NewEcho, measurement_model
from localization.filters.belief import Belief, pack, unpack, with_constants
from localization.filters.ekf import KalmanFilter, filter_ring
from localization.filters.odometry import OdometryNoise
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeModel, ConeSonar
from localization.filters.sonar_ray import WIRE_SONAR, RayModel, RaySonar
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.robots import N150

WALLS = load_world("several_walls").walls
NOISE = OdometryNoise()


@pytest.fixture
def numba() -> Iterator[None]:
    pytest.importorskip("numba")
    assert compiled.load()
    yield
    compiled.load.cache_clear()


def random_ring(rng: np.random.Generator) -> tuple[EncoderRow, list[EncoderRow], list[NewEcho]]:
    """Poses of a robot that drives a curve or stands, and readings of which some are limits or outliers."""
    rate = rng.uniform(-0.5, 0.5, size=3) * rng.choice([0.0, 1.0])
    poses = [(0.5 * k, *(0.5 * k * rate).tolist(), 0.3 * k) for k in range(3)]
    echoes = [(0.06 * (k + 1), k, float(rng.choice([6.0, 255.0, *rng.integers(7, 90, size=8)]))) for k in range(16)]
    return poses[0], poses, echoes


@pytest.mark.long
@pytest.mark.usefixtures("numba")
@pytest.mark.parametrize("n", [3, 4, 6])
@pytest.mark.parametrize("sonar", [WIRE_SONAR, ConeSonar()])
@pytest.mark.parametrize("range_stds", [(), (0.5, 0.015)])
def test_compiled_rings_equal_plain_python(
    sonar: RaySonar | ConeSonar, n: int, range_stds: tuple[float, ...]
) -> None:
    model = measurement_model(WALLS, N150, sonar, range_parameters=len(range_stds))
    assert isinstance(model, RayModel | ConeModel)
    ring = compiled.ring(filter_ring, model, NOISE)
    assert ring is not None
    rng, refusals = np.random.default_rng(n), set()
    mean, std = np.array([20.0, 50.0, 0.3, 0.01, -0.01, 1e-4])[:n], np.array([0.5, 0.5, 0.02, 0.02, 0.02, 1e-3])[:n]
    belief = with_constants(Belief(mean, np.diag(std**2)), range_stds)
    (x, P), used = unpack(belief), [[0.0] * 4 for _ in range(17)]
    (x_compiled, P_compiled), used_compiled = unpack(pack(x, P)), np.array(used)
    for _ in range(30):
        drive = random_ring(rng)
        plain = filter_ring(x, P, used, *drive, NOISE, model, model.update)
        fast = ring.filter(x_compiled, P_compiled, used_compiled, *drive)
        np.testing.assert_allclose(fast, plain, rtol=1e-10, atol=1e-12)
        refusals |= {outcome[0] for outcome in plain}
    np.testing.assert_allclose(x_compiled, x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(P_compiled, P, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(used_compiled, used, rtol=1e-12)
    assert refusals >= {Refusal.NONE, Refusal.LIMIT, Refusal.GATE}


@pytest.mark.long
@pytest.mark.usefixtures("numba")
def test_a_filter_made_after_loading_is_compiled() -> None:
    config = LocalizationConfig(WALLS, N150)
    belief = Belief(np.array([20.0, 50.0, 0.3]), np.diag([0.25, 0.25, 4e-4]))
    drive = random_ring(np.random.default_rng(1))
    fast = make("ekf", config, belief)
    compiled.load.cache_clear()
    plain = make("ekf", config, belief)
    assert isinstance(fast, KalmanFilter)
    assert isinstance(plain, KalmanFilter)
    np.testing.assert_allclose(fast.process(*drive), plain.process(*drive), rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(fast.belief.cov, plain.belief.cov, rtol=1e-9, atol=1e-15)
    assert fast.health == plain.health


def test_without_numba_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = builtins.__import__

    def no_numba(name: str, *arguments: Any) -> Any:
        if name.startswith("numba"):
            raise ImportError(name)
        return plain(name, *arguments)

    compiled.load.cache_clear()
    monkeypatch.setattr(builtins, "__import__", no_numba)
    model = measurement_model(WALLS, N150, WIRE_SONAR)
    assert isinstance(model, RayModel)
    assert not compiled.load()
    assert compiled.ring(filter_ring, model, NOISE) is None
    compiled.load.cache_clear()
