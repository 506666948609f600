"""Output of the figures of the thesis: pictures and tables; and options shared by all experiments."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from localization import plot
from localization.experiments import execution
from localization.experiments.execution import code_hash
from localization.experiments.figure_trial import Figure, FigureSetup, Summary, Track, typical
from localization.filters.belief import difference
from nclient.common.arguments import add_flag, add_value, whole_number
from worlds import drawing
from worlds.robots import N150

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture


def draw(figure: Figure, setup: FigureSetup, tracks: Sequence[Track], folder: Path) -> list[Path]:
    """Write the trajectory and the errors of a figure as PNG files into `folder`; return their paths."""
    # Both pictures show the same run, that of the median final error.
    track = typical(tracks)
    errors_name = figure.errors_figure or f"{figure.name}_errors"
    pictures = {
        folder / f"figure_{figure.name}.png": trajectory(figure, setup, track),
        folder / f"figure_{errors_name}.png": errors(figure, tracks, track),
    }
    for path, picture in pictures.items():
        plot.save(picture, path)
    return list(pictures)


def trajectory(figure: Figure, setup: FigureSetup, track: Track) -> Picture:
    """Return a picture of map, waypoints, true and estimated path; without a filter also 3-sigma ellipses."""
    picture = drawing.blank(7.2, 7.0)
    # 1. Map, waypoints, and the body at start and end.
    axes = picture.add_subplot(aspect="equal")
    drawing.draw_walls(axes, setup.walls.segments)
    plot.draw_points(axes, setup.start, setup.goals_in)
    drawing.draw_body(axes, setup.start, N150, drawing.FAINT)
    drawing.draw_body(axes, track.truth[-1], N150, drawing.TRUTH)
    # 2. True and estimated path; ellipses only without a filter, where they grow.
    axes.plot(*np.vstack([setup.start[:2], track.truth[:, :2]]).T, color=drawing.TRUTH, linewidth=1.8, label="truth")
    label = _estimate_name(figure)
    axes.plot(*track.mean[:, :2].T, color=drawing.ESTIMATE, linewidth=1.4, linestyle=(0, (4, 2)), label=label)
    if not figure.filtered:
        plot.draw_ellipses(axes, track.mean, track.cov)
    # 3. Title with the final position error, inches.
    end = np.hypot(*(track.mean[-1] - track.truth[-1])[:2])
    axes.set_title(
        f"Figure {figure.name}: {figure.title}\n{len(track.mean)} steps, {end:.2f} in position error at the end"
    )
    axes.set(xlabel="x (in)", ylabel="y (in)")
    picture.legend(loc="outside lower center", ncols=5, frameon=False)
    return picture


def errors(figure: Figure, tracks: Sequence[Track], drawn: Track) -> Picture:
    """Return a picture of the errors in x, y and heading over the steps: one run with its 3-sigma band."""
    picture = drawing.blank(8.0, 7.0)
    rows = picture.subplots(3, 1, sharex=True)
    # Errors are in inches and radians; the heading is drawn in degrees.
    scales = (1.0, 1.0, np.degrees(1.0))
    for axes, row, scale, name in zip(rows, range(3), scales, ("x (in)", "y (in)", "heading (deg)"), strict=True):
        # 1. All stored runs, faint.
        for track in tracks:
            error = scale * difference(track.mean, track.truth)[:, row]
            axes.plot(error, color=drawing.FAINT, linewidth=0.5, alpha=0.4)
        # 2. The drawn run with the 3-sigma band of its own covariance.
        band = 3.0 * scale * np.sqrt(drawn.cov[:, row, row])
        steps = np.arange(len(band))
        axes.fill_between(steps, -band, band, color=drawing.ESTIMATE, alpha=0.15, linewidth=0, label="3 sigma")
        error = scale * difference(drawn.mean, drawn.truth)[:, row]
        axes.plot(error, color=drawing.ESTIMATE, linewidth=1.2, label="this run")
        axes.axhline(0.0, color=drawing.TRUTH, linewidth=0.6)
        axes.set_ylabel(name)
        axes.margins(x=0.0)
    # 3. An empty line for the legend, since each of the faint ones would have an entry.
    rows[0].plot([], [], color=drawing.FAINT, label=f"{len(tracks)} seeds")
    rows[0].legend(loc="upper left", ncols=3, framealpha=0.95)
    number = figure.errors_figure or figure.name
    rows[0].set_title(f"Figure {number}: {figure.title}, errors of the {_estimate_name(figure)}")
    rows[-1].set_xlabel("step")
    return picture


def _estimate_name(figure: Figure) -> str:
    return "estimate" if figure.filtered else "odometry"


def table(figure: Figure, setup: FigureSetup, summary: Summary) -> str:
    """Return the summary as text, each number with its reference value."""
    thesis = summary["steps_thesis"]
    rows = [
        ("seeds", f"{summary['seeds']}", ""),
        ("every goal reached", f"{summary['reached']}", f"of {summary['seeds']}, by the estimate"),
        ("steps, median", f"{summary['steps_median']:g}", f"{thesis} in the text" if thesis else ""),
        ("end error, median", f"{summary['end_error_median_in']:.3f} in", "between estimate and truth"),
        ("position RMSE", f"{summary['rmse_position_in']:.4f} in", _beside_bound(summary)),
        ("heading RMSE", f"{summary['rmse_heading_deg']:.3f} deg", ""),
    ]
    # 2. Consistency, for figures with a filter.
    if summary["nees_mean"] is not None and summary["nees_band95"] is not None:
        low, high = summary["nees_band95"]
        rows.append(("NEES, mean", f"{summary['nees_mean']:.2f}", f"3 is right, 95 % band {low:.2f} to {high:.2f}"))
    if summary["nis_mean"] is not None:
        rows.append(("NIS a beam, mean", f"{summary['nis_mean']:.3f}", "1 is right"))
    lines = [f"Figure {figure.name}: {figure.title}"]
    lines += [f"  {name:20}{value:>12}  {note}".rstrip() for name, value, note in rows]
    return "\n".join([*lines, *_step_note(setup, summary)])


def _beside_bound(summary: Summary) -> str:
    bound = summary["pcrb_position_in"]
    if bound is None:
        return ""
    return f"{summary['rmse_position_in'] / bound:.3f} x the Cramer-Rao bound of {bound:.4f} in"


def _step_note(setup: FigureSetup, summary: Summary) -> list[str]:
    """Return a note if the thesis states fewer steps than its control law needs."""
    thesis = summary["steps_thesis"]
    # Inches of the path per step, at most.
    stride = setup.gains.drho_max_in
    # No note, unless the thesis counts fewer steps than path length divided by the largest step.
    if thesis is None or thesis >= setup.min_steps:
        return []
    near = math.ceil((setup.length_in - setup.waypoint_radius_in) / stride)
    return [
        f"  The text's {thesis} steps cannot be: {setup.length_in:.1f} in at {stride:g} in a step take"
        f" {setup.min_steps} at least",
        f"  ({near} to come within {setup.waypoint_radius_in:g} in). The law is as printed; the count is ours.",
    ]


def text_table(lines: Sequence[Sequence[str]]) -> str:
    """Return lines of cells as text, right-aligned, each column as wide as its widest cell."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.rjust, line, widths)) for line in lines)


