"""Nodes, odometry between them, and echoes of a drive."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from localization.filters.belief import Belief, Floats, compose, rotate, wrap_angle
from localization.filters.odometry import OdometryNoise, predict, step_between
from localization.filters.sonar_cone import ConeSonar
from localization.mapping.measurements import DriveLog, Steps, build_trajectory, integrate_odometry, read_drive
from localization.mapping.problem import sensors_at
from nclient.cli import main
from nclient.errors import RecordingError
from tests.localization.mapping.drives import drive, echo

NOISE = OdometryNoise(0.05, 0.05, 0.002)


def test_steps_lead_along_the_encoders() -> None:
    log = drive(1)
    instants = np.array([0.33, 1.0, 1.77, 9.4, 9.5, 30.0])
    steps, _, _ = integrate_odometry(log, np.stack((instants[:-1], instants[1:]), axis=-1), NOISE)
    poses = log.poses_at(instants)[:, :3]
    for before, step, after in zip(poses[:-1], steps, poses[1:], strict=True):
        found = compose(before, step)
        # What lies across each part's middle heading is left out.
        np.testing.assert_allclose(found[:2], after[:2], atol=0.02)
        assert wrap_angle(found[2] - after[2]) == pytest.approx(0.0, abs=1e-9)


def test_covariance_and_derivative_are_the_filter_s_prediction() -> None:
    log = drive(2)
    instants = np.array([3.0, 9.7])
    _, covariance, by_parameters = integrate_odometry(log, np.stack((instants[:-1], instants[1:]), axis=-1), NOISE)
    # The extended Kalman filter over the same encoder poses; the parameters' covariance gives the derivative.
    times = np.concatenate((instants[:1], log.encoders[(log.encoders[:, 0] > 3.0) & (log.encoders[:, 0] < 9.7), 0],
                            instants[1:]))  # fmt: skip
    poses = log.poses_at(times)[:, :3]
    stds = np.array([0.0, 0.0, 0.0, 1e-2, 1e-2, 1e-3])
    belief = Belief(np.zeros(6), np.diag(stds**2))
    for before, after in pairwise(poses):
        belief = predict(belief, step_between(before, after), NOISE)
    J = belief.cov[:3, 3:] / stds[3:] ** 2
    np.testing.assert_allclose(by_parameters[0], J, rtol=1e-6, atol=1e-9)
    quantization = np.diag(np.square([0.04, 0.04, 0.001]))
    own = belief.cov[:3, :3] - J @ np.diag(stds[3:] ** 2) @ J.T
    np.testing.assert_allclose(covariance[0], own + quantization, rtol=1e-6, atol=1e-9)


def sideways_drive() -> DriveLog:
    """Return a drive in all directions, whatever its heading, with a pose each 0.1 s."""
    rng, clock = np.random.default_rng(5), np.arange(0.0, 5.0, 0.1)
    poses = np.cumsum(rng.normal(0.0, (1.0, 1.0, 0.1), (len(clock), 3)), axis=0)
    encoders = np.column_stack((clock, poses, poses[:, 2]))
    return replace(drive(1), encoders=encoders, is_omnidirectional=True)


def test_sideways_steps_lead_along_the_poses() -> None:
    log = sideways_drive()
    instants = np.array([0.33, 1.0, 1.77, 4.6])
    steps, _, _ = integrate_odometry(log, np.stack((instants[:-1], instants[1:]), axis=-1), NOISE)
    poses = log.poses_at(instants)[:, :3]
    for before, step, after in zip(poses[:-1], steps, poses[1:], strict=True):
        found = compose(before, step)
        np.testing.assert_allclose(found[:2], after[:2], atol=1e-9)
        assert wrap_angle(found[2] - after[2]) == pytest.approx(0.0, abs=1e-9)


def test_derivative_of_sideways_steps_is_a_finite_difference() -> None:
    log, small = sideways_drive(), 1e-6
    poses = log.encoders[10:31, 1:4]
    _, _, by_parameters = integrate_odometry(log, log.encoders[[10, 30], 0][None], NOISE)

    def end(scale: float, turn_scale: float, drift: float) -> Floats:
        pose = np.zeros(3)
        for before, after in pairwise(poses):
            local = rotate(after[:2] - before[:2], -before[2]) * (1.0 + scale)
            turn = (after[2] - before[2]) * (1.0 + turn_scale) + drift * np.hypot(*(after[:2] - before[:2]))
            pose = compose(pose, np.array((*local, turn)))
        return pose

    expected = np.stack([(end(*row) - end(*-row)) / (2.0 * small) for row in small * np.eye(3)], axis=-1)
    np.testing.assert_allclose(by_parameters[0], expected, atol=1e-6)


def test_sideways_steps_are_as_uncertain_across_as_along() -> None:
    log = sideways_drive()
    encoders = log.encoders.copy()
    encoders[:, 1:] = 0.0
    encoders[:, 2] = np.arange(len(encoders))  # 1 in to the left in each row
    noise = OdometryNoise(0.3, 0.0, 0.01)
    _, covariance, _ = integrate_odometry(replace(log, encoders=encoders), encoders[[0, 20], 0][None], noise)
    # Random walks: 20 steps; the heading's, after each step, moves the rest of the path along x.
    lever = sum((20.0 - step) ** 2 for step in range(1, 21))
    expected = np.diag((0.3**2 * 20.0 + 0.01**2 * lever, 0.3**2 * 20.0, 0.01**2 * 20.0))
    expected += np.diag(np.square([0.04, 0.04, 0.001]))
    np.testing.assert_allclose(np.diag(covariance[0]), np.diag(expected), rtol=1e-9)


def test_echoes_are_measured_where_their_sonars_are() -> None:
    log = drive(quiet=True)
    trajectory = build_trajectory(log, NOISE, ConeSonar(), 0.15)
    # The true frame: the encoders began at (-3, 7, 0.4) where the robot was at (25, 25, 0).
    poses = trajectory.odometry - np.array((-3.0, 7.0, 0.4))
    places = rotate(poses[:, :2], np.full(len(poses), -0.4)) + 25.0
    true = np.concatenate((places, poses[:, 2:]), axis=-1)
    sensors = sensors_at(true, np.zeros(20), trajectory, slice(None))
    expected = [echo(x, y, axis) for (x, y), axis in zip(sensors.face.tolist(), sensors.axis.tolist(), strict=True)]
    off = np.abs(np.array(expected) - trajectory.readings_in)
    # An echo at the very edge of a cone may differ.
    assert np.mean(off < 0.02) > 0.99


def test_nodes_at_which_the_robot_stands_are_left_out() -> None:
    log = drive(quiet=True)
    moving = build_trajectory(log, NOISE, ConeSonar(), 0.15)
    # The last row again for 30 s more, with readings of the same pose.
    last, clock = log.encoders[-1], log.encoders[-1, 0]
    rows = np.repeat(last[None], 300, axis=0)
    rows[:, 0] += np.arange(1, 301) * 0.1
    log.encoders.flags.writeable = False
    standing = type(log)(
        np.concatenate((log.encoders, rows)), np.concatenate((log.instants_s, clock + np.arange(1, 400) * 0.07)),
        np.concatenate((log.sonars, np.arange(399) % 16)), np.concatenate((log.readings_in, np.full(399, 40.0))),
        log.angles_rad, log.ring_radius_in,
    )  # fmt: skip
    assert len(build_trajectory(standing, NOISE, ConeSonar(), 0.15)) <= len(moving) + 2


def test_recording_without_a_restart_of_the_ring_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "state.log"
    assert main.main(["state", f"sim:thesis_room?record={path}"]) == 0
    capsys.readouterr()
    with pytest.raises(RecordingError, match="conf_sn"):
        read_drive(path)


def test_odometry_that_was_integrated_before_is_used_again() -> None:
    log, known = drive(), Steps()
    whole = build_trajectory(log, NOISE, ConeSonar(), 0.15)
    part = replace(log, instants_s=log.instants_s[:400], sonars=log.sonars[:400], readings_in=log.readings_in[:400])
    build_trajectory(part, NOISE, ConeSonar(), 0.15, known)
    before = len(known)
    again = build_trajectory(log, NOISE, ConeSonar(), 0.15, known)
    assert 0 < before < len(known)
    np.testing.assert_array_equal(again.steps, whole.steps)
    np.testing.assert_array_equal(again.step_info, whole.step_info)
    np.testing.assert_array_equal(again.step_by_parameters, whole.step_by_parameters)


def test_rays_of_a_robot_that_turns_are_uncertain_as_its_heading() -> None:
    log = drive(quiet=True)
    cones, rays = (build_trajectory(log, NOISE, ConeSonar(), 0.15, rays=rays) for rays in (False, True))
    added = np.sqrt(np.square(rays.std_in) - np.square(cones.std_in)) / rays.readings_in
    # 1. It turns with 0.5 rad/s; the last of 8 readings of 0.06 s each is 0.21 s after their mean: 0.105 rad.
    heading = np.unwrap(log.poses_at(rays.instants_s + np.array([[-0.25], [0.25]]))[..., 2], axis=0)
    turns = np.abs(heading[1] - heading[0]) > 0.249
    assert turns.sum() > 3
    assert added[turns[rays.node]].max() == pytest.approx(0.05 * 0.105**0.5, rel=0.01)
    # 2. Straight on, it has rolled 1.05 in.
    straight = np.abs(heading[1] - heading[0]) < 1e-9
    assert added[straight[rays.node]].max() == pytest.approx(0.002 * 1.05**0.5, rel=0.01)
