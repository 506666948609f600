"""Many runs of the filter that knows when it is lost, in numbers and in words. Rules: pure.

`python -m localization.experiments lost`: does the finder know when it is lost, and does it find itself, as numbers.

Rules: words and files only; a run is trial's, who does the work is crew's. With --json the numbers are alone on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import groupby
from math import sqrt
from pathlib import Path
from typing import Final, NamedTuple, TypedDict

from localization.cli.options import make_folder
from localization.experiments.execution import ResultCache, code_hash, progress
from localization.experiments.live_trial import SCENARIOS
from localization.experiments.lost_trial import Case, Kind, LostResult, drive
from localization.experiments.output import add_work, executor_for, positive
from worlds.io import world_names

SOON_S: Final = 5.0
"""Within this LOST is to be said after a kidnapping."""


class LostSummary(TypedDict):
    """The numbers of all runs of a kind in a world; None where the kind has none of it.

    false_alarms    LOST said of a robot that was not        alarmed         runs with one or more of them
    told, soon      kidnappings that LOST was said of, and within SOON_S of them
    found           runs that found themselves, rightly      mistaken        runs that believed a wrong place in the end
    ..._s           the median and the greatest of what was so
    """

    kind: str
    world: str
    scenario: str
    runs: int
    hours: float
    false_alarms: int
    alarmed: int
    degraded: float
    rmse_in: float | None
    told: int | None
    soon: int | None
    told_s: tuple[float, float] | None
    found: int | None
    mistaken: int | None
    found_s: tuple[float, float] | None


def summaries(outcomes: Mapping[Case, LostResult]) -> list[LostSummary]:
    """The numbers of each kind, world and scenario, in the order of the cases."""

    def group(case: Case) -> tuple[Kind, str, str]:
        return case.kind, case.world, case.scenario.name

    return [
        summarize(*name, [outcomes[case] for case in cases]) for name, cases in groupby(outcomes, group)
    ]


def summarize(kind: Kind, world: str, scenario: str, outcomes: Sequence[LostResult]) -> LostSummary:
    """The numbers of one run or more."""
    seconds = sum(outcome.seconds for outcome in outcomes)
    summary = LostSummary(
        kind=kind.value,
        world=world,
        scenario=scenario,
        runs=len(outcomes),
        hours=seconds / 3600.0,
        false_alarms=sum(outcome.alarms for outcome in outcomes),
        alarmed=sum(outcome.alarms > 0 for outcome in outcomes),
        degraded=sum(outcome.degraded * outcome.seconds for outcome in outcomes) / seconds,
        rmse_in=_rmse_in(outcomes),
        told=None,
        soon=None,
        told_s=None,
        found=None,
        mistaken=None,
        found_s=None,
    )
    if kind is Kind.KIDNAPPED:
        _add_told(summary, outcomes)
    if kind is not Kind.TRACKING:
        _add_found(summary, outcomes)
    return summary


def _rmse_in(outcomes: Sequence[LostResult]) -> float | None:
    """Of all the time in which a place was believed."""
    squares = [(outcome.rmse_in**2, outcome.seconds) for outcome in outcomes if outcome.rmse_in is not None]
    weight = sum(share for _, share in squares)
    return sqrt(sum(square * share for square, share in squares) / weight) if weight else None


def _add_told(summary: LostSummary, outcomes: Sequence[LostResult]) -> None:
    after = [outcome.lost_after_s for outcome in outcomes if outcome.lost_after_s is not None]
    summary["told"], summary["told_s"] = len(after), _spread(after)
    summary["soon"] = sum(seconds <= SOON_S for seconds in after)


def _add_found(summary: LostSummary, outcomes: Sequence[LostResult]) -> None:
    after = [(outcome.found_after_s, outcome.right) for outcome in outcomes if outcome.found_after_s is not None]
    rightly = [seconds for seconds, right in after if right]
    summary["found"], summary["found_s"] = len(rightly), _spread(rightly)
    summary["mistaken"] = len(after) - len(rightly)


def words(summary: LostSummary) -> str:
    """For people."""
    lines = [
        f"{summary['kind']} in {summary['world']}, {summary['scenario']}: {summary['runs']} runs, "
        f"{summary['hours']:.1f} simulated hours"
    ]
    if summary["rmse_in"] is not None:
        lines.append(
            f"  {summary['false_alarms']} false alarms in {summary['alarmed']} runs; DEGRADED "
            f"{summary['degraded']:.2%} of the time; position RMSE {summary['rmse_in']:.2f} in"
        )
    if summary["told"] is not None:
        lines.append(
            f"  LOST said of {summary['told']}, of {summary['soon']} within {SOON_S:g} s{_times(summary['told_s'])}"
        )
    if summary["found"] is not None:
        lines.append(
            f"  found again rightly: {summary['found']}{_times(summary['found_s'])}; a wrong place believed: "
            f"{summary['mistaken']}"
        )
    return "\n".join(lines)


def _spread(times: Sequence[float]) -> tuple[float, float] | None:
    """The median and the greatest."""
    return (sorted(times)[len(times) // 2], max(times)) if times else None


def _times(spread: tuple[float, float] | None) -> str:
    return "" if spread is None else f" (median {spread[0]:.1f} s, at most {spread[1]:.1f} s)"


WORLD: Final = "several_walls"
RUNS: Final = {Kind.TRACKING: 300, Kind.KIDNAPPED: 100, Kind.UNKNOWN_START: 100}


class Done(NamedTuple):
    """A run and what came of it."""

    case: Case
    outcome: LostResult


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises what the crew and the files raise."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    cases = [
        Case(kind, options.world, SCENARIOS[options.scenario], seed, 60.0 * options.minutes)
        for kind in options.kinds
        for seed in range(options.runs or RUNS[kind])
    ]
    found = summaries(_outcomes(cases, ResultCache(options.out / "runs", code_hash()), options))
    path = options.out / "lost.json"
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found) if options.json else "\n".join(map(words, found)), flush=True)
    print(f"written: {path}", file=sys.stderr if options.json else sys.stdout, flush=True)


def run(case: Case) -> Done:
    """Make one run here and now."""
    return Done(case, drive(case))


def _outcomes(cases: Sequence[Case], kept: ResultCache, options: argparse.Namespace) -> dict[Case, LostResult]:
    """What came of all cases, in their order: what is kept, and what is not by work."""
    paths = {case: kept.path(case.name, (case,)) for case in cases}
    there = {case: found for case, path in paths.items() if (found := kept.get(path)) is not None}
    outcomes = {case: LostResult(**found) for case, found in there.items()}
    with progress(len(cases), "lost", "runs") as tally:
        tally(len(outcomes))
        for case, outcome in executor_for(run, options)([case for case in cases if case not in there]):
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
