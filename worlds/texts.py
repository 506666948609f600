"""The text of a world, a setup, models, a calibration: how long it may be, and what is raised where there is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from nclient.common import files
from nclient.errors import WorldFileError

MOST_BYTES: Final = 1 << 22
"""Some forty thousand obstacles, which Python's TOML takes seconds for; none that was made by hand comes near it."""


def read_text(path: Path) -> str:
    """What stands in a file, UTF-8. Raises WorldFileError."""
    return files.read_text(path, MOST_BYTES, WorldFileError)


def toml_of(text: str, file: str) -> dict[str, Any]:
    """What it holds; `file` is what errors call it. Raises WorldFileError."""
    return files.toml_of(text, file, WorldFileError)
