"""`python -m localization.experiments ring`: what a ring of sonars without odometry shows of a room.

A plane wall reflects into all sonars within half a cone of its normal at the same range, its perpendicular distance: a
run of neighbouring sonars of nearly equal readings, in the direction of the wall. Such runs, the distances of opposite
ones, and what changes from one row to the next are counted; nothing is estimated.

References
----------
Leonard, Durrant-Whyte, Directed Sonar Sensing for Mobile Robot Navigation (1992): regions of constant depth.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from localization.filters.belief import Floats
from localization.plot import check_picture, save
from nclient.common.arguments import Parser
from nclient.errors import LogFileError
from worlds.drawing import ESTIMATE, FAINT, TRUTH, blank

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NO_ECHO_M: Final = 5.0
RATE_HZ: Final = 9.0
SAME_M: Final = 0.05
"""Neighbouring readings of one wall differ by less."""
MIN_SONARS: Final = 3
"""Sonars of a run: 30 degrees between the axes of the outer ones, two halves of a cone and more."""
JUMP_M: Final = 0.5
"""A reading that changes by more in one row changes by more than the robot can move."""
APART: Final = (3, 9)
"""Directions of two walls that determine a position, in steps of the ring: 45 to 135 degrees."""
OPPOSITE: Final = 1.0
"""Two walls are opposite within so many steps."""
BIN_M, MIN_FRACTION = 0.05, 0.02
"""Bins of the distances of opposite walls; those with a smaller fraction of the pairs are between two widths."""


class Run(NamedTuple):
    """Neighbouring sonars of equal readings: direction of their middle in steps of the ring, number, mean range (m)."""

    direction: float
    sonars: int
    range_m: float


class Width(NamedTuple):
    """A distance of opposite walls that occurs often: number of pairs, their median and standard deviation in m."""

    pairs: int
    median_m: float
    std_m: float


class RingStatistics(NamedTuple):
    """Counts over all rows; fractions are of 1. The field's names are those of the JSON."""

    rows: int
    no_echo: float
    jumps: float
    in_runs: float
    runs_per_row: float
    rows_with_position: float
    median_change_m: float
    opposite_m: tuple[float, ...]
    """Distances of opposite runs, from sonar to sonar."""

    @property
    def widths(self) -> list[Width]:
        """The distances of opposite walls that occur often, in order."""
        distances = np.sort(self.opposite_m)
        bins = np.floor(distances / BIN_M).astype(np.intp)
        often = np.bincount(bins)[bins] >= MIN_FRACTION * len(distances)
        distances, bins = distances[often], bins[often]
        parts = np.split(distances, np.flatnonzero(np.diff(bins) > 1) + 1) if len(distances) else []
        return [Width(len(part), float(np.median(part)), float(part.std())) for part in parts]


def read_ring(path: Path) -> Floats:
    """Return the readings (n, s) of a CSV of ranges in m, whose last column is a label; no echo is inf.

    Raises
    ------
    LogFileError
        If a row has no numbers, or another number of them than the first.
    """
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))[1:]
    try:
        readings = np.array([[float(field) for field in row[:-1]] for row in rows])
    except ValueError as error:
        raise LogFileError(f"{path}: expected ranges in m and a label in each row ({error})") from None
    return np.where(readings >= NO_ECHO_M, np.inf, readings)


def runs_of(row: Floats) -> list[Run]:
    """Return the runs of at least MIN_SONARS neighbouring sonars (s,) whose successive readings differ by < SAME_M."""
    count = len(row)
    following = np.roll(row, -1)
    known = np.isfinite(row) & np.isfinite(following)
    same = np.zeros(count, dtype=np.bool_)
    same[known] = np.abs(row[known] - following[known]) < SAME_M
    if same.all():
        return []
    # The ring is cut where two neighbours differ.
    first = int(np.flatnonzero(~same)[0]) + 1
    parts = np.split(np.arange(first, first + count), np.flatnonzero(~np.roll(same, -first)[:-1]) + 1)
    return [
        Run(float((part[0] + part[-1]) / 2.0 % count), len(part), float(row[part % count].mean()))
        for part in parts if len(part) >= MIN_SONARS
    ]  # fmt: skip


