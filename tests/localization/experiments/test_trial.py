"""The thesis' runs: their results, and a batch that depends on its seeds only."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from localization.experiments.figure_trial import (
    FIGURES,
    FigureSetup,
    Runs,
    Summary,
    draw_start_errors,
    figure_result,
    figure_setup,
    mean_band,
    run,
    summarize,
)
from localization.filters.belief import difference
from localization.filters.odometry import process_covariance, step_jacobians
from localization.filters.sonar_ray import ranges_from, wall_map
from localization.navigation.control_law import ControlGains, next_step

pytestmark = pytest.mark.long


def short_course(filtered: bool = True) -> FigureSetup:
    """The first inches of figure 5.4, at the speed of 5.6."""
    course = figure_setup(FIGURES["5.4"])
    return replace(course, goals_in=np.array([[8.0, 5.0], [3.0, 9.0]]), gains=FIGURES["5.6"].gains, filtered=filtered)


FAST = ControlGains(drho_max_in=0.2, dtheta_max_rad=0.2, alpha_rho=0.1, alpha_theta=0.1)
"""Four times the speed of all guided paths but 5.6, so that the tests are four times as short."""


def summary_of(name: str, seeds: int) -> Summary:
    figure = FIGURES[name]
    course = figure_setup(figure)
    if name != "5.6":
        course = replace(course, gains=FAST)
    return summarize(figure, figure_result(run(course, range(seeds)), figure.filtered).results)


@pytest.fixture(scope="module")
def with_filter() -> Summary:
    return summary_of("5.4", 100)


def test_the_filter_is_nearly_as_good_as_any_could_be(with_filter: Summary) -> None:
    assert with_filter["reached"] == 100
    assert with_filter["pcrb_position_in"] is not None
    # The posterior Cramer-Rao bound is the smallest error that any filter can have with these readings.
    assert 0.95 <= with_filter["rmse_position_in"] / with_filter["pcrb_position_in"] <= 1.15


def test_filter_is_consistent(with_filter: Summary) -> None:
    assert with_filter["nees_mean"] is not None
    # The mean NEES of three degrees of freedom over 100 runs: the quantiles of chi-square at 2.5 and 97.5 percent.
    assert 2.54 <= with_filter["nees_mean"] <= 3.50
    assert with_filter["nis_mean"] == pytest.approx(1.0, abs=0.03)


def test_without_the_filter_the_same_noise_leads_far_astray(with_filter: Summary) -> None:
    without = summary_of("5.2", 100)
    # The same noise without echoes: odometry alone is at least twenty times as far off.
    assert without["end_error_median_in"] >= 20 * with_filter["end_error_median_in"]


@pytest.mark.parametrize("name", ["5.6", "5.8", "5.9"])
def test_the_other_figures_arrive_and_stay_consistent(name: str) -> None:
    seeds = 30
    summary = summary_of(name, seeds)
    # For 30 runs the band is wider.
    low, high = mean_band(3, seeds, probability=0.999)
    assert summary["reached"] == seeds
    assert summary["nees_mean"] is not None
    assert low <= summary["nees_mean"] <= high
    assert summary["pcrb_position_in"] is not None
    assert summary["rmse_position_in"] <= 1.15 * summary["pcrb_position_in"]


def test_a_batch_is_its_seeds_to_the_bit() -> None:
    seeds, course = range(3), replace(short_course(), goals_in=short_course().goals_in[:1])
    whole = figure_result(run(course, seeds), filtered=True)
    for cut in (1, 2):
        parts = [
            figure_result(run(course, seeds[first : first + cut]), filtered=True) for first in range(0, 3, cut)
        ]
        # To the bit: no run depends on the others of its batch.
        assert [result for part in parts for result in part.results] == list(whole.results)


def at_end(runs: Runs, row: int) -> tuple[float, float]:
    """Distances of estimate and truth from the last goal after a robot's last step."""
    goal = short_course().goals_in[-1]
    last = runs.steps[row] - 1
    return math.dist(runs.mean[last, row, :2], goal), math.dist(runs.truth[last, row, :2], goal)


