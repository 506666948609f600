"""`python -m localization.experiments`: simulate figures of the thesis, or run another experiment, or `all`.

With --json only the numbers are printed on stdout; the progress bar (extra `plot`: tqdm) and file names go to stderr.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from localization.cli.arguments import make_folder
from localization.experiments import baselines, corridor, disturbed, execution, live, mapping
from localization.experiments import lost as lost_command
from localization.experiments import plan as plan_command
from localization.experiments.execution import NO_PICTURES, add_shared, drive, drive_on_cluster, progress, table
from localization.experiments.figure_trial import FIGURES, Figure, figure_setup, summarize
from nclient.common.arguments import Parser
from nclient.common.process import ExitCode
from nclient.errors import NomadError, suggest
from worlds.drawing import require_matplotlib

OUT: Final = Path("out/experiments")
ALONE: Final = ("live", "lost", "plan", "corridor", "mapping", "disturbed", "baselines", "all")
"""Commands that replace the names of figures."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, and return the exit code (docs/exit-codes.md)."""
    # The first word selects the command; anything else is the name of a figure.
    given = list(sys.argv[1:] if arguments is None else arguments)
    try:
        match given[:1]:
            case ["live"]:
                live.main(given[1:])
            case ["lost"]:
                lost_command.main(given[1:])
            case ["plan"]:
                plan_command.main(given[1:])
            case ["disturbed"]:
                disturbed.main(given[1:])
            case ["mapping"]:
                mapping.main(given[1:])
            case ["corridor"]:
                corridor.main(given[1:])
            case ["baselines"]:
                baselines.main(given[1:])
            case ["all"]:
                _drive_all(given[1:])
            case _:
                _drive_figures(given)
    except (NomadError, OSError) as error:
        print(f"localization.experiments: {error}", file=sys.stderr)
        return ExitCode.USAGE if isinstance(error, NomadError) and error.usage else ExitCode.FAILED
    except KeyboardInterrupt:
        return ExitCode.INTERRUPTED
    return ExitCode.DONE


def _drive_all(arguments: list[str]) -> None:
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
    lost_command.main(numbers)
    plan_command.main(numbers)


def _parts() -> dict[str, str]:
    """Return the figures that are drawn with the run of another figure, and that figure."""
    return {figure.errors_figure: name for name, figure in FIGURES.items() if figure.errors_figure}


def _figure(text: str) -> str:
    """Return the name of a figure. Raises ArgumentTypeError, also for a figure that is drawn with another one."""
    # Figures of errors are drawn with the run they belong to.
    if text in _parts():
        run = _parts()[text]
        raise argparse.ArgumentTypeError(f"figure {text} shows the errors of {run} and is drawn with it: use {run}")
    if text in ALONE:
        raise argparse.ArgumentTypeError(f"{text} is a command, not a figure: give it first and without figures")
    if text not in FIGURES:
        raise argparse.ArgumentTypeError(
            f"unknown figure {text!r}; expected one of {', '.join(FIGURES)}, or first a command: {', '.join(ALONE)}"
            f"{suggest(text, (*FIGURES, *ALONE))}"
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
    setup = figure_setup(figure)
    total = options.seeds * setup.min_steps
    with progress(total, f"figure {figure.name}", "steps") as report:
        if options.cluster:
            result = drive_on_cluster(figure, range(options.seeds), options.cluster, report)
        else:
            result = drive(figure, range(options.seeds), options.jobs, report)
        report(total)
    # 2. Results: JSON, pictures, table.
    summary = summarize(figure, result.results)
    text = json.dumps(summary)
    numbers = options.out / f"figure_{figure.name}.json"
    numbers.write_text(text + "\n", encoding="utf-8")
    written = [numbers]
    if options.pictures:
        written += execution.draw(figure, setup, result.tracks, options.out)
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


if __name__ == "__main__":
    sys.exit(main())
