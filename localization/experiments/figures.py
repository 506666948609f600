"""The figures of the thesis: a run in its world, and its errors step by step.

Rules: draws what it is given with the brushes of localization.runs.drawing and computes nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from localization.experiments.results import Track, typical
from localization.experiments.settings import Course, Figure
from localization.filters.belief import Floats, difference
from localization.runs.drawing import (
    ESTIMATE,
    FAINT,
    TRUTH,
    blank,
    draw_body,
    draw_ellipses,
    draw_points,
    draw_walls,
    save,
)
from worlds.bodies import N150

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture


def draw(figure: Figure, course: Course, tracks: Sequence[Track], folder: Path) -> list[Path]:
    """Write the trajectory and the errors of a figure as PNG files into `folder`; where they are."""
    track = typical(tracks)
    errors_name = figure.errors_figure or f"{figure.name}_errors"
    pictures = {
        folder / f"figure_{figure.name}.png": trajectory(figure, course, track),
        folder / f"figure_{errors_name}.png": errors(figure, tracks, track),
    }
    for path, picture in pictures.items():
        save(picture, path)
    return list(pictures)


def trajectory(figure: Figure, course: Course, track: Track) -> Picture:
    """The world with its way-points, the true way and the estimated one; without the filter 3-sigma ellipses."""
    picture = blank(7.2, 7.0)
    axes = picture.add_subplot(aspect="equal")
    draw_walls(axes, course.walls.segments)
    draw_points(axes, course.start, course.goals_in)
    draw_body(axes, course.start, N150, FAINT)
    draw_body(axes, track.truth[-1], N150, TRUTH)
    axes.plot(*_from(course.start, track.truth).T, color=TRUTH, linewidth=1.8, label="truth")
    axes.plot(*track.mean[:, :2].T, color=ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)), label=_estimate_name(figure))
    if not figure.filtered:
        draw_ellipses(axes, track.mean, track.cov)
    end = np.hypot(*(track.mean[-1] - track.truth[-1])[:2])
    axes.set_title(f"Figure {figure.name}: {figure.title}\n{len(track.mean)} steps, {end:.2f} in off at the end")
    axes.set(xlabel="x (in)", ylabel="y (in)")
    picture.legend(loc="outside lower center", ncols=5, frameon=False)
    return picture


def errors(figure: Figure, tracks: Sequence[Track], drawn: Track) -> Picture:
    """Errors of the estimate in x, y and heading against the step: one run with its 3-sigma band, the others faint."""
    picture = blank(8.0, 7.0)
    rows = picture.subplots(3, 1, sharex=True)
    scales = (1.0, 1.0, np.degrees(1.0))
    for axes, row, scale, name in zip(rows, range(3), scales, ("x (in)", "y (in)", "heading (deg)"), strict=True):
        for track in tracks:
            axes.plot(scale * difference(track.mean, track.truth)[:, row], color=FAINT, linewidth=0.5, alpha=0.4)
        band = 3.0 * scale * np.sqrt(drawn.cov[:, row, row])
        steps = np.arange(len(band))
        axes.fill_between(steps, -band, band, color=ESTIMATE, alpha=0.15, linewidth=0, label="3 sigma")
        axes.plot(scale * difference(drawn.mean, drawn.truth)[:, row], color=ESTIMATE, linewidth=1.2, label="this run")
        axes.axhline(0.0, color=TRUTH, linewidth=0.6)
        axes.set_ylabel(name)
        axes.margins(x=0.0)
    rows[0].plot([], [], color=FAINT, label=f"{len(tracks)} seeds")
    rows[0].legend(loc="upper left", ncols=3, framealpha=0.95)
    number = figure.errors_figure or figure.name
    rows[0].set_title(f"Figure {number}: {figure.title}, errors of the {_estimate_name(figure)}")
    rows[-1].set_xlabel("step")
    return picture


def _from(start: Floats, states: Floats) -> Floats:
    return np.vstack([start[:2], states[:, :2]])


def _estimate_name(figure: Figure) -> str:
    return "estimate" if figure.filtered else "odometry"
