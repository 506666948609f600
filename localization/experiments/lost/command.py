"""`python -m localization.experiments lost`: does the finder know when it is lost, and does it find itself, as numbers.

Rules: words and files only; a run is trial's, who does the work is crew's. With --json the numbers are alone on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

from localization.command_line.readers import make_folder
from localization.experiments.fingerprint import fingerprint
from localization.experiments.kept import Kept
from localization.experiments.live.scenario import SCENARIOS
from localization.experiments.lost.summary import summaries, words
from localization.experiments.lost.trial import Case, Kind, Outcome, drive
from localization.experiments.options import add_work, crew_for, positive
from localization.experiments.progress import progress
from worlds.files import world_names

WORLD: Final = "several_walls"
RUNS: Final = {Kind.CALM: 300, Kind.KIDNAPPED: 100, Kind.NOWHERE: 100}


class Done(NamedTuple):
    """A run and what came of it."""

    case: Case
    outcome: Outcome


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises what the crew and the files raise."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    cases = [
        Case(kind, options.world, SCENARIOS[options.scenario], seed, 60.0 * options.minutes)
        for kind in options.kinds
        for seed in range(options.runs or RUNS[kind])
    ]
    found = summaries(_outcomes(cases, Kept(options.out / "runs", fingerprint()), options))
    path = options.out / "lost.json"
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found) if options.json else "\n".join(map(words, found)), flush=True)
    print(f"written: {path}", file=sys.stderr if options.json else sys.stdout, flush=True)


def run(case: Case) -> Done:
    """Make one run here and now."""
    return Done(case, drive(case))


def _outcomes(cases: Sequence[Case], kept: Kept, options: argparse.Namespace) -> dict[Case, Outcome]:
    """What came of all cases, in their order: what is kept, and what is not by work."""
    paths = {case: kept.path(case.name, (case,)) for case in cases}
    there = {case: found for case, path in paths.items() if (found := kept.get(path)) is not None}
    outcomes = {case: Outcome(**found) for case, found in there.items()}
    with progress(len(cases), "lost", "runs") as tally:
        tally(len(outcomes))
        for case, outcome in crew_for(run, options)([case for case in cases if case not in there]):
            kept.put(paths[case], outcome.as_dict())
            outcomes[case] = outcome
            tally(len(outcomes))
    return {case: outcomes[case] for case in cases}


def _kind(text: str) -> Kind:
    try:
        return Kind(text)
    except ValueError:
        there = ", ".join(kind.value for kind in Kind)
        raise argparse.ArgumentTypeError(f"no kind {text!r}; there are {there}") from None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments lost",
        description="Long runs of the method `finder`: calm ones, in which every LOST is a false alarm; robots set "
        "down elsewhere; robots that are told nothing. Runs that are on disk are not made again.",
        epilog="example: python -m localization.experiments lost kidnapped --runs 20",
    )
    parser.add_argument("kinds", nargs="*", type=_kind, default=list(Kind), metavar="KIND",
                        help=f"of {', '.join(kind.value for kind in Kind)} (all)")
    parser.add_argument("--world", choices=world_names(), default=WORLD, metavar="NAME",
                        help="a shipped world (%(default)s: no two of its places are alike)")
    parser.add_argument("--scenario", choices=list(SCENARIOS), default="measured", metavar="NAME",
                        help=f"what errs and how: {', '.join(SCENARIOS)} (%(default)s)")
    parser.add_argument("--runs", "--seeds", type=positive, metavar="N",
                        help="of each kind (" + ", ".join(f"{runs} {kind.value}" for kind, runs in RUNS.items()) + ")")
    parser.add_argument("--minutes", type=float, default=10.0, metavar="M", help="of each calm run (%(default)s)")
    add_work(parser)
    parser.add_argument("--out", type=Path, default=Path("out/experiments"), metavar="DIR",
                        help="for the numbers (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON, an object a kind, alone on stdout")
    return parser
