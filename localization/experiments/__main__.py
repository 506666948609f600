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

from localization.drawing import require_matplotlib
from localization.experiments import figures
from localization.experiments.live import command as live
from localization.experiments.lost import command as lost
from localization.experiments.options import NO_PICTURES, add_shared
from localization.experiments.plan import command as plan
from localization.experiments.pool import drive, drive_on_cluster
from localization.experiments.progress import progress
from localization.experiments.report import table
from localization.experiments.results import summarize
from localization.experiments.settings import FIGURES, Figure, course_of
from nclient.errors import NomadError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 if all went well, 2 if it could not be run, 130 if it was interrupted."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        match given[:1]:
            case ["live"]:
                live.main(given[1:])
            case ["lost"]:
                lost.main(given[1:])
            case ["plan"]:
                plan.main(given[1:])
            case ["all"]:
                _drive_figures([*FIGURES, *given[1:]])
                live.main(given[1:])
                numbers = [word for word in given[1:] if word != NO_PICTURES]
                lost.main(numbers)
                plan.main(numbers)
            case _:
                _drive_figures(given)
    except (NomadError, OSError) as error:
        print(f"localization.experiments: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _drive_figures(arguments: Sequence[str]) -> None:
    options = _parser().parse_args(arguments)
    if options.pictures:
        require_matplotlib()
    for name in options.figures:
        _drive_figure(FIGURES[name], options)


def _drive_figure(figure: Figure, options: argparse.Namespace) -> None:
    course = course_of(figure)
    total = options.seeds * course.least_steps
    with progress(total, f"figure {figure.name}", "steps") as report:
        if options.cluster:
            outcome = drive_on_cluster(figure, range(options.seeds), options.cluster, report)
        else:
            outcome = drive(figure, range(options.seeds), options.jobs, report)
        report(total)
    summary = summarize(figure, outcome.results)
    text = json.dumps(summary)
    options.out.mkdir(parents=True, exist_ok=True)
    numbers = options.out / f"figure_{figure.name}.json"
    numbers.write_text(text + "\n", encoding="utf-8")
    written = [numbers]
    if options.pictures:
        written += figures.draw(figure, course, outcome.tracks, options.out)
    print(text if options.json else table(figure, course, summary), flush=True)
    print(f"  written: {', '.join(map(str, written))}", file=sys.stderr if options.json else sys.stdout, flush=True)


def _parser() -> argparse.ArgumentParser:
    titles = "\n".join(f"  {figure.name}  {figure.title} ({figure.world})" for figure in FIGURES.values())
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments",
        description="Drive figures of the thesis with many seeds at once: a simulated robot with ideal sonars and "
        "gaussian noise, an extended Kalman filter (but for 5.2), the thesis' control law.",
        epilog=f"figures:\n{titles}\n\nexample: python -m localization.experiments 5.4 --seeds 100 --out out\n\n"
        "instead of figures: `live`, methods side by side on live robots (`live --help`); `lost`, does it know when it "
        "is lost (`lost --help`); `plan`, ways planned and driven (`plan --help`); `all`, all figures and all of these",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("figures", nargs="+", choices=list(FIGURES), metavar="FIGURE", help="one or more, see below")
    add_shared(parser, Path("out/experiments"), "figure")
    return parser


if __name__ == "__main__":
    sys.exit(main())
