"""Pictures of live runs, and drawing functions shared with the experiments; worlds.drawing has those of worlds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from localization.filters.belief import Floats
from localization.live.run import Run
from nclient.common.files import write_errors_as
from nclient.errors import OutputFileError
from worlds.drawing import (
    ESTIMATE,
    GOAL,
    ODOMETRY,
    TRUTH,
    blank,
    circle,
    draw_body,
    draw_walls,
    require_matplotlib,
)  # fmt: skip
from worlds.robots import Body
from worlds.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Picture

SUFFIX: Final = ".png"
ELLIPSES: Final = 8
"""Number of ellipses along a run."""
SIGMAS: Final = 3.0
DPI: Final = 140


def check_picture(path: Path) -> None:
    """Raise OutputFileError if the path is not a PNG's, and PlotExtraMissing if matplotlib is missing."""
    if path.is_dir() or path.suffix.lower() != SUFFIX:
        raise OutputFileError(f"{str(path)!r}: pictures are written as PNG: name a file that ends in {SUFFIX}")
    require_matplotlib()


def save(picture: Picture, path: Path) -> None:
    """Write a PNG file, creating its folders. Raises OutputFileError."""
    with write_errors_as(OutputFileError, path):
        path.parent.mkdir(parents=True, exist_ok=True)
        picture.savefig(path, dpi=DPI)


def draw_points(axes: Axes, start: Floats, goals: npt.ArrayLike) -> None:
    """Draw the start and the waypoints (k, 2)."""
    axes.plot(start[0], start[1], marker="o", color=GOAL, markersize=7, linestyle="", label="start")
    axes.plot(*np.asarray(goals).T, marker="X", color=GOAL, markersize=10, linestyle="", label="waypoints")


def draw_ellipses(axes: Axes, means: Floats, covs: Floats) -> None:
    """Draw error ellipses, SIGMAS standard deviations wide, along a run of means (k, 3) and covariances (k, 3, 3)."""
    rows = np.linspace(len(means) / ELLIPSES, len(means) - 1, ELLIPSES).astype(int)
    for k, row in enumerate(rows):
        outline = ellipse(means[row], covs[row], SIGMAS)
        label = f"{SIGMAS:g} sigma" if k == 0 else None
        axes.plot(*outline.T, color=ESTIMATE, linewidth=0.8, alpha=0.8, label=label)


def ellipse(mean: Floats, cov: Floats, sigmas: float) -> Floats:
    """Return the outline (k, 2) of positions `sigmas` standard deviations from `mean` (3,) under `cov` (3, 3)."""
    # Axes of the ellipse: eigenvectors, scaled by the square roots of the eigenvalues.
    values, axes = np.linalg.eigh(cov[:2, :2])
    spread = axes * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean[:2] + sigmas * circle() @ spread.T, dtype=np.float64)


def draw_run(path: Path, world: World, done: Run, body: Body) -> None:
    """Draw a live run into a PNG file: true and estimated path, and the error over time if there is ground truth."""
    # A second panel shows the errors.
    has_truth = done.moments[-1].truth is not None
    picture = blank(12.0 if has_truth else 7.2, 7.0)
    columns = picture.subplots(1, 2 if has_truth else 1, squeeze=False, width_ratios=[3, 2] if has_truth else None)[0]
    draw_path(columns[0], world, done, body)
    if has_truth:
        _draw_errors(columns[1], done)
    save(picture, path)


def draw_path(axes: Axes, world: World, done: Run, body: Body) -> None:
    """Draw true and estimated path, odometry, ellipses and waypoints of a run on its map."""
    axes.set_aspect("equal")
    draw_walls(axes, world.walls)
    beliefs = [moment.estimate.belief for moment in done.moments]
    means = np.array([belief.mean for belief in beliefs])
    draw_points(axes, means[0], done.waypoints or np.empty((0, 2)))
    odometry = np.array([moment.odometry for moment in done.moments])
    axes.plot(*odometry[:, :2].T, color=ODOMETRY, linewidth=1.2, linestyle=":", label="odometry")
    truth = np.array([moment.truth for moment in done.moments if moment.truth])
    if len(truth):
        axes.plot(*truth[:, :2].T, color=TRUTH, linewidth=1.8, label="truth")
    axes.plot(*means[:, :2].T, color=ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)), label="estimate")
    draw_ellipses(axes, means, np.array([belief.cov for belief in beliefs]))
    draw_body(axes, (truth if len(truth) else means)[-1], body, TRUTH)
    axes.set(xlabel="x (in)", ylabel="y (in)")
    axes.set_title(f"{world.title or world.name}: {done.reached} of {len(done.waypoints)} waypoints reached")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)


def _draw_errors(axes: Axes, done: Run) -> None:
    first_s = done.moments[0].estimate.clock_s
    times = [moment.estimate.clock_s - first_s for moment in done.moments]
    axes.plot(times, done.errors_in(), color=ESTIMATE, linewidth=1.4, label="estimate")
    axes.plot(times, done.odometry_errors_in(), color=ODOMETRY, linewidth=1.2, linestyle=":", label="odometry")
    sigma = [3.0 * max(moment.estimate.belief.std[:2]) for moment in done.moments]
    axes.fill_between(times, 0, sigma, color=ESTIMATE, alpha=0.15, linewidth=0, label="3 sigma")
    axes.set(xlabel="robot's clock (s)", ylabel="distance from the truth (in)", ylim=(0, None))
    axes.margins(x=0.0)
    axes.set_title(f"{done.errors_in()[-1]:.2f} in position error at the end")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
