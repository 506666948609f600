"""Plots of a localization run, for notebooks and papers; `live.run.Run` records one.

    trajectory(run, world)    true and estimated path, odometry, 3-sigma ellipses, on the map
    errors(run)               error of x, y and heading over time, with the filter's own 3-sigma band
    innovations(run)          each echo's innovation in its standard deviations, used and refused ones
    nees(run)                 normalised estimation error squared, with the 95 % band of a consistent filter

Each returns a matplotlib figure (extra `plot`), which a notebook shows and `savefig` writes. Errors and NEES need the
ground truth, which simulated robots have; moments without it, or with a lost estimate, are gaps. Below are the drawing
functions that commands and experiments share; worlds.drawing has those of worlds.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from localization.filters import belief
from localization.filters.belief import POSE, Floats, chi_square_quantile
from localization.filters.update import Refusal
from localization.live.run import Run
from nclient.common.files import write_errors_as
from nclient.errors import OutputFileError
from worlds import drawing
from worlds.robots import N150, Body
from worlds.world import World

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIGMAS: Final = 3.0
"""Half the width of the bands of errors, and of error ellipses, standard deviations."""
GATE: Final = 2.0
"""Half the width of the band of innovations: 95 % of those of a consistent filter."""
CONFIDENCE: Final = 0.95
SUFFIX: Final = ".png"
ELLIPSES: Final = 8
"""Number of ellipses along a run."""
DPI: Final = 140


def trajectory(run: Run, world: World, body: Body = N150) -> Figure:
    """Return a picture of the run on its map."""
    _require_moments(run)
    picture = drawing.blank(7.2, 7.0)
    draw_path(picture.add_subplot(), world, run, body)
    return picture


def errors(run: Run) -> Figure:
    """Return a picture of the error of each coordinate, and the band in which the filter expects it."""
    _require_moments(run)
    picture = drawing.blank(8.0, 6.5)
    times, error, std = _times(run), _errors(run), np.array([m.estimate.belief.std[:POSE] for m in run.moments])
    rows = picture.subplots(POSE, 1, sharex=True)
    for axes, index, scale, name in zip(
        rows, range(POSE), (1.0, 1.0, np.degrees(1.0)), ("x (in)", "y (in)", "heading (deg)"), strict=True
    ):
        band = SIGMAS * scale * std[:, index]
        label = f"{SIGMAS:g} sigma"
        axes.fill_between(times, -band, band, color=drawing.ESTIMATE, alpha=0.15, linewidth=0, label=label)
        axes.plot(times, scale * error[:, index], color=drawing.ESTIMATE, linewidth=1.2, label="estimate - truth")
        axes.axhline(0.0, color=drawing.TRUTH, linewidth=0.6)
        axes.set_ylabel(name)
        axes.margins(x=0.0)
    picture.legend(*rows[0].get_legend_handles_labels(), loc="outside lower center", ncols=2, frameon=False)
    inside = np.abs(error) <= SIGMAS * std
    valid = np.isfinite(error).all(axis=1)
    rows[0].set_title(f"{inside[valid].mean():.0%} of the errors lie in the band" if valid.any() else "no ground truth")
    rows[-1].set_xlabel("time (s)")
    return picture


def innovations(run: Run) -> Figure:
    """Return a picture of the innovations in standard deviations: 95 % within 2 if all is well."""
    _require_moments(run)
    picture = drawing.blank(8.0, 3.4)
    axes = picture.add_subplot()
    first_s = run.moments[0].estimate.clock_s
    echoes = [echo for moment in run.moments for echo in moment.estimate.echoes]
    drawn = (Refusal.NONE, drawing.ESTIMATE, "used"), (Refusal.GATE, drawing.ODOMETRY, "refused")
    for refusal, color, label in drawn:
        rows = [(echo.instant_s - first_s, np.sign(echo.innovation_in) * np.sqrt(echo.nis))
                for echo in echoes if echo.refusal is refusal and echo.nis > 0.0]  # fmt: skip
        if rows:
            axes.plot(*np.array(rows).T, ".", markersize=4, color=color, label=f"{label}: {len(rows)}")
    axes.axhspan(-GATE, GATE, color=drawing.FAINT, alpha=0.3, linewidth=0, label="95 %")
    used = [echo.nis for echo in echoes if echo.refusal is Refusal.NONE]
    axes.set(xlabel="time (s)", ylabel="innovation / sqrt(S)", ylim=(-6, 6))
    axes.set_title(f"mean NIS of the echoes used: {np.mean(used):.2f} (1 is right)" if used else "no echo was used")
    axes.legend(loc="upper right", ncols=3, framealpha=0.9)
    return picture


def nees(run: Run) -> Figure:
    """Return a picture of e' P^-1 e over time: 3 on average for a consistent filter."""
    _require_moments(run)
    picture = drawing.blank(8.0, 3.4)
    axes = picture.add_subplot()
    values = nees_values(run)
    axes.plot(_times(run), values, color=drawing.ESTIMATE, linewidth=1.2)
    low, high = (chi_square_quantile(share, POSE) for share in (0.5 * (1 - CONFIDENCE), 0.5 * (1 + CONFIDENCE)))
    axes.axhspan(low, high, color=drawing.FAINT, alpha=0.3, linewidth=0, label=f"{CONFIDENCE:.0%} of chi-square, 3 dof")
    axes.set(xlabel="time (s)", ylabel="NEES", ylim=(0, None))
    axes.margins(x=0.0)
    finite = values[np.isfinite(values)]
    axes.set_title(f"mean NEES {finite.mean():.2f} (3 is right)" if len(finite) else "no ground truth")
    axes.legend(loc="upper right", framealpha=0.9)
    return picture


