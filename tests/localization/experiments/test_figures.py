"""The pictures: their content, and that they are valid files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from localization.experiments.__main__ import draw, errors, trajectory
from localization.experiments.figure_trial import FIGURES, Track, figure_setup
from localization.filters.belief import Floats

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

PNG = b"\x89PNG\r\n\x1a\n"


def made_up_track(seed: int = 0) -> Track:
    steps = np.linspace(0.0, 1.0, 40)
    truth = np.column_stack([60 * steps, 40 * steps, 0.6 + 0 * steps])
    mean = truth + np.column_stack([0.1 * np.sin(9 * steps), 0 * steps, 0.01 * np.cos(9 * steps + seed)])
    return Track(seed, truth, mean, np.tile(np.diag([0.01, 0.04, 1e-4]), (40, 1, 1)))


def lines(picture: Picture, row: int = 0) -> dict[str, Floats]:
    """The labelled lines of one panel, (k, 2) each."""
    return {str(line.get_label()): np.asarray(line.get_xydata()) for line in picture.axes[row].get_lines()}


def test_trajectory_plot_has_path_points_truth_and_estimate() -> None:
    figure, track = FIGURES["5.8"], made_up_track()
    course = figure_setup(figure)
    picture = trajectory(figure, course, track)
    (axes,) = picture.axes
    drawn = lines(picture)
    # An inch is as long in x as in y.
    assert axes.get_aspect() == 1.0
    # The drawn line begins at the start, which is no step of the track.
    assert drawn["truth"][1:] == pytest.approx(track.truth[:, :2])
    assert drawn["estimate"] == pytest.approx(track.mean[:, :2])
    assert drawn["waypoints"] == pytest.approx(course.goals_in)
    # Every wall is a line of the picture.
    ends = [tuple(np.asarray(line.get_xydata()).ravel()) for line in axes.get_lines()]
    assert all(tuple(wall) in ends for wall in course.walls.segments)
    assert "0.0" in axes.get_title()


def test_plot_without_filter_has_odometry_and_3_sigma() -> None:
    figure = FIGURES["5.2"]
    drawn = lines(trajectory(figure, figure_setup(figure), made_up_track()))
    assert "odometry" in drawn
    assert "3 sigma" in drawn


@pytest.mark.long
def test_error_plot_is_estimate_minus_truth() -> None:
    track = made_up_track()
    picture = errors(FIGURES["5.4"], [track, made_up_track(1)], track)
    assert [axes.get_ylabel() for axes in picture.axes] == ["x (in)", "y (in)", "heading (deg)"]
    for row, scale in enumerate((1.0, 1.0, np.degrees(1.0))):
        expected = scale * (track.mean - track.truth)[:, row]
        assert lines(picture, row)["this run"][:, 1] == pytest.approx(expected)
    assert picture.axes[0].get_title().startswith("Figure 5.5")


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "files"),
    [("5.2", {"figure_5.2.png", "figure_5.3.png"}), ("5.9", {"figure_5.9.png", "figure_5.9_errors.png"})],
)
def test_two_files_are_written_for_a_figure(name: str, files: set[str], tmp_path: Path) -> None:
    figure = FIGURES[name]
    written = draw(figure, figure_setup(figure), [made_up_track()], tmp_path / "new" / "folder")
    assert {path.name for path in written} == files
    assert all(path.read_bytes().startswith(PNG) for path in written)
