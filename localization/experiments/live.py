"""`python -m localization.experiments live`: compare filters on simulated live robots.

Paths are written in TUM format for evo and similar tools, one pose per line: "time x y z qx qy qz qw", in seconds and
metres. A trial has three: truth, odometry, estimate; for the smoother all three are of the times it estimates.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from localization.cli.arguments import make_folder
from localization.experiments import execution, live_trial
from localization.experiments.live_trial import Cell, Trial, TrialResult
from localization.filters.belief import Floats
from localization.filters.registry import METHODS
from localization.plot import save
from nclient.common.arguments import add_value
from worlds.drawing import blank, require_matplotlib

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Matrix = Mapping[Cell, live_trial.LiveSummary]
Row = dict[str, float | str | None]

METRES_PER_INCH: Final = 0.0254
# Expected values of a consistent filter: three degrees of freedom, and the probability of the ellipse.
RIGHT_NEES, RIGHT_COVERAGE = 3.0, 0.95


class Column(NamedTuple):
    """A column of the table: key, title, format, and a measure of badness (0: best) for the colours."""

    key: str
    title: str
    form: str
    badness: Callable[[float], float] = float


COLUMNS: Final = (
    Column("rmse_position_in", "position RMSE (in)", ".3f"),
    Column("rmse_heading_deg", "heading RMSE (deg)", ".2f"),
    # A NEES of half or twice the expected value is equally bad, hence the logarithm.
    Column("nees_mean", "NEES (3 is right)", ".2f", lambda value: abs(math.log(max(value, 1e-9) / RIGHT_NEES))),
    Column("coverage95", "in the 95 % ellipse", ".1%", lambda value: abs(value - RIGHT_COVERAGE)),
    Column("jitter", "jitter / odometry's", ".2f"),
    Column("step_us", "CPU time a step (us)", ".0f"),
    Column("share_lost", "runs lost", ".0%"),
    Column("share_reached", "runs that reach all", ".0%", lambda value: 1.0 - value),
)


def rows(matrix: Matrix) -> list[Row]:
    """Return one row per cell: its names, the numbers of its summary, and the fractions of runs lost and reached."""
    return [
        {
            **cell._asdict(),
            "world": cell.world,
            **{key: value for key, value in summary.items() if isinstance(value, int | float) or value is None},
            "share_lost": summary["lost"] / summary["seeds"],
            "share_reached": summary["reached"] / summary["seeds"],
        }
        for cell, summary in matrix.items()
    ]


def table(matrix: Matrix) -> str:
    """Return the matrix as a text table."""
    names = {"scenario": "scenario", "path": "figure", "method": "method", "seeds": "seeds"}
    columns = ((column.title, column.key, column.form) for column in COLUMNS)
    return execution.table_of(names, columns, rows(matrix))


def write(matrix: Matrix, folder: Path, *, picture: bool) -> list[Path]:
    """Write live.csv, live.json and live.png into a folder; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    # 1. The same rows as CSV and as JSON.
    written = [folder / "live.csv", folder / "live.json"]
    found = rows(matrix)
    with written[0].open("w", encoding="utf-8", newline="") as file:
        sheet = csv.DictWriter(file, list(found[0]))
        sheet.writeheader()
        sheet.writerows(found)
    written[1].write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    # 2. The picture needs matplotlib, which is optional.
    if picture:
        written.append(folder / "live.png")
        _draw(matrix, written[-1])
    return written


def _draw(matrix: Matrix, path: Path) -> None:
    """Draw one panel per number: methods down, scenarios and paths across, better values lighter."""
    found = dict(zip(matrix, rows(matrix), strict=True))
    # 1. Rows and columns of the panels, in the order of the cells; dict.fromkeys removes repeats.
    across = list(dict.fromkeys((cell.scenario, cell.figure) for cell in found))
    down = list(dict.fromkeys(cell.method for cell in found))
    # 2. Panel sizes in inches of paper, from the number of cells and the space for labels.
    wide = max(2.4, 0.62 * len(across) + 1.2)
    picture = blank(4 * wide, 2 * (0.42 * len(down) + 1.5))
    panels = picture.subplots(2, 4, squeeze=False).ravel()
    # 3. One panel per column of the table; missing cells become NaN, which imshow leaves white.
    for number, (axes, column) in enumerate(zip(panels, COLUMNS, strict=True)):
        grid = [
            [found.get(Cell(scenario, figure, method), {}).get(column.key) for scenario, figure in across]
            for method in down
        ]
        _panel(axes, column, np.array(grid, dtype=np.float64))
        axes.set_xticks(range(len(across)), [f"{scenario}\n{figure}" for scenario, figure in across], fontsize=7)
        axes.set_yticks(range(len(down)), down if number % 4 == 0 else [""] * len(down))
    runs = next(iter(matrix.values()))["seeds"]
    picture.suptitle(f"Live localization, {runs} seeds per cell: methods, noise, paths")
    save(picture, path)


def _panel(axes: Axes, column: Column, grid: np.typing.NDArray[np.float64]) -> None:
    # Twice the worst value as upper limit: the darkest cell stays light enough to read its number.
    bad = np.array([[column.badness(value) for value in line] for line in grid])
    worst = max(float(np.nanmax(bad, initial=0.0)), 1e-9)
    axes.imshow(bad, cmap="OrRd", vmin=0.0, vmax=2.0 * worst, aspect="auto")
    for (line, place), value in np.ndenumerate(grid):
        text = "-" if math.isnan(value) else format(value, column.form)
        axes.text(place, line, text, ha="center", va="center", fontsize=7)
    axes.set_title(column.title, fontsize=9)
    axes.tick_params(length=0)


