"""Plots of a localization run, for notebooks and papers; `live.run.Run` records one.

    trajectory(run, world)    true and estimated path, odometry, 3-sigma ellipses, on the map
    errors(run)               error of x, y and heading over time, with the filter's own 3-sigma band
    innovations(run)          each echo's innovation in its standard deviations, used and refused ones
    nees(run)                 normalised estimation error squared, with the 95 % band of a consistent filter

Each returns a matplotlib figure (extra `plot`), which a notebook shows and `savefig` writes. Errors and NEES need the
ground truth, which simulated robots have; moments without it, or with a lost estimate, are gaps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from localization.filters import belief
from localization.filters.belief import POSE, Floats, chi_square_quantile
from localization.filters.update import Refusal
from localization.live import plot
from localization.live.run import Run
from worlds import drawing
from worlds.robots import N150, Body
from worlds.world import World

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGMAS: Final = 3.0
"""Half the width of the bands of errors, standard deviations."""
GATE: Final = 2.0
"""Half the width of the band of innovations: 95 % of those of a consistent filter."""
CONFIDENCE: Final = 0.95


def trajectory(run: Run, world: World, body: Body = N150) -> Figure:
    """Return a picture of the run on its map."""
    _require_moments(run)
    picture = drawing.blank(7.2, 7.0)
    plot.draw_path(picture.add_subplot(), world, run, body)
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
