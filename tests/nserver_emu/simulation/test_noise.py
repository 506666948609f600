"""Noise against its own formula: spread, independence of the cut, streams that repeat and do not mix."""

from __future__ import annotations

import numpy as np
import pytest

from nserver_emu.simulation.noise import Purpose, RngFactory
from nserver_emu.simulation.odometry import MotionNoise
from nserver_emu.simulation.segments import ConstantAccelerationSegment

NOISE = MotionNoise.walk(along=0.1, turn=0.1, drift=0.005)


def strays(segment: ConstantAccelerationSegment, draws: int, pieces: int = 1) -> np.ndarray:
    """Return the deviations (draws, 2) of distance and turn of a segment driven in equal pieces."""
    rng = np.random.default_rng(7)
    # The same segment as a whole or in pieces.
    piece = segment._replace(duration_s=segment.duration_s / pieces)
    result = np.zeros((draws, 2))
    for draw in range(draws):
        for _ in range(pieces):
            disturbed = NOISE.disturbed(piece, rng)
            time = piece.duration_s
            result[draw] += (
                disturbed.distance_at(time) - piece.distance_at(time),
                disturbed.turn_at(time) - piece.turn_at(time),
            )
    return result


@pytest.mark.long
@pytest.mark.parametrize("pieces", [1, 5])
def test_variances_grow_with_distance_and_turn(pieces: int) -> None:
    distance, turn, draws = 10.0, -0.6, 4000
    found = strays(ConstantAccelerationSegment(2.0, distance / 2.0, 0.0, turn / 2.0, 0.0), draws, pieces)
    expected = np.array([0.1**2 * distance, 0.1**2 * abs(turn) + 0.005**2 * distance])
    error_of_variance = np.sqrt(2.0 / draws)
    np.testing.assert_allclose(found.var(axis=0) / expected, 1.0, atol=4.0 * error_of_variance)
    assert np.all(np.abs(found.mean(axis=0)) < 4.0 * np.sqrt(expected / draws))
    assert abs(np.corrcoef(found.T)[0, 1]) < 4.0 / np.sqrt(draws)


def test_steering_on_the_spot_turns_the_body_only() -> None:
    found = strays(ConstantAccelerationSegment(1.0, 0.0, 0.0, 0.5, 0.0), 2000)
    assert not found[:, 0].any()
    assert found[:, 1].var() == pytest.approx(0.01 * 0.5, rel=0.15)


def test_the_settings_of_the_experiments_as_alphas() -> None:
    assert MotionNoise.walk(along=0.1, turn=0.2, drift=0.005) == MotionNoise(0.2**2, 0.005**2, 0.1**2, 0.0)


@pytest.mark.parametrize(("distance", "turn"), [(8.0, 0.6), (0.0, -0.6), (-8.0, 0.0)])
def test_each_alpha_has_its_role(distance: float, turn: float) -> None:
    alphas, draws, rng = MotionNoise(0.01, 0.002, 0.03, 0.5), 4000, np.random.default_rng(5)
    segment = ConstantAccelerationSegment(2.0, distance / 2.0, 0.0, turn / 2.0, 0.0)
    disturbed = [alphas.disturbed(segment, rng) for _ in range(draws)]
    distances, turns = [one.distance_at(2.0) for one in disturbed], [one.turn_at(2.0) for one in disturbed]
    error_of_variance = 4.0 * np.sqrt(2.0 / draws)
    assert np.var(turns) == pytest.approx(0.01 * abs(turn) + 0.002 * abs(distance), rel=error_of_variance)
    assert np.var(distances) == pytest.approx(0.03 * abs(distance) + 0.5 * abs(turn), rel=error_of_variance)


def test_an_accelerated_segment_keeps_duration_and_shape() -> None:
    segment = ConstantAccelerationSegment(0.5, 2.0, 8.0, 0.1, 0.2)
    disturbed = NOISE.disturbed(segment, np.random.default_rng(1))
    assert disturbed.duration_s == 0.5
    assert disturbed.acceleration / disturbed.speed == pytest.approx(4.0)
    assert disturbed.turn_acceleration == 0.2


def test_rest_and_no_noise_change_nothing() -> None:
    rng = np.random.default_rng(3)
    before = rng.bit_generator.state
    rest = ConstantAccelerationSegment(1.0, 0.0, 0.0, 0.0, 0.0)
    assert NOISE.disturbed(rest, rng) is rest
    moving = ConstantAccelerationSegment(1.0, 5.0, 0.0, 0.2, 0.0)
    assert MotionNoise().disturbed(moving, rng) is moving
    assert rng.bit_generator.state == before


def test_streams_repeat_and_do_not_mix() -> None:
    keys = [(robot, seed, purpose) for robot in (1, 2) for seed in (0, 1) for purpose in Purpose]
    heads = [tuple(RngFactory(robot, seed).stream(purpose).standard_normal(4)) for robot, seed, purpose in keys]
    assert len(set(heads)) == len(keys)
    assert tuple(RngFactory(1, 0).stream(Purpose.MOTION).standard_normal(4)) == heads[0]