def test_the_estimate_arrives_and_stops_there() -> None:
    runs = run(short_course(), range(6))
    assert runs.reached.all()
    for row in range(6):
        assert at_end(runs, row)[0] <= 0.25
        assert math.dist(runs.mean[runs.steps[row] - 2, row, :2], short_course().goals_in[-1]) > 0.25
        assert (runs.truth[runs.steps[row] - 1 :, row] == runs.truth[runs.steps[row] - 1, row]).all()
    # Runs end after different numbers of steps.
    assert len(set(runs.steps.tolist())) > 1


def test_without_filter_odometry_steers_and_no_echo_is_used() -> None:
    runs = run(short_course(filtered=False), range(4))
    assert (runs.mean[:, 0] == runs.mean[:, 3]).all()
    assert (runs.truth[-1, 0] != runs.truth[-1, 3]).all()
    assert (runs.used == 0).all()


def test_both_ways_of_driving_have_the_same_motion_noise() -> None:
    """On the first step, where the commands differ only by the error of the first estimate."""
    filtered, blind = (run(short_course(filtered), range(5)) for filtered in (True, False))
    start = short_course().start
    ratio = difference(filtered.truth[0], start)[:, 0] / difference(blind.truth[0], start)[:, 0]
    assert ratio == pytest.approx(np.ones(5), abs=0.05)


def test_bound_is_evaluated_at_ground_truth() -> None:
    """One step by hand, in the form of information, from a start the filter is far wrong about."""
    course = replace(short_course(), start_std=(1.0, 1.0, 0.5))
    runs = run(course, [3])
    believed = course.start + course.start_std * draw_start_errors([3])[0]
    command = next_step(believed, course.goals_in[0], course.gains)
    F, G = step_jacobians(course.start, command)
    Q = process_covariance(G, command, course.noise)
    prior = F @ np.diag(np.square(course.start_std)) @ F.T + Q
    beams = ranges_from(runs.truth[0, 0], course.angles_rad, course.body, course.walls)
    H = np.stack(beams.H, axis=-1)
    # Information form: H' R^-1 H is added to the inverse of the predicted covariance.
    information = H.T @ np.diag(1 / course.sonar.variance(beams.range_in)) @ H
    assert runs.bound[0, 0] == pytest.approx(np.linalg.inv(np.linalg.inv(prior) + information), rel=1e-6)


def test_without_walls_filter_equals_odometry() -> None:
    course = replace(short_course(), walls=wall_map(np.empty((0, 4))), start_std=(2.0, 3.0, 0.1))
    runs = run(course, range(300))
    first = difference(runs.mean[0], runs.truth[0])
    # A standard deviation of 300 runs has an error of about 4 percent.
    assert first.std(axis=0) == pytest.approx([2.0, 3.0, 0.1], rel=0.15)
    assert (runs.used == 0).all()
    assert runs.cov[0, 0] == pytest.approx(runs.bound[0, 0], abs=0.1)
    assert np.isfinite(runs.bound).all()


def test_without_the_filter_the_start_is_known_exactly() -> None:
    course = replace(short_course(filtered=False), start_std=(2.0, 3.0, 0.1))
    runs = run(course, range(5))
    assert np.abs(difference(runs.mean[0], runs.truth[0])).max() < 0.5


def test_a_run_that_never_arrives_ends_and_is_not_counted() -> None:
    # A turn per step that is too small for the goal: the robot circles around it.
    circling = replace(short_course(), gains=ControlGains(0.5, 0.001, 0.08, 0.8), goals_in=np.array([[0.0, 5.0]]))
    runs = run(circling, range(3))
    assert not runs.reached.any()
    assert runs.steps.tolist() == [circling.max_steps] * 3
    assert len(runs.truth) == circling.max_steps


def test_each_step_is_reported_with_the_robots_that_took_it() -> None:
    output: list[int] = []
    runs = run(short_course(), range(4), output.append)
    assert sum(output) == runs.steps.sum()
    assert len(output) == runs.steps.max()
    assert output == sorted(output, reverse=True)
