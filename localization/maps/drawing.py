"""The picture of a map: what is reached, how well a filter can know its place there, and what is wrong with the walls.

Rules: draws what it is given (see localization.runs.drawing).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from localization.filters.belief import Floats
from localization.runs.drawing import ESTIMATE, GOAL, blank, draw_walls, save
from worlds.checking import Finding, Space
from worlds.world import World

MOST_SHOWN_IN = 3.0
"""Beyond this all is equally bad."""


def draw_map(path: Path, world: World, found: Space, worst_in: Floats, findings: Sequence[Finding]) -> None:
    """A PNG file. `worst_in` (k,): of the places of `found` that are reached, row by row."""
    picture = blank(8.0, 7.0)
    axes = picture.subplots()
    axes.set_aspect("equal")
    over = np.full(found.reached.shape, np.nan)
    over[found.reached] = worst_in
    top = min(MOST_SHOWN_IN, float(np.nanmax(over, initial=0.01)))
    least = min(float(np.nanmin(over, initial=top)), 0.9 * top)
    colours = axes.pcolormesh(found.xs, found.ys, over.T, shading="nearest", cmap="viridis_r", vmin=least, vmax=top)
    bar = picture.colorbar(colours, ax=axes, extend="max", shrink=0.85)
    bar.set_label("bound on the position's std, worst direction (in)")
    draw_walls(axes, world.walls)
    starts = np.array([(start.x_in, start.y_in) for start in world.starts])
    axes.plot(*starts.T, marker="o", color=GOAL, linestyle="", label="starts")
    if findings:
        places = np.array([finding.place_in for finding in findings])
        axes.plot(*places.T, marker="x", color=ESTIMATE, markersize=9, linestyle="", label="findings")
    axes.set(xlabel="x (in)", ylabel="y (in)", title=world.title or world.name)
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, frameon=False)
    save(picture, path)
