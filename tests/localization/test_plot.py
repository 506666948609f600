"""Recorded runs and their plots; the example of an own filter on the same drive as the built-in one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from localization import plot
from localization.filters.base import LocalizationConfig
from localization.filters.belief import independent
from localization.filters.registry import make
from localization.live.localizer import Estimate, Localizer
from localization.live.run import Run, RunMoment, TruthSample
from localization.live.sensor_input import restart_ring
from localization.navigation.waypoints import record_run
from nclient import connect
from tests.docs.pages import ROOT
from worlds.io import load_world
from worlds.robots import BODIES

ROOM = load_world("thesis_room")
CONFIG = LocalizationConfig(ROOM.walls, BODIES["n150"])
OWN = f"{ROOT}/examples/own_filter.py:MyFilter"


@pytest.fixture(scope="module")
def run() -> Run:
    with connect("sim:thesis_room?noisy=1&seed=3") as robot:
        return record_run(robot, CONFIG, [(0.0, 0.0), (30.0, 15.0)])


@pytest.mark.long
def test_recorded_run_reaches_its_waypoints_with_truth(run: Run) -> None:
    assert run.reached == 2
    assert run.errors_in().max() < 1.0
    assert len(run.errors_in()) == len(run.moments)


def test_nees_is_that_of_the_definition(run: Run) -> None:
    values = plot.nees_values(run)
    moment = run.moments[7]
    assert moment.error is not None
    # The definition of NEES: e' P^-1 e.
    expected = moment.error @ np.linalg.inv(moment.estimate.belief.cov[:3, :3]) @ moment.error
    assert values[7] == pytest.approx(expected)


def test_plots_show_numbers_and_notebooks_show_plots(run: Run) -> None:
    pictures = [plot.trajectory(run, ROOM), plot.errors(run), plot.innovations(run), plot.nees(run)]
    titles = [picture.axes[0].get_title() for picture in pictures]
    assert f"mean NEES {plot.nees_values(run).mean():.2f}" in titles[3]
    assert [("waypoints" in titles[0]), ("%" in titles[1]), ("NIS" in titles[2])] == [True] * 3
    assert pictures[3]._repr_png_().startswith(b"\x89PNG")  # type: ignore[attr-defined]


@pytest.mark.long
def test_runs_without_truth_have_gaps(run: Run) -> None:
    blind = Run([], [moment._replace(truth=None) for moment in run.moments])
    assert np.isnan(plot.nees_values(blind)).all()
    assert plot.nees(blind).axes[0].get_title() == plot.errors(blind).axes[0].get_title() == "no ground truth"
    silent = Run([], [moment._replace(estimate=moment.estimate._replace(echoes=())) for moment in run.moments])
    assert plot.innovations(silent).axes[0].get_title() == "no echo was used"
    assert plot.trajectory(blind, ROOM).axes


@pytest.mark.long
def test_example_is_as_good_as_the_built_in_filter() -> None:
    # Both filters get the same states of one drive, so that the comparison has no noise of its own.
    runs: dict[str, Run] = {name: Run([]) for name in ("ekf", OWN)}
    with connect("sim:thesis_room?noisy=1&seed=3&step_s=0.1") as robot:
        schedule, state = restart_ring(robot, CONFIG.body.ring)
        start = independent([state.x_in, state.y_in, state.steering_rad], [0.1, 0.1, 0.01])
        localizers = {name: Localizer(CONFIG, start, schedule, make(name, CONFIG, start)) for name in runs}
        truth = robot.truth()
        for period in range(150):
            after = robot.drive(translation_in_s=5, steering_deg_s=8 if period > 60 else 0)
            was, truth = truth, robot.truth()
            # The truth before and after the state, for the pose at the state's own clock.
            samples = [TruthSample(at.time_s, (at.x_in, at.y_in, at.steering_rad)) for at in (was, truth)]
            assert after.clock_s is not None
            pose = samples[0].interpolate(samples[1], after.clock_s)
            for name, localizer in localizers.items():
                estimate: Estimate = localizer.update(after)
                odometry = (after.x_in, after.y_in, after.steering_rad)
                runs[name].add(RunMoment(estimate, odometry, pose, 0))
    rmse = {name: float(np.sqrt(np.square(run.errors_in()).mean())) for name, run in runs.items()}
    used = {name: run.summary()["echoes_used"] for name, run in runs.items()}
    assert rmse[OWN] < 1.5 * rmse["ekf"] < 1.0, rmse
    assert used[OWN] > 0.7 * used["ekf"], used
    assert 0.5 < np.mean(plot.nees_values(runs[OWN])) < 6.0
    assert runs[OWN].odometry_errors_in().max() > 3.0 * rmse[OWN]


def test_notebooks_show_robots_worlds_and_estimates(run: Run) -> None:
    with connect("sim:thesis_room") as robot:
        robot.refresh()
        shown = robot._repr_html_()
        assert "n150" in shown
        assert shown.count("<path") == 17, "sixteen sonars and the heading"
        assert robot.state._repr_html_() == shown
    assert "disconnected" in robot._repr_html_()
    picture = load_world("flat")._repr_html_()
    assert picture.startswith("<svg")
    assert picture.count("<circle") == len(load_world("flat").starts)
    estimate = run.moments[-1].estimate
    assert f"x {estimate.pose[0]:.2f} ±" in estimate._repr_html_()


@pytest.mark.parametrize("draw", [plot.errors, plot.innovations, plot.nees])
def test_run_without_moments_is_refused(draw: Callable[[Run], object]) -> None:
    with pytest.raises(ValueError, match="none"):
        draw(Run([]))
