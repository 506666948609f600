"""The compiled loop over a state against the same source in plain Python, and what happens without numba."""

from __future__ import annotations

import builtins
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from localization.filters import compiled
from localization.filters.base import EncoderRow, Filter, LocalizationConfig, NewEcho, measurement_model
from localization.filters.belief import Belief, unpack, with_constants
from localization.filters.ekf import KalmanFilter
from localization.filters.filter_loop import FilterMemory, StateInput, filter_config, filter_state
from localization.filters.health import HealthLimits, empty_slip_sums, empty_windows
from localization.filters.odometry import OdometryNoise
from localization.filters.registry import make
from localization.filters.sonar_cone import ConeModel, ConeSonar, update_by_cone
from localization.filters.sonar_ray import WIRE_SONAR, RayModel, RaySonar, update_by_ray
from localization.filters.update import Refusal, new_used
from worlds.compiled import VARIABLE
from worlds.io import load_world
from worlds.robots import N150

WALLS = load_world("several_walls").walls
NOISE = OdometryNoise()


@pytest.fixture
def numba(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("numba")
    monkeypatch.setenv(VARIABLE, "always")


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
def test_compiled_states_equal_plain_python_to_the_bit(
    sonar: RaySonar | ConeSonar, n: int, range_stds: tuple[float, ...]
) -> None:
    model = measurement_model(WALLS, N150, sonar, range_parameters=len(range_stds))
    assert isinstance(model, RayModel | ConeModel)
    config = filter_config(NOISE, model, HealthLimits(window=20, slip_nats=1.5), (30.0, 40.0))
    fast = compiled.filter_of(config)
    assert fast is not None
    rng, refusals, seen = np.random.default_rng(n), set(), []
    mean, std = np.array([20.0, 50.0, 0.3, 0.01, -0.01, 1e-4])[:n], np.array([0.5, 0.5, 0.02, 0.02, 0.02, 1e-3])[:n]
    belief = with_constants(Belief(mean, np.diag(std**2)), range_stds)
    lists = FilterMemory(*unpack(belief), new_used(), empty_slip_sums(), empty_windows(20))
    arrays = FilterMemory(*(np.array(part) for part in lists))  # type: ignore[arg-type]
    for k in range(30):
        state = StateInput(*random_ring(rng), clock_std_s=0.01, detects_slips=k % 10 != 9)
        x, P = [0.0] * n, [[0.0] * n for _ in range(n)]
        outcomes, *plain = filter_state(lists, state, config, model.update, x, P)
        fast_outcomes, *others, reported = fast.filter(arrays, state, n)
        np.testing.assert_array_equal(fast_outcomes, outcomes)
        assert others == plain
        assert (reported.mean.tolist(), reported.cov.tolist()) == (x, P)
        refusals |= {outcome[0] for outcome in outcomes}
        seen.append(plain[1])
    assert [np.array(array).tolist() for array in arrays] == [np.array(part).tolist() for part in lists]
    assert refusals >= {Refusal.NONE, Refusal.LIMIT, Refusal.GATE}
    _, matched, nis_ratio, since_slip, slipped, _ = (set(signs) for signs in zip(*seen, strict=True))
    assert min(len(matched), len(nis_ratio), len(since_slip), len(slipped)) > 1, "each is tried"


@pytest.mark.long
@pytest.mark.usefixtures("numba")
def test_compiled_filter_equals_the_plain_one(monkeypatch: pytest.MonkeyPatch) -> None:
    config = LocalizationConfig(WALLS, N150)
    belief = Belief(np.array([20.0, 50.0, 0.3]), np.diag([0.25, 0.25, 4e-4]))
    drive = random_ring(np.random.default_rng(1))
    fast = make("ekf", config, belief)
    # Loaded in this process or not: the variable decides.
    monkeypatch.setenv(VARIABLE, "never")
    plain = make("ekf", config, belief)
    assert isinstance(fast, KalmanFilter)
    assert isinstance(plain, KalmanFilter)
    assert fast._compiled
    assert not plain._compiled
    np.testing.assert_array_equal(fast.process(*drive), plain.process(*drive))
    np.testing.assert_array_equal(fast.belief.cov, plain.belief.cov)
    assert fast.health == plain.health
    # The prediction that is reported, widened by all that widens it; the belief stays as it is.
    for filter_ in (fast, plain):
        filter_._monitor.add_innovation(-2.0, 9.0, 1.0)
    encoders, poses, _ = drive
    one, other = (filter_.advance(encoders, poses, [], 0.01)[2] for filter_ in (fast, plain))
    np.testing.assert_array_equal(one.mean, other.mean)
    np.testing.assert_array_equal(one.cov, other.cov)
    assert one.cov[0, 0] > fast.belief.cov[0, 0]
    np.testing.assert_array_equal(fast.belief.cov, plain.belief.cov)


def test_without_numba_nothing_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = builtins.__import__

    def no_numba(name: str, *arguments: Any) -> Any:
        if name.startswith("numba"):
            raise ImportError(name)
        return plain(name, *arguments)

    compiled.load.cache_clear()
    monkeypatch.setenv(VARIABLE, "always")
    monkeypatch.setattr(builtins, "__import__", no_numba)
    model = measurement_model(WALLS, N150, WIRE_SONAR)
    assert isinstance(model, RayModel)
    assert not compiled.load()
    assert compiled.filter_of(filter_config(NOISE, model, HealthLimits())) is None
    compiled.load.cache_clear()


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.long
@pytest.mark.parametrize(
    ("word", "on_disk", "stderr", "wanted"),
    [
        (None, False, io.StringIO(), False),
        (None, True, io.StringIO(), True),
        (None, False, Terminal(), True),
        ("never", True, Terminal(), False),
        ("always", False, io.StringIO(), True),
    ],
)
def test_compiled_code_is_used_where_nothing_waits_unseen(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, word: str | None, on_disk: bool, stderr: io.StringIO, wanted: bool
) -> None:
    pytest.importorskip("numba")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("sys.stderr", stderr)
    if word is None:
        monkeypatch.delenv(VARIABLE, raising=False)
    else:
        monkeypatch.setenv(VARIABLE, word)
    if on_disk:
        compiled._mark(update_by_ray).touch()
    assert compiled.is_wanted(update_by_ray) is wanted
    assert not compiled.is_wanted(update_by_cone) or word == "always" or stderr.isatty()


def test_passing_over_limits_changes_no_belief() -> None:
    config = LocalizationConfig(WALLS, N150, sonar=ConeSonar())
    belief = Belief(np.array([20.0, 50.0, 0.3]), np.diag([0.25, 0.25, 4e-4]))
    one, other = make("ekf", config, belief), make("ekf", config, belief)
    assert isinstance(one, KalmanFilter)
    assert isinstance(other, KalmanFilter)
    poses: list[EncoderRow] = [(0.0, 0.0, 0.0, 0.0, 0.0), (1.0, 4.0, 0.0, 0.0, 0.0)]
    limits: list[NewEcho] = [(0.06 * (k + 1), k, 255.0) for k in range(4)]
    echoes: list[NewEcho] = [*limits, (0.3, 4, 37.0), (0.36, 5, 255.0)]
    assert len(one.process(poses[0], poses, [])) == 0, "a row of a log without new echoes"
    outcomes = one.process(poses[0], poses, echoes)
    each = Filter.process(other, poses[0], poses, echoes)
    assert [code for code, *_ in outcomes] == [result[0] for result in each]
    # In fewer steps, of which each is linearised.
    np.testing.assert_allclose(one.belief.mean, other.belief.mean, atol=1e-4)
    np.testing.assert_allclose(one.belief.cov, other.belief.cov, atol=1e-4)
