"""The floors of architecture.md, from the import contracts of pyproject.toml: the first, and those of one room's rooms.

    python docs/floors.py      writes the block anew
"""

from __future__ import annotations

import re
import textwrap
import tomllib
from pathlib import Path

DOCS = Path(__file__).parent
PAGE = DOCS / "architecture.md"
BLOCK = re.compile(r"```text\n.*?```", re.DOTALL)
_WIDTH = 100


def floors() -> str:
    """One line a floor, the highest first; strangers of one floor are separated by |. Below it the rooms of a room."""
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    house, *others = project["tool"]["importlinter"]["contracts"]
    within = {room: contract["layers"] for contract in others for room in contract.get("containers", ())}
    lines = []
    for number, layer in enumerate(house["layers"]):
        lines.append(f"{len(house['layers']) - number:3}  {layer}\n")
        for room in layer.split(" | "):
            rooms = textwrap.wrap(" > ".join(within.get(room, ())), _WIDTH)
            lines += [f"         {line}\n" for line in rooms]
    return "".join(lines)


def page() -> str:
    """The page with the floors of now."""
    return BLOCK.sub(lambda _: f"```text\n{floors()}```", PAGE.read_text(encoding="utf-8"), count=1)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
