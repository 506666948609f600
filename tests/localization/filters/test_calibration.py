"""The long state against the shorter filter and finite differences, and the errors of its estimates."""

from __future__ import annotations

import numpy as np
import pytest

from localization.cli.calibrate import calibration_in, table
from localization.experiments.live_trial import EXACT_RAYS
from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.calibration import (
    OFFSET,
    OWN,
    PARAMETER_STDS,
    RING_TURN,
    SIZE,
    AimReading,
    CalibratingFilter,
    ConeAim,
)
from localization.filters.ekf import KalmanFilter
from localization.filters.health import HealthStatus
from localization.filters.odometry import OdometryNoise, move, with_parameters
from localization.filters.registry import update_for
from localization.filters.sonar_cone import ConeSonar
from localization.filters.update import Refusal
from worlds.io import load_world
from worlds.raycast_arrays import cast_rays
from worlds.robots import N150

WORLD = load_world("several_walls")
QUIET = OdometryNoise(0.02, 0.02, 0.0005)
RAYS = LocalizationConfig(WORLD.walls, N150, QUIET, EXACT_RAYS, range_stds=None)
# The long filter takes repeated readings from one place for independent.
CONES = LocalizationConfig(WORLD.walls, N150, QUIET, ConeSonar(place_var_in2=0.0), range_stds=None)
START = independent([20.0, 50.0, 0.3], [0.2, 0.2, 0.01])
NOTHING_BESIDES = (*PARAMETER_STDS[:3], *(0.0,) * (SIZE - 6))


