"""`python -m localization.experiments plan`: random ways through the shipped worlds, driven with noise on, as a table.

Rules: words and files only; drives are drive's, who runs them is crew's. With --json the rows are alone on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from statistics import mean
from typing import Any, Final

from localization.command_line.readers import make_folder
from localization.experiments.fingerprint import fingerprint
from localization.experiments.kept import Kept
from localization.experiments.live.scenario import SCENARIOS
from localization.experiments.options import add_work, crew_for, positive
from localization.experiments.plan.drive import Driven, drive
from localization.experiments.plan.pairs import WORLDS, Pair
from localization.experiments.progress import Tally, progress

NEAR: Final = 1.05
"""A way is as good as the shortest up to this many times as long."""
Crew = Callable[[Sequence[Pair]], Iterator[tuple[Pair, Driven]]]


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises what the crew and the files raise."""
    options = _parser().parse_args(arguments)
    make_folder(options.out)
    wanted = [Pair(world, number, options.scenario) for number in range(options.pairs) for world in options.worlds]
    kept = Kept(options.out / "drives", fingerprint())
    with progress(len(wanted), "plan", "drives") as tally:
        results = collect(wanted, kept, crew_for(drive, options), tally)
    rows = [row(world, [results[pair] for pair in wanted if pair.world == world]) for world in options.worlds]
    written = options.out / f"plan_{options.scenario}.json"
    drives = [asdict(results[pair]) for pair in wanted]
    written.write_text(json.dumps({"worlds": rows, "drives": drives}, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(rows) if options.json else table(rows, list(results.values())), flush=True)
    print(f"written: {written}", file=sys.stderr if options.json else sys.stdout, flush=True)


def collect(wanted: Sequence[Pair], kept: Kept, work: Crew, tally: Tally) -> dict[Pair, Driven]:
    """All results: from disk, and what is not there by work, kept as it is done."""
    paths = {pair: kept.path(f"{pair.world}_{pair.scenario}_{pair.number:04d}", (asdict(pair),)) for pair in wanted}
    found = {pair: kept.get(path) for pair, path in paths.items()}
    results = {pair: Driven(**values) for pair, values in found.items() if values is not None}
    left = [pair for pair in wanted if pair not in results]
    tally(len(results))
    for pair, driven in work(left):
        kept.put(paths[pair], asdict(driven))
        results[pair] = driven
        tally(len(results))
    return results


def row(world: str, drives: Sequence[Driven]) -> dict[str, Any]:
    """The numbers of a world; ways as multiples of the shortest."""
    planned = [drive.planned_in / drive.shortest_in for drive in drives]
    driven = [drive.driven_in / drive.shortest_in for drive in drives]
    return {
        "world": world,
        "pairs": len(drives),
        "reached": sum(drive.ending == "done" for drive in drives),
        "contacts": sum(drive.contact for drive in drives),
        "least_room_in": min(drive.least_in for drive in drives),
        "worst_off_in": max(drive.off_in for drive in drives),
        "planned_mean": mean(planned),
        "planned_worst": max(planned),
        "driven_mean": mean(driven),
        "driven_worst": max(driven),
        "driven_near": sum(share <= NEAR for share in driven),
        "duration_mean_s": mean(drive.duration_s for drive in drives),
    }


_COLUMNS: Final = (
    ("pairs", "pairs", "d"), ("reached", "reached", "d"), ("contacts", "contacts", "d"),
    ("least room (in)", "least_room_in", ".2f"), ("worst off (in)", "worst_off_in", ".2f"),
    ("planned/shortest", "planned_mean", ".4f"), ("worst", "planned_worst", ".4f"),
    ("driven/shortest", "driven_mean", ".4f"), ("worst", "driven_worst", ".4f"), ("within 5 %", "driven_near", "d"),
    ("mean time (s)", "duration_mean_s", ".1f"),
)  # fmt: skip


def table(rows: Sequence[dict[str, Any]], drives: Sequence[Driven]) -> str:
    """For people; the drives that did not arrive, or touched, below."""
    lines = [["world", *(title for title, _, _ in _COLUMNS)]]
    lines += [[row["world"], *(format(row[key], form) for _, key, form in _COLUMNS)] for row in rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    told = ["  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True)) for line in lines]
    told += [
        f"{drive.world} {drive.number}: {drive.ending}{', CONTACT' if drive.contact else ''}: {drive.reason}"
        for drive in drives
        if drive.ending != "done" or drive.contact
    ]
    return "\n".join(told)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments plan",
        description="Drive a simulated N150 between random places of the shipped worlds by the shortest way, on the "
        "estimate, as `nomad go` does, and say whether it arrived, touched anything, and how long its way was "
        "against the shortest there is. Drives that are on disk are not driven again.",
        epilog="example: python -m localization.experiments plan --pairs 10 --worlds several_walls",
    )
    parser.add_argument("--pairs", "--seeds", type=positive, default=100, metavar="N", help="in each world (100)")
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=list(WORLDS), metavar="WORLD",
                        help=f"of {', '.join(WORLDS)} (all)")
    parser.add_argument("--scenario", choices=list(SCENARIOS), default="noisy",
                        help="what errs, without its bad readings (default %(default)s)")
    add_work(parser)
    parser.add_argument("--out", type=Path, default=Path("out/experiments"), metavar="DIR",
                        help="for the numbers (%(default)s)")
    parser.add_argument("--json", action="store_true", help="print JSON, alone on stdout")
    return parser
