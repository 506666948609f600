"""`python -m localization.experiments 5.4`: drive figures of the thesis and say what came of it. `... live`: methods
side by side on live robots (live.command). `... lost`: does a filter know when it is lost (lost.command). `... plan`:
ways planned and driven (plan.command). `... all`: every figure, then all of these.

Rules: words and files only; what is driven is in settings, trial and pool. With --json the numbers are alone on stdout;
the progress bar (extra `plot`: tqdm) and the names of files go to stderr.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from localization.cli.options import make_folder
from localization.experiments import live, output
from localization.experiments import lost as lost_command
from localization.experiments import plan as plan_command
from localization.experiments.execution import drive, drive_on_cluster, progress
from localization.experiments.figure_trial import FIGURES, Figure, figure_setup
from localization.experiments.output import NO_PICTURES, add_shared, table
from localization.experiments.results import summarize
from localization.live.plot import require_matplotlib
from nclient.errors import NomadError

OUT: Final = Path("out/experiments")
ALONE: Final = ("live", "lost", "plan", "all")
"""What is said in the place of figures."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 if all went well, 2 if it could not be run, 130 if it was interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        match given[:1]:
            case ["live"]:
                live.main(given[1:])
            case ["lost"]:
                lost_command.main(given[1:])
            case ["plan"]:
                plan_command.main(given[1:])
            case ["all"]:
                _drive_all(given[1:])
            case _:
                _drive_figures(given)
    except (NomadError, OSError) as error:
        print(f"localization.experiments: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _drive_all(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments all",
        description=f"Everything, one after the other: the figures {', '.join(FIGURES)} (with the errors in "
        f"{', '.join(_parts())}), then `live`, `lost` and `plan`, each with its own worlds, methods and scenarios. "
        "With 100 seeds that takes two cores many hours. What `live`, `lost` and `plan` have run is kept, and a run "
        "that was cut short goes on where it was.",
        epilog="the options are those that all of them have; what only one knows is said to it: "
        "python -m localization.experiments live --scenario exact",
    )
    add_shared(parser, OUT, "figure, then a list each of live, and objects of lost and plan")
    parser.parse_args(arguments)
    _drive_figures([*FIGURES, *arguments])
    live.main(arguments)
    numbers = [word for word in arguments if word != NO_PICTURES]
    lost_command.main(numbers)
    plan_command.main(numbers)


def _parts() -> dict[str, str]:
    """Figures that are drawn with another's run: which."""
    return {figure.errors_figure: name for name, figure in FIGURES.items() if figure.errors_figure}


def _figure(text: str) -> str:
    """The name of a figure that is run. Raises ArgumentTypeError, which says whose part another one is."""
    if text in _parts():
        run = _parts()[text]
        raise argparse.ArgumentTypeError(f"figure {text} shows the errors of {run} and is drawn with it: say {run}")
    if text in ALONE:
        raise argparse.ArgumentTypeError(f"{text} is no figure: say it first, and no figure beside it")
    if text not in FIGURES:
        raise argparse.ArgumentTypeError(f"no figure {text!r}; there are {', '.join(FIGURES)}")
    return text


def _drive_figures(arguments: Sequence[str]) -> None:
    options = _parser().parse_args(arguments)
    if options.pictures:
        require_matplotlib()
    make_folder(options.out)
    for name in options.figures:
        _drive_figure(FIGURES[name], options)


def _drive_figure(figure: Figure, options: argparse.Namespace) -> None:
    course = figure_setup(figure)
    total = options.seeds * course.least_steps
    with progress(total, f"figure {figure.name}", "steps") as report:
        if options.cluster:
            outcome = drive_on_cluster(figure, range(options.seeds), options.cluster, report)
        else:
            outcome = drive(figure, range(options.seeds), options.jobs, report)
        report(total)
    summary = summarize(figure, outcome.results)
    text = json.dumps(summary)
    numbers = options.out / f"figure_{figure.name}.json"
    numbers.write_text(text + "\n", encoding="utf-8")
    written = [numbers]
    if options.pictures:
        written += output.draw(figure, course, outcome.tracks, options.out)
    print(text if options.json else table(figure, course, summary), flush=True)
    print(f"  written: {', '.join(map(str, written))}", file=sys.stderr if options.json else sys.stdout, flush=True)


def _parser() -> argparse.ArgumentParser:
    titles = "\n".join(
        f"  {figure.name}  {figure.title} ({figure.world})"
        + (f", and {figure.errors_figure}, its errors" if figure.errors_figure else "")
        for figure in FIGURES.values()
    )
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments",
        description="Drive figures of the thesis with many seeds at once: a simulated robot with ideal sonars and "
        "gaussian noise, an extended Kalman filter (but for 5.2), the thesis' control law.",
        epilog=f"figures:\n{titles}\n\nexample: python -m localization.experiments 5.4 --seeds 100 --out out\n\n"
        "instead of figures: `live`, methods side by side on live robots (`live --help`); `lost`, does it know when it "
        "is lost (`lost --help`); `plan`, ways planned and driven (`plan --help`); `all`, all figures and all of these",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("figures", nargs="+", type=_figure, metavar="FIGURE", help="one or more, see below")
    add_shared(parser, OUT, "figure")
    return parser


if __name__ == "__main__":
    sys.exit(main())