def nees_values(run: Run) -> Floats:
    """Return e' P^-1 e of each moment (k,), NaN without ground truth or while lost."""
    return belief.nees(_errors(run), np.array([moment.estimate.belief.cov[:POSE, :POSE] for moment in run.moments]))


def _require_moments(run: Run) -> None:
    """Raise ValueError for a run without moments, ExtraMissing without matplotlib."""
    drawing.require_matplotlib()
    if not run.moments:
        raise ValueError("expected a run with at least one moment, found none: nothing was recorded")


def _times(run: Run) -> Floats:
    clocks = np.array([moment.estimate.clock_s for moment in run.moments])
    return np.asarray(clocks - clocks[0])


def _errors(run: Run) -> Floats:
    """Return the errors (k, 3), NaN where there is none."""
    found = [moment.error for moment in run.moments]
    return np.array([np.full(POSE, np.nan) if error is None else error for error in found])


def check_picture(path: Path | None) -> None:
    """Raise OutputFileError if the path is not a PNG's, and PlotExtraMissing if matplotlib is missing.

    Without a path no picture is drawn.
    """
    if path is None:
        return
    if path.is_dir() or path.suffix.lower() != SUFFIX:
        raise OutputFileError(f"{str(path)!r}: pictures are written as PNG: name a file that ends in {SUFFIX}")
    drawing.require_matplotlib()


def save(picture: Figure, path: Path) -> None:
    """Write a PNG file, creating its folders. Raises OutputFileError."""
    with write_errors_as(OutputFileError, path):
        path.parent.mkdir(parents=True, exist_ok=True)
        picture.savefig(path, dpi=DPI)


def draw_points(axes: Axes, start: Floats, goals: npt.ArrayLike) -> None:
    """Draw the start and the waypoints (k, 2)."""
    axes.plot(start[0], start[1], marker="o", color=drawing.GOAL, markersize=7, linestyle="", label="start")
    axes.plot(*np.asarray(goals).T, marker="X", color=drawing.GOAL, markersize=10, linestyle="", label="waypoints")


