"""Many runs of the filter that knows when it is lost, in numbers and in words. Rules: pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from math import sqrt
from typing import Final, TypedDict

from localization.experiments.lost.trial import Case, Kind, Outcome

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


def summaries(outcomes: Mapping[Case, Outcome]) -> list[LostSummary]:
    """The numbers of each kind, world and scenario, in the order of the cases."""

    def group(case: Case) -> tuple[Kind, str, str]:
        return case.kind, case.world, case.scenario.name

    return [
        summarize(*name, [outcomes[case] for case in cases]) for name, cases in groupby(outcomes, group)
    ]


def summarize(kind: Kind, world: str, scenario: str, outcomes: Sequence[Outcome]) -> LostSummary:
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
    if kind is not Kind.CALM:
        _add_found(summary, outcomes)
    return summary


def _rmse_in(outcomes: Sequence[Outcome]) -> float | None:
    """Of all the time in which a place was believed."""
    squares = [(outcome.rmse_in**2, outcome.seconds) for outcome in outcomes if outcome.rmse_in is not None]
    weight = sum(share for _, share in squares)
    return sqrt(sum(square * share for square, share in squares) / weight) if weight else None


def _add_told(summary: LostSummary, outcomes: Sequence[Outcome]) -> None:
    after = [outcome.lost_after_s for outcome in outcomes if outcome.lost_after_s is not None]
    summary["told"], summary["told_s"] = len(after), _spread(after)
    summary["soon"] = sum(seconds <= SOON_S for seconds in after)


def _add_found(summary: LostSummary, outcomes: Sequence[Outcome]) -> None:
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
