"""The pictures: a run in its world, and its errors step by step.

Rules: draws what it is given and computes nothing but ellipses; never touches the screen (figures of their own, no
pyplot, so no backend is chosen and no state is shared). matplotlib is the extra `plot`: imported where it is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from localization.belief import Floats, difference
from localization.experiments.results import Track, typical
from localization.experiments.settings import Course, Figure
from nclient.errors import NomadError
from worlds.bodies import N150

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

TRUTH: Final = "#1b1b1b"
ESTIMATE: Final = "#d1495b"
GOAL: Final = "#2e8b57"
WALL: Final = "#52616b"
FAINT: Final = "#9fb4c7"

ELLIPSES: Final = 8
"""Ellipses along a run."""

ELLIPSE_POINTS: Final = 60

DPI: Final = 140


class PlotExtraMissing(NomadError, ImportError):
    """A picture was asked for and matplotlib is not installed; the message names the extra."""


def require_matplotlib() -> None:
    """Raise PlotExtraMissing if no picture can be drawn: before a long run rather than after it."""
    try:
        import matplotlib.figure  # noqa: F401  # the import is the question
    except ImportError as error:
        raise PlotExtraMissing(
            "pictures need matplotlib: pip install 'nomad-nserver[plot]', or ask for none with --no-pictures"
        ) from error


def draw(figure: Figure, course: Course, tracks: Sequence[Track], folder: Path) -> list[Path]:
    """Write the trajectory and the errors of a figure as PNG files into `folder`; where they are."""
    folder.mkdir(parents=True, exist_ok=True)
    track = typical(tracks)
    errors_name = figure.errors_figure or f"{figure.name}_errors"
    pictures = {
        folder / f"figure_{figure.name}.png": trajectory(figure, course, track),
        folder / f"figure_{errors_name}.png": errors(figure, tracks, track),
    }
    for path, picture in pictures.items():
        picture.savefig(path, dpi=DPI)
    return list(pictures)


def trajectory(figure: Figure, course: Course, track: Track) -> Picture:
    """The world with its way-points, the true way and the estimated one; without the filter 3-sigma ellipses."""
    picture = _picture(7.2, 7.0)
    axes = picture.add_subplot(aspect="equal")
    for x1, y1, x2, y2 in course.walls.segments:
        axes.plot([x1, x2], [y1, y2], color=WALL, linewidth=3, solid_capstyle="round")
    _way_points(axes, course)
    for pose, color in ((course.start, FAINT), (track.truth[-1], TRUTH)):
        outline = pose[:2] + N150.radius_in * _circle()
        axes.plot(*outline.T, color=color, linewidth=1, alpha=0.7)
    axes.plot(*_from(course.start, track.truth).T, color=TRUTH, linewidth=1.8, label="truth")
    axes.plot(*track.mean[:, :2].T, color=ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)), label=_estimate_name(figure))
    if not figure.filtered:
        _ellipses(axes, track)
    end = np.hypot(*(track.mean[-1] - track.truth[-1])[:2])
    axes.set_title(f"Figure {figure.name}: {figure.title}\n{len(track.mean)} steps, {end:.2f} in off at the end")
    axes.set(xlabel="x (in)", ylabel="y (in)")
    picture.legend(loc="outside lower center", ncols=5, frameon=False)
    return picture


def errors(figure: Figure, tracks: Sequence[Track], drawn: Track) -> Picture:
    """Errors of the estimate in x, y and heading against the step: one run with its 3-sigma band, the others faint."""
    picture = _picture(8.0, 7.0)
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


def ellipse(mean: Floats, cov: Floats, sigmas: float) -> Floats:
    """The outline (k, 2) of the positions `sigmas` standard deviations from `mean` (3,) under `cov` (3, 3)."""
    values, axes = np.linalg.eigh(cov[:2, :2])
    spread = axes * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean[:2] + sigmas * _circle() @ spread.T, dtype=np.float64)


def _circle() -> Floats:
    angle = np.linspace(0.0, 2.0 * np.pi, ELLIPSE_POINTS)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _ellipses(axes: Axes, track: Track) -> None:
    """3-sigma ellipses along the run; where there is a filter they are smaller than a line is wide."""
    label = "3 sigma"
    for row in np.linspace(len(track.mean) / ELLIPSES, len(track.mean) - 1, ELLIPSES).astype(int):
        outline = ellipse(track.mean[row], track.cov[row], 3.0)
        axes.plot(*outline.T, color=ESTIMATE, linewidth=0.8, alpha=0.8, label=label)
        label = ""


def _way_points(axes: Axes, course: Course) -> None:
    axes.plot(*course.start[:2], marker="o", color=GOAL, markersize=7, linestyle="", label="start")
    axes.plot(*course.goals_in.T, marker="X", color=GOAL, markersize=10, linestyle="", label="way-points")


def _from(start: Floats, states: Floats) -> Floats:
    return np.vstack([start[:2], states[:, :2]])


def _estimate_name(figure: Figure) -> str:
    return "estimate" if figure.filtered else "odometry"


def _picture(width_in: float, height_in: float) -> Picture:
    from matplotlib.figure import Figure as MatplotlibFigure

    return MatplotlibFigure(figsize=(width_in, height_in), layout="constrained", facecolor="white")
