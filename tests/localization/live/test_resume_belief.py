"""Resuming a saved belief: its consistency over random paths, and refusals with the remedy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from localization.filters.belief import difference, independent
from localization.filters.odometry import OdometryNoise, move, step_between, step_variance
from localization.live.estimate import SavedEstimate, encoder_std, map_signature, resume_belief
from localization.live.sensor_input import EncoderPose
from nclient.errors import EstimateFileError
from worlds.io import load_world
from worlds.world import Polygon

NOISE = OdometryNoise(0.05, 0.05, 0.002)
SITE = map_signature(load_world("thesis_room"), "n150")


def encoders(x: float, y: float, heading: float, clock_s: float = 100.0) -> EncoderPose:
    return EncoderPose.of(clock_s, np.array([x, y, heading]), heading)


SAVED = SavedEstimate(SITE, encoders(10.0, 20.0, 0.3), independent([11.0, 19.0, 0.4, 0.02], [0.2, 0.1, 0.01, 0.005]))


def test_unmoved_robot_keeps_its_belief() -> None:
    resumed = resume_belief(SAVED, SITE, encoders(10.1, 20.0, 0.3017, 200.0), NOISE)
    assert (resumed.mean == SAVED.belief.mean).all()
    assert (resumed.cov == SAVED.belief.cov).all()


@pytest.mark.long
def test_driven_robot_has_consistent_belief() -> None:
    """Out and home again by random winding paths: the truth lies as the covariance states, or nearer."""
    rng = np.random.default_rng(5)
    off = []
    for _ in range(300):
        # The truth is drawn from the saved belief, then both move with the same steps.
        odometry, true = SAVED.encoders.pose, np.array([11.0, 19.0, 0.4]) + [0.2, 0.1, 0.01] * rng.standard_normal(3)
        for _ in range(12):
            step = np.array([rng.uniform(0.0, 2.0), rng.uniform(-0.5, 0.5)])
            true = move(true, step + np.sqrt(step_variance(step, NOISE)) * rng.standard_normal(2))
            odometry = move(odometry, step)
        # 200 s later, as the encoders report it.
        resumed = resume_belief(SAVED, SITE, EncoderPose.of(200.0, odometry, 0.0), NOISE)
        error = difference(resumed.mean[:3], true)
        off.append(error @ np.linalg.solve(resumed.cov[:3, :3], error))
    # NEES of three degrees of freedom: mean 3 at most; 11.34 is the 99 % quantile.
    assert 0.2 < np.mean(off) < 3.3
    assert np.mean(np.array(off) < 11.34) > 0.97


def test_encoder_frame_may_differ_from_map_frame() -> None:
    """The same drive reported in the encoders' frame and turned into the map's."""
    step = np.array([8.0, 0.6])
    resumed = resume_belief(SAVED, SITE, EncoderPose.of(200.0, move(SAVED.encoders.pose, step), 0.0), NOISE)
    np.testing.assert_allclose(step_between(SAVED.belief.mean[:3], resumed.mean[:3]), step)
    assert resumed.mean[3] == 0.02
    assert (resumed.std[:3] > SAVED.belief.std[:3]).all()
    assert resumed.std[3] == SAVED.belief.std[3]
    np.testing.assert_allclose(resumed.cov, resumed.cov.T)


def test_walls_in_another_order_are_the_same_map() -> None:
    room = load_world("thesis_room")
    (outline,) = room.rooms
    turned = replace(room, rooms=(Polygon(outline.corners_in[::-1], outline.name),))
    assert map_signature(turned, "n150") == SITE
    larger = replace(room, rooms=(Polygon(tuple((x * 1.001, y) for x, y in outline.corners_in)),))
    assert map_signature(larger, "n150").walls != SITE.walls


@pytest.mark.parametrize(
    ("now", "expected"),
    [
        # The clock is behind the saved one: the robot was restarted.
        (encoders(10.0, 20.0, 0.3, 50.0), "clock went back.*--displacement-std"),
        (encoders(0.0, 0.0, 0.0, 900.0), r"set meanwhile.*\(0.0, 0.0\).*\(10.0, 20.0\).*--displacement-std"),
        # 50 in within a second: no robot is that fast.
        (encoders(60.0, 20.0, 0.3, 101.0), "set meanwhile"),
        (encoders(90.0, 20.0, 0.3, 900.0), "driven 80 in away.*omit --resume"),
    ],
)
def test_unusable_encoders_are_refused(now: EncoderPose, expected: str) -> None:
    with pytest.raises(EstimateFileError, match=expected):
        resume_belief(SAVED, SITE, now, NOISE)


@pytest.mark.parametrize("now", [encoders(10.0, 20.0, 0.3, 50.0), encoders(0.0, 0.0, 0.0, 900.0)])
def test_displacement_std_is_added_to_saved_belief(now: EncoderPose) -> None:
    resumed = resume_belief(SAVED, SITE, now, NOISE, (0.3, 0.4, 0.02))
    assert (resumed.mean == SAVED.belief.mean).all()
    np.testing.assert_allclose(resumed.std[:3] ** 2, SAVED.belief.std[:3] ** 2 + np.square([0.3, 0.4, 0.02]))


def test_displacement_std_is_added_after_driven_step() -> None:
    now = EncoderPose.of(200.0, move(SAVED.encoders.pose, np.array([8.0, 0.6])), 0.0)
    driven, moved = (resume_belief(SAVED, SITE, now, NOISE, std) for std in (None, (1.0, 1.0, 0.1)))
    assert (moved.mean == driven.mean).all()
    np.testing.assert_allclose(moved.std[:3] ** 2, driven.std[:3] ** 2 + np.square([1.0, 1.0, 0.1]))


def test_another_map_or_robot_is_refused() -> None:
    now = SAVED.encoders
    with pytest.raises(EstimateFileError, match=r"thesis_room.*several_walls.*--map thesis_room"):
        resume_belief(SAVED, map_signature(load_world("several_walls"), "n150"), now, NOISE)
    with pytest.raises(EstimateFileError, match=r"n150.*scout.*--body n150"):
        resume_belief(SAVED, SITE._replace(body="scout"), now, NOISE)


def test_encoders_are_as_wide_as_a_resumed_estimate_of_the_start() -> None:
    """The same displacement from a start of the map and from a saved estimate there."""
    known = np.array([[100.0, 0.0, 0.0], [10.0, 20.0, 0.3]])
    std, driven_in = encoder_std(np.array([40.0, 20.0, 0.8]), known, np.zeros(3), NOISE)
    saved = SavedEstimate(SITE, encoders(10.0, 20.0, 0.3), independent([10.0, 20.0, 0.3], [0.0, 0.0, 0.0]))
    resumed = resume_belief(saved, SITE, encoders(40.0, 20.0, 0.8, 200.0), NOISE)
    assert driven_in == pytest.approx(30.0)
    np.testing.assert_allclose(std, resumed.std)


def test_encoders_at_a_start_have_not_driven() -> None:
    std, driven_in = encoder_std(np.array([10.0, 20.0, 0.3]), np.array([[10.1, 20.0, 0.3]]), np.full(3, 0.1), NOISE)
    assert (std.tolist(), driven_in) == ([0.1, 0.1, 0.1], 0.0)
    # Beside it, or turned, it may have driven a round.
    for now in ([10.0, 20.5, 0.3], [10.0, 20.0, 0.31]):
        std, driven_in = encoder_std(np.array(now), np.array([[10.0, 20.0, 0.3]]), np.full(3, 0.1), NOISE)
        assert driven_in == 24.0
        assert std[0] > 2.0
