"""`python -m localization.experiments 5.4`: drive figures of the thesis and say what came of it.

Rules: words and files only; what is driven is in settings, trial and pool. With --json the numbers are alone on stdout;
the progress bar (extra `plot`: tqdm) and the names of files go to stderr.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from localization.drawing import require_matplotlib
from localization.experiments import figures
from localization.experiments.pool import Tally, drive
from localization.experiments.report import table
from localization.experiments.results import summarize
from localization.experiments.settings import FIGURES, Course, Figure, course_of
from nclient.errors import NomadError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0 if all went well, 2 if it could not be run, 130 if it was interrupted."""
    options = _parser().parse_args(arguments)
    try:
        if options.pictures:
            require_matplotlib()
        for name in options.figures:
            _drive_figure(FIGURES[name], options)
    except (NomadError, OSError) as error:
        print(f"localization.experiments: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


def _drive_figure(figure: Figure, options: argparse.Namespace) -> None:
    course = course_of(figure)
    with _progress(figure, course, options.seeds) as report:
        outcome = drive(figure, range(options.seeds), options.jobs, report)
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


@contextmanager
def _progress(figure: Figure, course: Course, seeds: int) -> Iterator[Tally]:
    """A bar over the steps of all seeds, of which each takes about `least_steps`; nothing where tqdm is missing."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda _: None
        return
    total = seeds * course.least_steps
    with tqdm(total=total, desc=f"figure {figure.name}", unit=" steps", unit_scale=True, file=sys.stderr) as bar:

        def advance(done: int) -> None:
            bar.update(min(done, total) - bar.n)

        yield advance
        advance(total)


def _parser() -> argparse.ArgumentParser:
    titles = "\n".join(f"  {figure.name}  {figure.title} ({figure.world})" for figure in FIGURES.values())
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments",
        description="Drive figures of the thesis with many seeds at once: a simulated robot with ideal sonars and "
        "gaussian noise, an extended Kalman filter (but for 5.2), the thesis' control law.",
        epilog=f"figures:\n{titles}\n\nexample: python -m localization.experiments 5.4 --seeds 100 --out out",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("figures", nargs="+", choices=list(FIGURES), metavar="FIGURE", help="one or more, see below")
    parser.add_argument("--seeds", type=_positive, default=100, metavar="N", help="runs a figure (default 100)")
    parser.add_argument(
        "--jobs", type=_positive, default=_cores(), metavar="N", help="processes; the numbers are the same (all cores)"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out/experiments"), metavar="DIR", help="for PNG and JSON (out/experiments)"
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object a figure, and nothing else, on stdout"
    )
    parser.add_argument(
        "--no-pictures", dest="pictures", action="store_false", help="numbers only; needs no matplotlib"
    )
    return parser


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not 1 or more")
    return number


def _cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


if __name__ == "__main__":
    sys.exit(main())
