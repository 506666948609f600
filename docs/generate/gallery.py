"""Generate the gallery of docs/worlds.md: a picture of each shipped world, and its title and size."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from worlds.io import load_world, parse_world, world_names
from worlds.world import IN_PER_M, world_svg

FOLDER = "docs/figures/worlds"


def measured_room() -> str:
    """Return the picture of the world in docs/map-your-room.md."""
    page = Path(__file__).parents[1] / "map-your-room.md"
    _, _, rest = page.read_text(encoding="utf-8").partition("```toml\n")
    return world_svg(parse_world(rest.partition("```")[0], page.name, "my_room"))


def blocks() -> dict[str, Iterator[str]]:
    """Return the table of the page."""
    return {"gallery": _rows()}


def _rows() -> Iterator[str]:
    yield from ("| world | picture |", "|---|---|")
    for name in world_names():
        world = load_world(name)
        width_m, height_m = np.ptp(world.walls.reshape(-1, 2), axis=0) / IN_PER_M
        size = f"{width_m:.3g} x {height_m:.3g} m, {len(world.walls)} walls, {len(world.starts)} starts"
        yield f"| **{name}**<br>{world.title}<br>{size} | ![{name}](figures/worlds/{name}.svg) |"