def draw_ellipses(axes: Axes, means: Floats, covs: Floats) -> None:
    """Draw error ellipses, SIGMAS standard deviations wide, along a run of means (k, 3) and covariances (k, 3, 3)."""
    rows = np.linspace(len(means) / ELLIPSES, len(means) - 1, ELLIPSES).astype(int)
    for k, row in enumerate(rows):
        outline = ellipse(means[row], covs[row], SIGMAS)
        label = f"{SIGMAS:g} sigma" if k == 0 else None
        axes.plot(*outline.T, color=drawing.ESTIMATE, linewidth=0.8, alpha=0.8, label=label)


def ellipse(mean: Floats, cov: Floats, sigmas: float) -> Floats:
    """Return the outline (k, 2) of positions `sigmas` standard deviations from `mean` (3,) under `cov` (3, 3)."""
    # Axes of the ellipse: eigenvectors, scaled by the square roots of the eigenvalues.
    values, axes = np.linalg.eigh(cov[:2, :2])
    spread = axes * np.sqrt(np.maximum(values, 0.0))
    return np.asarray(mean[:2] + sigmas * drawing.circle() @ spread.T, dtype=np.float64)


def draw_run(path: Path, world: World, done: Run, body: Body) -> None:
    """Draw a live run into a PNG file: true and estimated path, and the error over time if there is ground truth."""
    # A second panel shows the errors.
    has_truth = done.moments[-1].truth is not None
    picture = drawing.blank(12.0 if has_truth else 7.2, 7.0)
    columns = picture.subplots(1, 2 if has_truth else 1, squeeze=False, width_ratios=[3, 2] if has_truth else None)[0]
    draw_path(columns[0], world, done, body)
    if has_truth:
        _draw_errors(columns[1], done)
    save(picture, path)


def draw_path(axes: Axes, world: World, done: Run, body: Body) -> None:
    """Draw true and estimated path, odometry, ellipses and waypoints of a run on its map."""
    axes.set_aspect("equal")
    drawing.draw_walls(axes, world.walls)
    beliefs = [moment.estimate.belief for moment in done.moments]
    means = np.array([belief.mean for belief in beliefs])
    draw_points(axes, means[0], done.waypoints or np.empty((0, 2)))
    odometry = np.array([moment.odometry for moment in done.moments])
    axes.plot(*odometry[:, :2].T, color=drawing.ODOMETRY, linewidth=1.2, linestyle=":", label="odometry")
    truth = np.array([moment.truth for moment in done.moments if moment.truth])
    if len(truth):
        axes.plot(*truth[:, :2].T, color=drawing.TRUTH, linewidth=1.8, label="truth")
    axes.plot(*means[:, :2].T, color=drawing.ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)), label="estimate")
    draw_ellipses(axes, means, np.array([belief.cov for belief in beliefs]))
    drawing.draw_body(axes, (truth if len(truth) else means)[-1], body, drawing.TRUTH)
    axes.set(xlabel="x (in)", ylabel="y (in)")
    axes.set_title(f"{world.title or world.name}: {done.reached} of {len(done.waypoints)} waypoints reached")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)


def _draw_errors(axes: Axes, done: Run) -> None:
    first_s = done.moments[0].estimate.clock_s
    times = [moment.estimate.clock_s - first_s for moment in done.moments]
    axes.plot(times, done.errors_in(), color=drawing.ESTIMATE, linewidth=1.4, label="estimate")
    axes.plot(times, done.odometry_errors_in(), color=drawing.ODOMETRY, linewidth=1.2, linestyle=":", label="odometry")
    sigma = [3.0 * max(moment.estimate.belief.std[:2]) for moment in done.moments]
    axes.fill_between(times, 0, sigma, color=drawing.ESTIMATE, alpha=0.15, linewidth=0, label="3 sigma")
    axes.set(xlabel="robot's clock (s)", ylabel="distance from the truth (in)", ylim=(0, None))
    axes.margins(x=0.0)
    axes.set_title(f"{done.errors_in()[-1]:.2f} in position error at the end")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=3, frameon=False)
