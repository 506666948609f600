"""`python -m localization.experiments lost`: how reliably the filter `finder` detects that it is lost, and recovers."""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from itertools import groupby, pairwise
from math import sqrt
from pathlib import Path
from typing import Final, TypedDict

from localization.cli.arguments import make_folder
from localization.experiments.execution import ResultCache, code_hash, progress, run_cached
from localization.experiments.live_trial import SCENARIOS
from localization.experiments.lost_trial import START_LIMIT_S, STARTS, Case, Kind, LostResult, drive
from localization.experiments.output import add_choice, add_execution_options, add_output, executor_for, positive
from nclient.common.arguments import Parser, add_value
from worlds.io import load_world, world_names

# At the scenarios' 5 in/s the robot has driven at most 25 in by then.
SOON_S: Final = 5.0
"""A kidnapping should be detected within this time."""


class LostSummary(TypedDict):
    """Results of all runs of a kind in a world; None where a number does not apply.

    Attributes
    ----------
    hours
        Simulated time in hours.
    false_alarms, alarmed
        Number of times a localized robot was reported LOST, and number of runs with such alarms.
    degraded
        Fraction of the time with status DEGRADED.
    rmse_in
        Position RMSE while localized, in inches.
    told, soon
        Number of detected kidnappings, and of those detected within SOON_S.
    told_s, found_s
        Median and maximum of the times until detection and until recovery, in seconds.
    found, mistaken
        Number of runs with a correct and with a wrong recovery.
    alike, unique_found
        Number of unknown starts that look like other places of the map, and correct recoveries from the others.
    brier
        Mean Brier score of the probabilities that are stated meanwhile, 0 (certain and right) to 2.
    brier_expected
        The score that calibrated probabilities would have on average: k equal ones have 1 - 1 / k.
    reliability
        For bins of stated probabilities: their mean, the fraction that was right, and their number.
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
    alike: int | None
    unique_found: int | None
    brier: float | None
    brier_expected: float | None
    reliability: list[tuple[float, float, int]]


def summaries(results: Mapping[Case, LostResult]) -> list[LostSummary]:
    """Return the summary of each kind, world and scenario, in the order of the cases."""

    def group(case: Case) -> tuple[Kind, str, str]:
        return case.kind, case.world, case.scenario.name

    return [summarize(*name, [results[case] for case in cases]) for name, cases in groupby(results, group)]


def summarize(kind: Kind, world: str, scenario: str, results: Sequence[LostResult]) -> LostSummary:
    """Return the summary of one or more runs."""
    seconds = sum(result.seconds for result in results)
    # 1. Numbers that every kind of run has.
    summary = LostSummary(
        kind=kind.value,
        world=world,
        scenario=scenario,
        runs=len(results),
        hours=seconds / 3600.0,
        false_alarms=sum(result.alarms for result in results),
        alarmed=sum(result.alarms > 0 for result in results),
        # Weighted by duration, because runs end at different times.
        degraded=sum(result.degraded * result.seconds for result in results) / seconds,
        rmse_in=_rmse_in(results),
        told=None,
        soon=None,
        told_s=None,
        found=None,
        mistaken=None,
        found_s=None,
        alike=None,
        unique_found=None,
        brier=None,
        brier_expected=None,
        reliability=[],
    )
    # 2. Numbers of detection and recovery, where they apply.
    if kind is Kind.KIDNAPPED:
        _add_detections(summary, results)
    if kind is not Kind.TRACKING:
        _add_recoveries(summary, results)
    if kind in STARTS:
        unique = [result for result in results if not result.alike]
        summary["alike"] = len(results) - len(unique)
        summary["unique_found"] = sum(result.found_after_s is not None and result.right for result in unique)
        stated = [instant for result in results for instant in result.stated]
        summary["brier"], summary["brier_expected"] = brier_score(stated), expected_brier_score(stated)
        summary["reliability"] = reliability(stated)
    return summary


Stated = Sequence[Sequence[tuple[float, bool]]]
"""For each instant the probabilities of the hypotheses, and which was right."""
BINS: Final = (0.0, 0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.99, 1.0)


def brier_score(stated: Stated) -> float | None:
    """Return the mean of sum_i (p_i - [i is right])^2 over instants; where none is right, elsewhere was.

    References
    ----------
    Brier, Verification of forecasts expressed in terms of probability (1950).
    """
    if not stated:
        return None
    total = 0.0
    for instant in stated:
        # Hypotheses that are all right within the tolerance are one outcome.
        of_right = [probability for probability, right in instant if right]
        total += sum(probability**2 for probability, right in instant if not right)
        rest = sum(of_right) if of_right else 1.0 - sum(probability for probability, _ in instant)
        total += (1.0 - rest) ** 2
    return total / len(stated)


def expected_brier_score(stated: Stated) -> float | None:
    """Return the mean of `brier_score` if the stated probabilities, and elsewhere with the rest, are the true ones.

    The score of outcome i is 1 - 2 p_i + S, S = sum_j p_j^2, and that of elsewhere S + (1 - p)^2, p its probability.
    The mean is 1 - p + p (1 - p)^2 - S. Of k equal probabilities it is 1 - 1 / k.

    References
    ----------
    Brocker, Reliability, sufficiency, and the decomposition of proper scores (2009): the entropy of a forecast.
    """
    if not stated:
        return None
    total = 0.0
    for instant in stated:
        elsewhere = max(1.0 - sum(probability for probability, _ in instant), 0.0)
        squares = sum(probability**2 for probability, _ in instant)
        total += 1.0 - elsewhere + elsewhere * (1.0 - elsewhere) ** 2 - squares
    return total / len(stated)


def reliability(stated: Stated) -> list[tuple[float, float, int]]:
    """Return mean probability, fraction right and number of the stated probabilities in each bin that has any."""
    pairs = [pair for instant in stated for pair in instant]
    rows = []
    for low, high in pairwise(BINS):
        among = [pair for pair in pairs if low < pair[0] <= high]
        if among:
            mean = sum(probability for probability, _ in among) / len(among)
            rows.append((mean, sum(right for _, right in among) / len(among), len(among)))
    return rows


def _rmse_in(results: Sequence[LostResult]) -> float | None:
    """Return the position RMSE over the time localized."""
    # Squares are averaged with the durations as weights, then the root is taken.
    squares = [(result.rmse_in**2, result.seconds) for result in results if result.rmse_in is not None]
    total_s = sum(seconds for _, seconds in squares)
    return sqrt(sum(square * seconds for square, seconds in squares) / total_s) if total_s else None


def _add_detections(summary: LostSummary, results: Sequence[LostResult]) -> None:
    after = [result.lost_after_s for result in results if result.lost_after_s is not None]
    summary["told"], summary["told_s"] = len(after), _spread(after)
    summary["soon"] = sum(seconds <= SOON_S for seconds in after)


def _add_recoveries(summary: LostSummary, results: Sequence[LostResult]) -> None:
    # A recovery counts as correct if the recovered pose was within the tolerance.
    after = [(result.found_after_s, result.right) for result in results if result.found_after_s is not None]
    rightly = [seconds for seconds, right in after if right]
    summary["found"], summary["found_s"] = len(rightly), _spread(rightly)
    summary["mistaken"] = len(after) - len(rightly)


def words(summary: LostSummary) -> str:
    """Return a summary as text."""
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
            f"  detected (LOST): {summary['told']}, {summary['soon']} of them within {SOON_S:g} s"
            f"{_times(summary['told_s'])}"
        )
    if summary["found"] is not None:
        lines.append(
            f"  correct recoveries: {summary['found']}{_times(summary['found_s'])}; wrong recoveries: "
            f"{summary['mistaken']}"
        )
    if summary["alike"] is not None:
        lines.append(
            f"  starts that look like other places: {summary['alike']}; localized correctly within {START_LIMIT_S:g} s "
            f"of the other {summary['runs'] - summary['alike']}: {summary['unique_found']}"
        )
    if summary["brier"] is not None:
        rows = ", ".join(f"{stated:.0%}: {right:.0%} of {count}" for stated, right, count in summary["reliability"])
        lines.append(
            f"  stated probabilities: Brier score {summary['brier']:.3f}, {summary['brier_expected']:.3f} expected if "
            f"calibrated; right of those stated: {rows}"
        )
    return "\n".join(lines)


def _spread(times: Sequence[float]) -> tuple[float, float] | None:
    """Return median and maximum."""
    return (sorted(times)[len(times) // 2], max(times)) if times else None


def _times(spread: tuple[float, float] | None) -> str:
    return "" if spread is None else f" (median {spread[0]:.1f} s, at most {spread[1]:.1f} s)"


WORLD: Final = "several_walls"
# False alarms are rare, so tracking needs the most runs; 300 of 10 min are 50 simulated hours.
RUNS: Final = {Kind.TRACKING: 300, Kind.KIDNAPPED: 100, Kind.UNKNOWN_START: 100, Kind.WRONG_DOOR: 20}


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of execution and files are propagated."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    for world in options.worlds:
        load_world(world)
    # 1. All runs, by kind.
    cases = [
        Case(kind, world, SCENARIOS[options.scenario], seed, 60.0 * options.minutes)
        for kind in options.kinds
        for world in options.worlds
        for seed in range(options.runs or RUNS[kind])
    ]
    # 2. Results, from the cache or by running them.
    cache = run_cache(options.out / "runs", code_hash())
    with progress(len(cases), "lost", "runs") as tally:
        found = summaries(run_cached(cases, cache, executor_for(run, options), tally))
    # 3. Summary, as JSON file and as text.
    path = options.out / "lost.json"
    path.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(found) if options.json else "\n".join(map(words, found)), flush=True)
    print(f"written: {path}", file=sys.stderr if options.json else sys.stdout, flush=True)


def run_cache(folder: Path, code: str) -> ResultCache[Case, LostResult]:
    """Return the cache of runs made by code with this hash."""
    return ResultCache(folder, code, LostResult, lambda case: (case.name, case))


def run(case: Case) -> tuple[Case, LostResult]:
    """Make one run."""
    return case, drive(case)


def _kind(text: str) -> Kind:
    try:
        return Kind(text)
    except ValueError:
        # argparse shows this message instead of the name of the function.
        there = ", ".join(kind.value for kind in Kind)
        raise argparse.ArgumentTypeError(f"unknown kind {text!r}; expected one of {there}") from None


def _parser() -> argparse.ArgumentParser:
    parser = Parser(
        prog="python -m localization.experiments lost",
        description="Long runs of the method `finder`: tracking (calm), in which every LOST is a false alarm; robots "
        "moved elsewhere (kidnapped); robots with an unknown start (nowhere), or a start that looks like the "
        "true one (door). Results are cached.",
        epilog="example: python -m localization.experiments lost kidnapped --runs 20",
    )
    parser.add_argument(
        "kinds",
        nargs="*",
        type=_kind,
        default=[kind for kind in Kind if kind is not Kind.WRONG_DOOR],
        metavar="KIND",
        help=f"kinds of runs: {', '.join(kind.value for kind in Kind)} (default: all but door)",
    )
    parser.add_argument(
        "--world",
        "--worlds",
        dest="worlds",
        nargs="+",
        default=[WORLD],
        metavar="WORLD",
        help=f"shipped worlds or world files: {', '.join(world_names())} (default: {WORLD})",
    )
    add_choice(parser, "--scenario", SCENARIOS, "measured", "error scenario")
    numbers = ", ".join(f"{runs} {kind.value}" for kind, runs in RUNS.items())
    add_value(parser, "--runs --seeds", "N", positive, f"number of runs of each kind (default: {numbers})")
    add_value(parser, "--minutes", "M", float, "length of tracking runs in min", 10.0)
    add_execution_options(parser)
    add_output(parser, Path("out/experiments"), "kind")
    return parser
