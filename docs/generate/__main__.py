"""Write the generated tables of the reference pages and of the C library: `python -m docs.generate [FILE...]`."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from docs.generate import c_table, commands, course, exit_codes, from_c, gallery, layers, limits, protocol, setups
from worlds.io import load_world, world_names
from worlds.world import world_svg

ROOT = Path(__file__).parents[2]
PAGES: dict[str, Callable[[], dict[str, Iterator[str]]]] = {
    "docs/architecture.md": layers.blocks,
    "docs/commands.md": commands.blocks,
    "docs/exit-codes.md": exit_codes.blocks,
    "docs/from-c.md": from_c.blocks,
    "docs/limits.md": limits.blocks,
    "docs/protocol.md": protocol.blocks,
    "docs/setups.md": setups.blocks,
    "docs/worlds.md": gallery.blocks,
}
"""Pages, and the functions that return the lines of their blocks by name."""
C_TABLE = "clib/src/commands.inc"
PICTURES = tuple(f"{gallery.FOLDER}/{name}.svg" for name in world_names())
MY_ROOM = "docs/figures/my_room.svg"
NOTEBOOKS = {f"docs/course/{name}.ipynb": name for name in course.NAMES}
FILES = (*PAGES, C_TABLE, *PICTURES, MY_ROOM, *NOTEBOOKS)
BLOCK = re.compile(r"(<!-- generated: (\w+) -->)\n.*?<!-- end -->\n", re.DOTALL)


def text(name: str) -> str:
    """Return the text of a file with its generated blocks replaced."""
    if name == C_TABLE:
        return c_table.table()
    if name in NOTEBOOKS:
        return course.text(NOTEBOOKS[name])
    if name == MY_ROOM:
        return gallery.measured_room()
    if name in PICTURES:
        return world_svg(load_world(Path(name).stem))
    blocks = PAGES[name]()
    page = (ROOT / name).read_text(encoding="utf-8")
    return BLOCK.sub(lambda found: "\n".join((found[1], *blocks[found[2]], "<!-- end -->\n")), page)


if __name__ == "__main__":
    for file in sys.argv[1:] or FILES:
        (ROOT / file).write_text(text(file), encoding="utf-8")