def lines(clock_s: Floats, poses: Floats) -> str:
    """Return poses (T, 3) in inches and radians at times (T,) in TUM format: "time x y z qx qy qz qw"."""
    # TUM format is in metres, with the rotation about z as a quaternion (0, 0, sin, cos) of half the heading.
    x, y = (METRES_PER_INCH * poses[:, :2]).T
    half = 0.5 * poses[:, 2]
    rows = zip(clock_s, x, y, np.sin(half), np.cos(half), strict=True)
    return "".join(f"{t:.6f} {east:.9f} {north:.9f} 0 0 0 {qz:.12f} {qw:.12f}\n" for t, east, north, qz, qw in rows)


def paths(folder: Path, trial: Trial) -> dict[str, Path]:
    """Return the files of a trial's paths: truth, odometry, estimate."""
    stem = f"{'_'.join(trial.cell)}_{trial.seed:04d}"
    return {name: folder / f"{stem}_{name}.tum" for name in ("truth", "odometry", "estimate")}


def write_tum(folder: Path, trial: Trial, record: live_trial.Record) -> None:
    """Write the paths of a trial, creating their folder."""
    folder.mkdir(parents=True, exist_ok=True)
    poses = {"truth": record.truth, "odometry": record.encoders, "estimate": record.mean}
    for name, path in paths(folder, trial).items():
        path.write_text(lines(record.clock_s, poses[name]), encoding="utf-8")


def trial_cache(folder: Path, code: str) -> execution.ResultCache[Trial, TrialResult]:
    """Return the cache of trials run by code with this hash."""

    def key(trial: Trial) -> tuple[str, object]:
        decided_by = (trial.figure, trial.seed, trial.periods, asdict(trial.scenario))
        return f"{'_'.join(trial.cell)}_{trial.seed:04d}", decided_by

    return execution.ResultCache(folder, code, TrialResult, key)


Executor = Callable[[Sequence[live_trial.TrialJob]], Iterator[live_trial.FinishedTrial]]


def main(arguments: Sequence[str]) -> None:
    """Run the command; errors of execution and files are propagated."""
    options = _parser().parse_args(arguments)
    if options.pictures:
        require_matplotlib()
    make_folder(options.out)
    # 1. Trials, from the cache or by running them.
    requested = live_trial.trials(options.scenario, options.figures, options.methods, options.seeds, options.periods)
    cache = trial_cache(options.out / "trials", execution.code_hash())
    with execution.progress(len(requested), "live", "trials") as tally:
        results = collect(requested, cache, options.tum, execution.executor_for(live_trial.run, options), tally)
    # 2. Summaries as files and as table.
    found = live_trial.summaries(results)
    written = write(found, options.out, picture=options.pictures)
    print(json.dumps(rows(found)) if options.json else table(found), flush=True)
    print(f"written: {', '.join(map(str, written))}", file=sys.stderr if options.json else sys.stdout, flush=True)


def collect(requested: Sequence[Trial], cache: execution.ResultCache[Trial, TrialResult], paths: Path | None,
            work: Executor, tally: execution.Tally) -> dict[Trial, TrialResult]:  # fmt: skip
    """Return the results of all trials in order, from the cache or by running them.

    With a folder `paths`, trials whose path files are missing or older than the result are run again.
    """

    def run(batch: Sequence[Trial]) -> Iterator[tuple[Trial, TrialResult]]:
        for trial, result, record in work([live_trial.TrialJob(trial, paths is not None) for trial in batch]):
            yield trial, result
            # Written after the result, so that the files are not older.
            if paths and record:
                write_tum(paths, trial, record)

    def is_current(trial: Trial) -> bool:
        return not paths or _has_paths(paths, trial, cache)

    return execution.run_cached(requested, cache, run, tally, is_current)


def _has_paths(folder: Path, trial: Trial, cache: execution.ResultCache[Trial, TrialResult]) -> bool:
    """Return True if the path files of a trial exist and are not older than its result."""
    since = cache.path(trial).stat().st_mtime_ns
    return all(path.exists() and path.stat().st_mtime_ns >= since for path in paths(folder, trial).values())


def _parser() -> argparse.ArgumentParser:
    parser = execution.parser_of("live", "--scenario exact --methods ekf ukf --seeds 10",
                                 "Compare filters on simulated robots driven over the same interface as real ones: "
                                 "RMSE, consistency, jitter, computing time, lost runs. Results are cached. The "
                                 "numbers of `smoother` apply to poses about 2 s ago.")
    execution.add_choice(parser, "--scenario", live_trial.SCENARIOS, list(live_trial.SCENARIOS), "error scenarios")
    execution.add_choice(parser, "--figures", live_trial.COURSES, list(live_trial.COURSES), "paths of these figures")
    execution.add_choice(parser, "--methods", METHODS, list(live_trial.COMPARED), "filters")
    add_value(parser, "--periods", "N", execution.positive,
              "end a trial after this number of periods of 0.1 s", live_trial.MAX_PERIODS)
    add_value(parser, "--tum", "DIR", Path, "write the paths of all trials to this folder, in TUM format")
    execution.add_shared(parser, Path("out/experiments"), "row of the table")
    return parser
