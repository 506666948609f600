"""`python -m localization.experiments live`: methods side by side on live robots in simulation, as a table.

Rules: words and files only; trials are matrix's, who runs them is crew's. With --json the rows are alone on stdout.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from localization.command_line.readers import make_folder
from localization.experiments.fingerprint import fingerprint
from localization.experiments.live import matrix, report, tum
from localization.experiments.live.matrix import COMPARED, Done, Job, Trial, trials
from localization.experiments.live.scenario import COURSES, SCENARIOS
from localization.experiments.live.store import Store
from localization.experiments.live.summary import TrialResult
from localization.experiments.live.trial import MOST_PERIODS
from localization.experiments.options import add_shared, crew_for, positive
from localization.experiments.progress import Tally, progress
from localization.filters.registry import METHODS
from localization.runs.drawing import require_matplotlib

Crew = Callable[[Sequence[Job]], Iterator[Done]]


def main(arguments: Sequence[str]) -> None:
    """Run the command. Raises what the crew and the files raise."""
    options = _parser().parse_args(arguments)
    if options.pictures:
        require_matplotlib()
    make_folder(options.out)
    wanted = trials(options.scenario, options.figures, options.methods, options.seeds, options.periods)
    store = Store(options.out / "trials", fingerprint())
    with progress(len(wanted), "live", "trials") as tally:
        results = collect(wanted, store, options.tum, crew_for(matrix.run, options), tally)
    found = matrix.summaries(results)
    written = report.write(found, options.out, picture=options.pictures)
    print(json.dumps(report.rows(found)) if options.json else report.table(found), flush=True)
    print(f"written: {', '.join(map(str, written))}", file=sys.stderr if options.json else sys.stdout, flush=True)


def collect(
    wanted: Sequence[Trial], store: Store, paths: Path | None, work: Crew, tally: Tally
) -> dict[Trial, TrialResult]:
    """The results of all trials in their order: from the store, and what is not there by work, kept as it is done.

    `paths`: a folder for the paths of all of them; a trial whose paths are not there, or older, is driven again.
    """
    results = {trial: store.get(trial) for trial in wanted}
    jobs = [
        Job(trial, paths is not None)
        for trial, result in results.items()
        if result is None or (paths and not _drawn(paths, trial, store))
    ]
    tally(done := len(wanted) - len(jobs))
    for trial, result, record in work(jobs):
        store.put(trial, result)
        if paths and record:
            tum.write(paths, trial, record)
        results[trial] = result
        tally(done := done + 1)
    return {trial: result for trial, result in results.items() if result}


def _drawn(folder: Path, trial: Trial, store: Store) -> bool:
    """Whether the paths of a trial are written, no earlier than its result."""
    since = store.path(trial).stat().st_mtime_ns
    return all(path.exists() and path.stat().st_mtime_ns >= since for path in tum.paths(folder, trial).values())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m localization.experiments live",
        description="Drive simulated robots over the same interface as real ones, on the estimates of each method, and "
        "say how good they are: RMSE, consistency, jitter, time, runs lost. Trials that are on disk are not driven "
        "again. `smoother` looks back: its numbers are of where the robot was some 2 s before.",
        epilog="example: python -m localization.experiments live --scenario exact --methods ekf ukf --seeds 10",
    )
    parser.add_argument("--scenario", nargs="+", choices=list(SCENARIOS), default=list(SCENARIOS), metavar="NAME",
                        help=f"what errs and how: {', '.join(SCENARIOS)} (all)")
    parser.add_argument("--figures", nargs="+", choices=list(COURSES), default=list(COURSES), metavar="FIGURE",
                        help=f"whose path: {', '.join(COURSES)} (all)")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(COMPARED), metavar="METHOD",
                        help=f"of {', '.join(METHODS)} (default {' '.join(COMPARED)})")
    parser.add_argument("--periods", type=positive, default=MOST_PERIODS, metavar="N",
                        help="give a trial up after so many tenths of a second (%(default)s)")
    parser.add_argument("--tum", type=Path, metavar="DIR", help="write the paths of all trials there, for evo")
    add_shared(parser, Path("out/experiments"), "row of the table")
    return parser