def statistics_of(readings: Floats) -> RingStatistics:
    """Return the statistics of the readings (n, s) of a ring of equal angles."""
    count = readings.shape[1]
    per_row = [runs_of(row) for row in readings]
    position, opposite = 0, list[float]()
    for runs in per_row:
        apart = [
            (abs((one.direction - other.direction + count / 2) % count - count / 2), one.range_m + other.range_m)
            for number, one in enumerate(runs) for other in runs[:number]
        ]  # fmt: skip
        position += any(APART[0] <= steps <= APART[1] for steps, _ in apart)
        opposite += [width for steps, width in apart if steps >= count / 2 - OPPOSITE]
    both = np.isfinite(readings[1:]) & np.isfinite(readings[:-1])
    change = np.abs(readings[1:][both] - readings[:-1][both]) if both.any() else np.zeros(1)
    return RingStatistics(
        len(readings), float(np.isinf(readings).mean()), float((change > JUMP_M).mean()),
        sum(run.sonars for runs in per_row for run in runs) / readings.size,
        sum(map(len, per_row)) / len(readings), position / len(readings), float(np.median(change)), tuple(opposite),
    )  # fmt: skip


def main(arguments: Sequence[str]) -> None:
    """Run the command."""
    parser = Parser(
        prog="python -m localization.experiments ring",
        description="Count what a ring of 24 sonars without odometry shows of a room: walls, distances of opposite "
        "ones, readings without echo.",
        epilog="example: python -m localization.experiments ring --data scitos_ring24/scitos_ring24.csv",
    )
    parser.add_argument("--data", type=Path, required=True, metavar="CSV",
                        help="ranges in m and a label in each row (docs/real-data.md)")  # fmt: skip
    parser.add_argument("--row", type=int, default=0, metavar="N", help="row that --picture shows (default: 0)")
    parser.add_argument("--picture", type=Path, metavar="PNG", help="draw a row and the distances of opposite walls")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args(arguments)
    if options.picture:
        check_picture(options.picture)
    readings = read_ring(options.data)
    found = statistics_of(readings)
    if options.picture:
        save(_picture(readings[options.row], found), options.picture)
    print(json.dumps(found._asdict()) if options.json else _text(found), flush=True)


def _text(found: RingStatistics) -> str:
    widths = ", ".join(f"{width.median_m:.2f} m ({width.pairs}, ± {width.std_m:.2f} m)" for width in found.widths)
    return "\n".join((
        f"{found.rows} rows, {found.rows / RATE_HZ:.0f} s",
        f"readings without echo: {found.no_echo:.1%}",
        f"readings that change by more than {JUMP_M:g} m in one row: {found.jumps:.1%}; "
        f"median change {found.median_change_m:g} m",
        f"readings in runs, which walls give: {found.in_runs:.0%}",
        f"runs in a row: {found.runs_per_row:.2f}",
        f"rows with walls in two directions: {found.rows_with_position:.0%}",
        f"pairs of opposite walls: {len(found.opposite_m)}; distances from sonar to sonar that occur often: {widths}",
    ))  # fmt: skip


def _picture(row: Floats, found: RingStatistics) -> Figure:
    """Draw one row with its runs, and the distances of opposite walls."""
    figure: Any = blank(9.0, 4.0)
    ring, widths = figure.subplots(1, 2)
    step = 2.0 * np.pi / len(row)
    angles = step * np.arange(len(row))
    for angle, range_m in zip(angles, np.minimum(row, NO_ECHO_M), strict=True):
        ring.plot((0.0, range_m * np.cos(angle)), (0.0, range_m * np.sin(angle)), color=FAINT, linewidth=1.0)
    heard = np.isfinite(row)
    ring.plot(row[heard] * np.cos(angles[heard]), row[heard] * np.sin(angles[heard]), "o", color=ESTIMATE, markersize=3)
    for run in runs_of(row):
        # The wall: as long as what the sonars of the run reach, at a right angle to the direction of its middle.
        half = run.range_m * np.tan(min(0.5 * (run.sonars - 1) * step, 1.0))
        c, s = np.cos(run.direction * step), np.sin(run.direction * step)
        ring.plot((run.range_m * c - half * s, run.range_m * c + half * s),
                  (run.range_m * s + half * c, run.range_m * s - half * c), color=TRUTH, linewidth=2.0)  # fmt: skip
    ring.set(xlabel="x (m)", ylabel="y (m)", aspect="equal")
    widths.hist(found.opposite_m, bins=np.arange(1.0, 5.0, 0.1).tolist(), color=FAINT)
    widths.set(xlabel="distance of opposite walls (m)", ylabel="pairs")
    return figure  # type: ignore[no-any-return]
