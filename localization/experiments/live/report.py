"""The matrix in words and files: a table for people, CSV and JSON for programs, a PNG for a page.

Rules: says and draws what it is given. The rows of all are the same, COLUMNS says how each number is told.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from localization.experiments.live.matrix import Cell
from localization.experiments.live.summary import LiveSummary
from localization.runs.drawing import blank, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Matrix = Mapping[Cell, LiveSummary]
Row = dict[str, float | str | None]

RIGHT_NEES, RIGHT_COVERAGE = 3.0, 0.95


class Column(NamedTuple):
    """A number of the matrix: its key in a row, what it is called, how it is written, and how bad a value is (0: best),
    for the colours."""

    key: str
    title: str
    form: str
    badness: Callable[[float], float] = float


COLUMNS: Final = (
    Column("rmse_position_in", "position RMSE (in)", ".3f"),
    Column("rmse_heading_deg", "heading RMSE (deg)", ".2f"),
    Column("nees_mean", "NEES (3 is right)", ".2f", lambda value: abs(math.log(max(value, 1e-9) / RIGHT_NEES))),
    Column("coverage95", "in the 95 % ellipse", ".1%", lambda value: abs(value - RIGHT_COVERAGE)),
    Column("jitter", "jitter / odometry's", ".2f"),
    Column("step_us", "CPU time a step (us)", ".0f"),
    Column("share_lost", "runs lost", ".0%"),
    Column("share_reached", "runs that reach all", ".0%", lambda value: 1.0 - value),
)


def rows(matrix: Matrix) -> list[Row]:
    """A row a cell: its names, then all numbers of its summary, and the shares of runs lost and reached."""
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
    """For people."""
    heads = ["scenario", "path", "method", "seeds", *(column.title for column in COLUMNS)]
    body = [
        [str(row[key]) for key in ("scenario", "figure", "method", "seeds")]
        + [_written(row[column.key], column.form) for column in COLUMNS]
        for row in rows(matrix)
    ]
    widths = [max(len(line[k]) for line in (heads, *body)) for k in range(len(heads))]
    return "\n".join("  ".join(text.rjust(width) for text, width in zip(line, widths, strict=True)) for line in
                     (heads, *body))


def write(matrix: Matrix, folder: Path, *, picture: bool) -> list[Path]:
    """Write live.csv, live.json and live.png into a folder; where they are."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [folder / "live.csv", folder / "live.json"]
    found = rows(matrix)
    with written[0].open("w", encoding="utf-8", newline="") as file:
        sheet = csv.DictWriter(file, list(found[0]))
        sheet.writeheader()
        sheet.writerows(found)
    written[1].write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if picture:
        written.append(folder / "live.png")
        _draw(matrix, written[-1])
    return written


def _draw(matrix: Matrix, path: Path) -> None:
    """A panel a number: methods down, scenarios and paths across, the better the lighter."""
    found = dict(zip(matrix, rows(matrix), strict=True))
    across = list(dict.fromkeys((cell.scenario, cell.figure) for cell in found))
    down = list(dict.fromkeys(cell.method for cell in found))
    wide = max(2.4, 0.62 * len(across) + 1.2)
    picture = blank(4 * wide, 2 * (0.42 * len(down) + 1.5))
    panels = picture.subplots(2, 4, squeeze=False).ravel()
    for number, (axes, column) in enumerate(zip(panels, COLUMNS, strict=True)):
        grid = [
            [_number(found.get(Cell(scenario, figure, method), {}).get(column.key)) for scenario, figure in across]
            for method in down
        ]
        _panel(axes, column, np.array(grid))
        axes.set_xticks(range(len(across)), [f"{scenario}\n{figure}" for scenario, figure in across], fontsize=7)
        axes.set_yticks(range(len(down)), down if number % 4 == 0 else [""] * len(down))
    runs = next(iter(matrix.values()))["seeds"]
    picture.suptitle(f"Live localization, {runs} seeds a cell: methods, noise, paths")
    save(picture, path)


def _panel(axes: Axes, column: Column, grid: np.typing.NDArray[np.float64]) -> None:
    bad = np.array([[column.badness(value) for value in line] for line in grid])
    worst = max(float(np.nanmax(bad, initial=0.0)), 1e-9)
    axes.imshow(bad, cmap="OrRd", vmin=0.0, vmax=2.0 * worst, aspect="auto")
    for (line, place), value in np.ndenumerate(grid):
        axes.text(place, line, _written(float(value), column.form), ha="center", va="center", fontsize=7)
    axes.set_title(column.title, fontsize=9)
    axes.tick_params(length=0)


def _number(value: float | str | None) -> float:
    return float("nan") if value is None else float(value)


def _written(value: float | str | None, form: str) -> str:
    return "-" if value is None or math.isnan(float(value)) else format(float(value), form)
