"""Trajectories in the TUM format, read back as its users do."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from localization.experiments import live as live_command
from localization.experiments.live_trial import TrialJob, run, trials


def test_a_line_is_time_metres_and_a_unit_quaternion() -> None:
    text = live_command.lines(np.array([1.5, 2.0]), np.array([[100.0, -50.0, np.pi / 2], [0.0, 0.0, -3.0]]))
    first, second = (np.array(line.split(), dtype=float) for line in text.splitlines())
    # 100 in = 2.54 m; a heading of 90 degrees is the quaternion z = w = sqrt(1/2).
    np.testing.assert_allclose(first, [1.5, 2.54, -1.27, 0, 0, 0, np.sqrt(0.5), np.sqrt(0.5)], atol=1e-9)
    assert np.isclose(2.0 * np.arctan2(second[6], second[7]), -3.0)


def test_a_trial_has_three_paths_of_the_same_instants(tmp_path: Path) -> None:
    (trial,) = trials(["exact"], ["5.4"], ["ekf"], 1, 12)
    record = run(TrialJob(trial, whole=True)).record
    assert record is not None
    live_command.write_tum(tmp_path / "new", trial, record)
    files = live_command.paths(tmp_path / "new", trial)
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == sorted(path.name for path in files.values())
    truth, odometry, estimate = (np.loadtxt(files[name]) for name in ("truth", "odometry", "estimate"))
    assert truth.shape == odometry.shape == estimate.shape == (12, 8)
    assert (truth[:, 0] == estimate[:, 0]).all()
    np.testing.assert_allclose((estimate - truth)[:, 1:3] / 0.0254, record.error[:, :2], atol=1e-6)
