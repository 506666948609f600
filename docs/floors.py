"""The floors of architecture.md, from the first import contract of pyproject.toml.

    python docs/floors.py      writes the block anew
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

DOCS = Path(__file__).parent
PAGE = DOCS / "architecture.md"
BLOCK = re.compile(r"```text\n.*?```", re.DOTALL)


def floors() -> str:
    """One line a floor, the highest first; strangers of one floor are separated by |."""
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))
    layers: list[str] = project["tool"]["importlinter"]["contracts"][0]["layers"]
    return "".join(f"{len(layers) - number:3}  {layer}\n" for number, layer in enumerate(layers))


def page() -> str:
    """The page with the floors of now."""
    return BLOCK.sub(lambda _: f"```text\n{floors()}```", PAGE.read_text(encoding="utf-8"), count=1)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