def test_ideal_sonars_give_the_shorter_kalman_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    # The aim step, which the short filter lacks, is made neutral: mean 0, all of the variance left.
    monkeypatch.setattr(ConeAim, "posterior", lambda *_: (0.0, 1.0))
    rng = np.random.default_rng(4)
    for config in (RAYS, CONES):
        long = CalibratingFilter(config, START, NOTHING_BESIDES)
        measurement = update_for(config.walls, N150, config.sonar)
        short = KalmanFilter(with_parameters(START, PARAMETER_STDS[:3]), measurement, QUIET)
        # Two rounds of the ring with random steps and readings, so that refusals occur too.
        for sonar in (*range(16), *range(16)):
            step = rng.uniform(-1.0, 1.0, 2) * [1.0, 0.05]
            reading = float(rng.integers(10, 80))
            for method in (long, short):
                method.predict(*step.tolist())
            results = [method.update(sonar, 0.1, reading) for method in (long, short)]
            if config is CONES:
                assert results[0].refusal is results[1].refusal
            # The first six elements are pose and odometry parameters; the rest are offsets without variance.
            np.testing.assert_allclose(long.belief.mean[:6], short.belief.mean, rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(long.belief.cov[:6, :6], short.belief.cov, rtol=1e-7, atol=1e-12)
        # A predicted belief, without an update, agrees too.
        ahead = [method.predicted(2.0, 0.1) for method in (long, short)]
        np.testing.assert_allclose(ahead[0].mean[:6], ahead[1].mean)
        assert long.health.status is HealthStatus.OK


def range_of(state: np.ndarray[tuple[int], np.dtype[np.float64]], sonar: int, offset_rad: float) -> float:
    """A reading by the ray caster, from a whole state."""
    angle = state[2] + offset_rad + state[RING_TURN] + N150.sonar_angles_rad[sonar]
    far = cast_rays(state[:2], (np.cos(angle), np.sin(angle)), WORLD.walls)[0]
    return float(far) - N150.sonar_ring_radius_in + float(state[OFFSET] + state[OWN + sonar])


@pytest.mark.parametrize("sonar", [0, 3, 8, 13])
def test_the_gain_matches_finite_differences(sonar: int) -> None:
    # Standard deviations of the odometry parameters, the turn of the ring, the common offset and 16 own offsets.
    stds = (0.01, 0.01, 0.001, 0.3, 0.01, *(0.2,) * 16)
    method = CalibratingFilter(RAYS, START, stds)
    before, offset_rad = method.belief, 0.2
    # A reading 0.2 in longer than expected, well within the gate.
    expected = range_of(before.mean, sonar, offset_rad)
    assert method.update(sonar, offset_rad, expected + 0.2).refusal is Refusal.NONE
    # Central differences of the range function, 1e-6 in each element of the state.
    slope = np.array([
        (range_of(before.mean + change, sonar, offset_rad) - range_of(before.mean - change, sonar, offset_rad)) / 2e-6
        for change in 1e-6 * np.eye(SIZE)
    ])  # fmt: skip
    # K = P H' / S by the textbook, with S = H P H' + R.
    spread = slope @ before.cov @ slope + EXACT_RAYS.variance(np.array([expected]))[0]
    gain = before.cov @ slope / spread
    np.testing.assert_allclose(method.belief.mean - before.mean, gain * 0.2, rtol=1e-4, atol=1e-8)
    np.testing.assert_allclose(method.belief.cov, before.cov - np.outer(gain, gain) * spread, rtol=1e-4, atol=1e-8)


def test_the_aim_corrects_heading_and_ring_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """Conditioning on the sum, by the block formulas; the difference stays as it is."""
    aims: list[AimReading] = []

    def posterior(_: ConeAim, aim: AimReading) -> tuple[float, float]:
        aims.append(aim)
        return 0.01, 0.25

    monkeypatch.setattr(ConeAim, "posterior", posterior)
    method = CalibratingFilter(CONES, START)
    before = method.belief
    # 255 is no range, but the absence of an echo still says where the sonar points.
    assert method.update(3, 0.2, 255.0).refusal is Refusal.LIMIT
    assert aims[0].std_rad == pytest.approx(np.hypot(0.01, PARAMETER_STDS[4]))
    assert (aims[0].offset_rad, aims[0].reading_in) == (0.2, 255.0)
    # A row that selects heading plus turn of the ring: what the aim measures.
    sum_of = np.zeros(SIZE)
    sum_of[[2, RING_TURN]] = 1.0
    change = method.belief.mean - before.mean
    # The sum moves by the mean 0.01; heading and ring share it in proportion to their variances.
    assert sum_of @ change == pytest.approx(0.01)
    assert change[RING_TURN] / change[2] == pytest.approx(PARAMETER_STDS[4] ** 2 / 0.01**2)
    # The variance of the sum shrinks to the fraction 0.25; P changes along P h' only.
    assert sum_of @ method.belief.cov @ sum_of == pytest.approx(0.25 * sum_of @ before.cov @ sum_of)
    pull = before.cov @ sum_of
    np.testing.assert_allclose(
        method.belief.cov, before.cov - 0.75 * np.outer(pull, pull) / (sum_of @ pull), rtol=1e-9, atol=1e-15
    )
    method.update(3, 0.2, 40.0)
    assert aims[1].reading_in == pytest.approx(40.0)
    # 6 in is the lower limit of the sensor: no direction follows from it.
    method.update(3, 0.2, 6.0)
    assert len(aims) == 2
    # A certain heading and no ring angle to estimate: there is nothing to aim.
    sure = CalibratingFilter(CONES, independent([20.0, 50.0, 0.3], [0.2, 0.2, 0.0]), NOTHING_BESIDES)
    sure.update(3, 0.2, 40.0)
    assert len(aims) == 2


def test_readings_at_limits_or_off_the_map_are_refused() -> None:
    method = CalibratingFilter(RAYS, START, NOTHING_BESIDES)
    before = method.belief
    # The limits of the sensor are not ranges.
    for limit in (0.0, 6.0, 255.0):
        assert method.update(0, 0.0, limit).refusal is Refusal.LIMIT
    # A reading outside of the gate: 1.5 in too long, and one of no wall at all.
    assert method.update(0, 0.0, range_of(before.mean, 0, 0.0) + 1.5).refusal is Refusal.GATE
    assert method.update(0, 0.0, 200.0).refusal is Refusal.GATE
    np.testing.assert_array_equal(method.belief.mean, before.mean)
    np.testing.assert_array_equal(method.belief.cov, before.cov)
    cones = CalibratingFilter(CONES, START)
    assert cones.update(0, 0.0, 200.0).refusal is Refusal.GATE


@pytest.mark.long
def test_calibration_estimate_is_accurate_and_consistent() -> None:
    """A robot that circles with drawn errors, measured by exact rays: errors are as large as their std says."""
    off = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        stds = np.array(PARAMETER_STDS) * 0.5
        # The true state is drawn from the initial belief: only then are normalized errors standard normal.
        state = np.concatenate((START.mean + START.std * rng.standard_normal(3), stds * rng.standard_normal(21)))
        method = CalibratingFilter(RAYS, START, tuple(stds))
        for count in range(600):
            # Circles of radius 10 in, whose direction changes each full turn (126 steps of 0.05 rad).
            step = np.array([0.5, 0.05 if (count // 126) % 2 else -0.05])
            # The robot drives with its true errors and the noise of the filter's model.
            made = np.array([(1.0 + state[3]) * step[0], (1.0 + state[4]) * step[1] + state[5] * step[0]])
            noise = [QUIET.translation_std * 0.5**0.5, (QUIET.rotation_std**2 * 0.05 + QUIET.drift_std**2 * 0.5) ** 0.5]
            state[:3] = move(state[:3], made + noise * rng.standard_normal(2))
            method.predict(*step.tolist())
            # 5 and 16 have no common divisor: all sonars take part in turn.
            sonar = 5 * count % 16
            method.update(sonar, 0.0, float(np.floor(range_of(state, sonar, 0.0) + 0.5)))
        found, spread = calibration_in(method.belief), calibration_in(method.belief).spread
        # Common and own offset of a sonar cannot be separated; their sum is compared.
        true = state[OFFSET] + state[OWN:]
        off += [
            (found.distance_scale - 1.0 - state[3]) / spread.distance_scale,
            (found.turn_scale - 1.0 - state[4]) / spread.turn_scale,
            (found.drift_rad_in - state[5]) / spread.drift_rad_in,
            (found.turned_rad - state[RING_TURN]) / spread.turned_rad,
            *((np.array(found.offsets_in) - true) / spread.offsets_in),
        ]
        assert spread.distance_scale < 0.5 * stds[0]
        assert max(spread.offsets_in) < 0.2
    # The mean of squares of 4 x 20 standard normal numbers; correlations widen the interval.
    assert 0.5 < np.mean(np.square(off)) < 1.6


def test_table_has_every_parameter_with_its_std() -> None:
    lines = table(calibration_in(CalibratingFilter(RAYS, START).belief)).splitlines()
    assert len(lines) == 5 + 16
    row = ["distance,", "true", "/", "counted", "1.0000", "0.0500", "within", "noise", "of", "zero"]
    assert lines[1].split() == row
    assert lines[-1].split()[-6:] == ["0.00", "2.06", "within", "noise", "of", "zero"]