Item = TypeVar("Item")
Result = TypeVar("Result")

NO_PICTURES: Final = "--no-pictures"


def add_shared(parser: argparse.ArgumentParser, out: Path, unit: str) -> None:
    """Add --seeds, --jobs, --cluster, --out, --json, --no-pictures; `unit` names the subject of one JSON object."""
    add_value(parser, "--seeds", "N", positive, f"number of runs per {unit} (default: 100)", 100)
    add_execution_options(parser)
    add_output(parser, out, unit)
    parser.add_argument(
        NO_PICTURES, dest="pictures", action="store_false", help="write no pictures; matplotlib is not needed"
    )


def add_output(parser: argparse.ArgumentParser, out: Path, unit: str) -> None:
    """Add --out and --json; `unit` names the subject of one JSON object."""
    add_value(parser, "--out", "DIR", Path, "write results to this folder", out)
    add_flag(parser, "--json", f"print only JSON on stdout, one object per {unit}")


def add_choice(parser: argparse.ArgumentParser, option: str, names: Iterable[str], default: object, what: str) -> None:
    """Add an option that takes one of `names`, or several if its default is a list."""
    names = list(names)
    shown = "all" if default == names else " ".join(default) if isinstance(default, list) else default
    choices = ", ".join(names).replace("%", "%%")
    parser.add_argument(
        option,
        nargs="+" if isinstance(default, list) else None,
        choices=names,
        default=default,
        metavar="NAME",
        help=f"{what}: {choices} (default: {shown})",
    )


def add_execution_options(parser: argparse.ArgumentParser) -> None:
    """Add --jobs and --cluster."""
    group = parser.add_mutually_exclusive_group()
    add_value(group, "--jobs", "N", positive,
              "run this number of processes; the results do not depend on it (default: all cores)", cores())
    group.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="run on the Dask cluster with this scheduler, host:port (extra `cluster`); the results are the same",
    )


def executor_for(
    work: Callable[[Item], Result], options: argparse.Namespace
) -> Callable[[Sequence[Item]], Iterator[Result]]:
    """Return the executor of work selected by the options of `add_execution_options`."""
    if options.cluster:
        return partial(execution.on_cluster, work, address=options.cluster, code=code_hash)
    return partial(execution.run_locally, work, jobs=options.jobs)


positive: Final = whole_number("the number", 1)


def cores() -> int:
    """Return the number of cores this process may use."""
    # Not on macOS and Windows. A process may be restricted to fewer cores than the machine has.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
