"""Results of a live run, with and without ground truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from localization.filters.belief import independent
from localization.filters.health import FilterHealth, HealthStatus
from localization.filters.update import Refusal
from localization.live.estimate import Echo, Estimate
from localization.live.run import Run, RunMoment, TruthSample

ECHOES = (
    Echo(0, 0.1, 40, Refusal.NONE, 0.2),
    Echo(2, 0.2, 255, Refusal.LIMIT, 0.0),
    Echo(15, 0.3, 12, Refusal.GATE, 0.0),
    Echo(1, 0.4, 255, Refusal.LIMIT, 0.0),
)


def run(with_truth: bool) -> Run:
    done = Run([(0.0, 0.0), (3.0, 4.0)])
    for k, (x, y, heading) in enumerate([(0.0, 0.0, 0.0), (3.0, 4.0, 3.1)]):
        belief = independent([x, y, heading], [0.1, 0.2, 0.01])
        # 0.3 and 0.4 in off: a distance of 0.5 in. Odometry is 1.0 in off the truth in x.
        truth = (x + 0.3, y - 0.4, heading + 0.1) if with_truth else None
        done.add(RunMoment(Estimate(10.0 + k, belief, ECHOES), (x + 1.3, y - 0.4, heading), truth, k + 1))
    return done


def test_errors_are_distances_to_the_truth() -> None:
    done = run(with_truth=True)
    assert done.errors_in() == pytest.approx([0.5, 0.5])
    assert done.odometry_errors_in() == pytest.approx([1.0, 1.0])
    error = done.moments[-1].error
    assert error is not None
    assert error == pytest.approx([-0.3, 0.4, -0.1])


def test_summary_counts_echoes_by_result() -> None:
    summary = run(with_truth=True).summary()
    assert summary["echoes_used"] == 2
    assert summary["echoes_refused"] == {"limit": 4, "gate": 2}
    assert (summary["waypoints"], summary["reached"], summary["duration_s"]) == (2, 2, 1.0)
    assert summary["end_error_in"] == pytest.approx(0.5)
    assert summary["rmse_position_in"] == pytest.approx(0.5)
    assert summary["odometry_end_error_in"] == pytest.approx(1.0)
    assert summary["truth_frame"] == "world"
    assert summary["estimate"] == pytest.approx([3.0, 4.0, 3.1])


@pytest.mark.parametrize("size_in", [40.0, 4.0])
def test_true_path_is_fitted_on_a_map_with_a_frame_of_its_own(size_in: float) -> None:
    """True path and estimates differ by a turn, a shift, and 0.2 in to both sides at the corners of a square."""
    done, turn = Run([], has_own_frame=True), math.radians(150.0)
    for row, (x, y) in enumerate(((0.0, 0.0), (size_in, 0.0), (size_in, size_in), (0.0, size_in))):
        place = 7.0 + x * math.cos(turn) - y * math.sin(turn), -2.0 + x * math.sin(turn) + y * math.cos(turn)
        # No rigid motion takes a part of these away.
        belief = independent([x + 0.2 * (-1) ** row, y, math.radians(60.0)], [0.1, 0.1, 0.01])
        truth = (*place, math.radians(-150.0 + row))
        done.add(RunMoment(Estimate(float(row), belief, ()), (x, y + 1.0, 0.0), truth, 0))
    # While the robot drives the frame is not known.
    assert "truth" not in done.line()
    done.fit_truth()
    summary = done.summary()
    if size_in == 4.0:
        # Any path of a robot that has hardly moved fits.
        assert (summary["truth"], summary["truth_frame"], summary["rmse_position_in"]) == (None, None, None)
        return
    assert done.errors_in() == pytest.approx([0.2] * 4, abs=1e-9)
    assert done.odometry_errors_in() == pytest.approx([1.0] * 4, abs=1e-9)
    assert summary["truth"] == pytest.approx([0.0, size_in, math.radians(63.0)], abs=1e-9)
    assert summary["truth_frame"] == "fitted"
    assert "truth (   0.00,   40.00)  off 0.20 in -3.00 deg" in done.line()
    assert "these errors are from the true path as it fits best: the map has a frame of its own" in done.verdict()


@pytest.mark.parametrize("with_truth", [False, True])
def test_without_estimates_to_fit_to_there_is_no_truth(with_truth: bool) -> None:
    done = run(with_truth)
    done.has_own_frame = True
    if with_truth:
        health = FilterHealth(HealthStatus.LOST, "2 places look alike")
        done.moments = [
            moment._replace(estimate=moment.estimate._replace(health=health)) for moment in done.moments
        ]  # fmt: skip
    done.fit_truth()
    summary = done.summary()
    assert (summary["truth"], summary["truth_frame"]) == (None, None)


def test_without_a_truth_nothing_is_made_up() -> None:
    done = run(with_truth=False)
    summary = done.summary()
    unknown = ("truth", "end_error_in", "rmse_position_in", "odometry_end_error_in", "truth_frame")
    assert [summary[key] for key in unknown] == [None] * 5
    assert "truth" not in done.line()
    assert "off at the end" not in done.verdict()


def test_the_line_reports_estimate_spread_truth_and_error() -> None:
    line = run(with_truth=True).line()
    assert "estimate (   3.00,    4.00) in" in line
    assert f"{math.degrees(3.1):.2f} deg" in line
    assert "± 0.20 in 0.57 deg" in line
    assert "truth (   3.30,    3.60)  off 0.50 in -5.73 deg" in line


def test_the_verdict_reports_goals_echoes_and_errors() -> None:
    verdict = run(with_truth=True).verdict()
    assert "2 of 2 waypoints reached in 1.0 s; 2 echoes used, 6 refused" in verdict
    assert "the estimate is 0.50 in off at the end (RMSE 0.50 in); odometry alone is 1.00 in off" in verdict


def test_a_run_that_has_not_begun_has_reached_nothing() -> None:
    done = Run([(1.0, 1.0)])
    assert (done.reached, done.duration_s) == (0, 0.0)
    assert np.size(done.errors_in()) == 0


@pytest.mark.parametrize("late_s", [0.0, 0.05, 0.2])
def test_late_truth_is_interpolated_at_estimate_time(late_s: float) -> None:
    speed, turn = 5.0, 0.4

    # Constant speed and turn, with a heading that wraps during the motion.
    def true_pose(clock_s: float) -> tuple[float, float, float]:
        return speed * clock_s, 3.0, (3.0 + turn * clock_s + math.pi) % math.tau - math.pi

    # Truth is sampled before and after the time of the estimate.
    before = TruthSample(1.0 + late_s, true_pose(1.0 + late_s))
    after = TruthSample(1.3 + late_s, true_pose(1.3 + late_s))
    x, y, heading = before.interpolate(after, 1.3)
    assert (x, y) == pytest.approx(true_pose(1.3)[:2])
    assert math.remainder(heading - true_pose(1.3)[2], math.tau) == pytest.approx(0.0, abs=1e-12)


def test_beyond_two_sightings_nothing_is_made_up() -> None:
    first, second = TruthSample(1.0, (0.0, 0.0, 0.0)), TruthSample(2.0, (1.0, 1.0, 0.5))
    assert first.interpolate(second, 0.5) == pytest.approx(first.pose)
    assert first.interpolate(second, 3.0) == pytest.approx(second.pose)
    assert first.interpolate(first, 1.0) == pytest.approx(first.pose)


def test_rare_states_are_reported() -> None:
    done = run(with_truth=True)
    assert done.longest_gap_s == pytest.approx(1.0)
    assert "run the simulation slower" in done.verdict()
    assert Run([]).longest_gap_s == 0.0
