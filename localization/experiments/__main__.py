"""`python -m localization.experiments`: simulate figures of the thesis, or run another experiment, or `all`.

With --json only the numbers are printed on stdout; the progress bar (extra `plot`: tqdm) and file names go to stderr.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np

from localization import plot
from localization.cli.arguments import make_folder
from localization.experiments import baselines, corridor, disturbed, figure_trial, live, lost, mapping, plan, recorded
from localization.experiments.execution import NO_PICTURES, add_shared, drive, drive_on_cluster, progress
from localization.experiments.figure_trial import FIGURES, Figure, FigureSetup, Summary, Track
from localization.filters.belief import difference
from nclient.common.arguments import Parser
from nclient.common.process import ExitCode
from nclient.errors import NomadError, suggest
from worlds import drawing
from worlds.drawing import require_matplotlib
from worlds.robots import N150

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Picture

OUT: Final = Path("out/experiments")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and return the exit code (docs/exit-codes.md)."""
    # The first word selects the command; anything else is the name of a figure.
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        command = COMMANDS.get(given[0]) if given else None
        if command:
            command(given[1:])
        else:
            _drive_figures(given)
    except (NomadError, OSError) as error:
        print(f"localization.experiments: {error}", file=sys.stderr)
        return ExitCode.USAGE if isinstance(error, NomadError) and error.usage else ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    return ExitCode.DONE


def _drive_all(arguments: Sequence[str]) -> None:
    parser = Parser(
        prog="python -m localization.experiments all",
        description=f"Run everything in sequence: the figures {', '.join(FIGURES)} (with the errors in "
        f"{', '.join(_parts())}), then `live`, `lost` and `plan`, each with its own worlds, methods and scenarios. "
        "With 100 seeds this takes many hours on two cores. Results of `live`, `lost` and `plan` are cached, and an "
        "interrupted run continues where it ended.",
        epilog="only the common options are available; run a command by itself for its own: "
        "python -m localization.experiments live --scenario exact",
    )
    add_shared(parser, OUT, "figure, then a list each of live, and objects of lost and plan")
    # Parsed once here so that a wrong option is reported before hours of work.
    parser.parse_args(arguments)
    _drive_figures([*FIGURES, *arguments])
    live.main(arguments)
    # `lost` and `plan` draw no pictures and do not have the option.
    numbers = [word for word in arguments if word != NO_PICTURES]
    lost.main(numbers)
    plan.main(numbers)


COMMANDS: Final[Mapping[str, Callable[[Sequence[str]], None]]] = MappingProxyType({
    "live": live.main, "lost": lost.main, "plan": plan.main, "corridor": corridor.main, "ring": recorded.main,
    "flights": recorded.fly, "mapping": mapping.main, "disturbed": disturbed.main, "baselines": baselines.main,
    "all": _drive_all,
})  # fmt: skip
"""Commands that replace the names of figures."""


def _parts() -> dict[str, str]:
    """Return the figures that are drawn with the run of another figure, and that figure."""
    return {figure.errors_figure: name for name, figure in FIGURES.items() if figure.errors_figure}


def _figure(text: str) -> str:
    """Return the name of a figure. Raises ArgumentTypeError, also for a figure that is drawn with another one."""
    # Figures of errors are drawn with the run they belong to.
    if text in _parts():
        run = _parts()[text]
        raise argparse.ArgumentTypeError(f"figure {text} shows the errors of {run} and is drawn with it: use {run}")
    if text in COMMANDS:
        raise argparse.ArgumentTypeError(f"{text} is a command, not a figure: give it first and without figures")
    if text not in FIGURES:
        raise argparse.ArgumentTypeError(
            f"unknown figure {text!r}; expected one of {', '.join(FIGURES)}, or first a command: {', '.join(COMMANDS)}"
            f"{suggest(text, (*FIGURES, *COMMANDS))}"
        )
    return text


def _drive_figures(arguments: Sequence[str]) -> None:
    options = _parser().parse_args(arguments)
    if options.pictures:
        require_matplotlib()
    make_folder(options.out)
    for name in options.figures:
        _drive_figure(FIGURES[name], options)


def _drive_figure(figure: Figure, options: argparse.Namespace) -> None:
    # 1. Run.
    setup = figure_trial.figure_setup(figure)
    total = options.seeds * setup.min_steps
    with progress(total, f"figure {figure.name}", "steps") as report:
        if options.cluster:
            result = drive_on_cluster(figure, range(options.seeds), options.cluster, report)
        else:
            result = drive(figure, range(options.seeds), options.jobs, report)
        report(total)
    # 2. Results: JSON, pictures, table.
    summary = figure_trial.summarize(figure, result.results)
    text = json.dumps(summary)
    numbers = options.out / f"figure_{figure.name}.json"
    numbers.write_text(text + "\n", encoding="utf-8")
    written = [numbers]
    if options.pictures:
        written += draw(figure, setup, result.tracks, options.out)
    print(text if options.json else table(figure, setup, summary), flush=True)
    print(f"  written: {', '.join(map(str, written))}", file=sys.stderr if options.json else sys.stdout, flush=True)


def _parser() -> argparse.ArgumentParser:
    titles = "\n".join(
        f"  {figure.name}  {figure.title} ({figure.world})"
        + (f", and {figure.errors_figure}, its errors" if figure.errors_figure else "")
        for figure in FIGURES.values()
    )
    parser = Parser(
        prog="python -m localization.experiments",
        description="Simulate figures of the thesis with many seeds: a robot with ideal sonars and Gaussian noise, an "
        "extended Kalman filter (except 5.2), the thesis' control law.",
        epilog=f"figures:\n{titles}\n\nexample: python -m localization.experiments 5.4 --seeds 100 --out out\n\n"
        "instead of figures: `live`, filters compared on live robots (`live --help`); `lost`, detection of a lost "
        "estimate (`lost --help`); `plan`, planned and driven paths (`plan --help`); `mapping`, learned maps "
        "(`mapping --help`); `disturbed`, errors that the filter's models do not have (`disturbed --help`); "
        "`baselines`, simple policies in the environments of Gymnasium (`baselines --help`); `all`, everything else",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("figures", nargs="+", type=_figure, metavar="FIGURE", help="simulate these figures, see below")
    add_shared(parser, OUT, "figure")
    return parser


# Output of a figure.


def draw(figure: Figure, setup: FigureSetup, tracks: Sequence[Track], folder: Path) -> list[Path]:
    """Write the trajectory and the errors of a figure as PNG files into `folder`; return their paths."""
    # Both pictures show the same run, that of the median final error.
    track = figure_trial.typical(tracks)
    errors_name = figure.errors_figure or f"{figure.name}_errors"
    pictures = {folder / f"figure_{figure.name}.png": trajectory(figure, setup, track),
                folder / f"figure_{errors_name}.png": errors(figure, tracks, track)}
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


if __name__ == "__main__":
    sys.exit(main())
