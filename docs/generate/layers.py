"""Generate the layers of docs/architecture.md from the import contract in pyproject.toml."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from pathlib import Path

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
NAMES = (
    "command lines", "applications", "services", "robots", "client and filters", "exchange", "foundation",
)  # fmt: skip
"""Names of the layers, the highest first."""


def layers() -> list[list[str]]:
    """Return the modules of each layer, the highest layer first."""
    contracts = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["tool"]["importlinter"]["contracts"]
    (contract,) = (contract for contract in contracts if contract["type"] == "layers")
    return [[module.strip() for module in layer.split(":")] for layer in contract["layers"]]


def blocks() -> dict[str, Iterator[str]]:
    """Return the table of the page."""
    return {"layers": _rows()}


def _rows() -> Iterator[str]:
    yield from ("| | layer | packages and modules |", "|---|---|---|")
    found = layers()
    for index, (name, modules) in enumerate(zip(NAMES, found, strict=True)):
        yield f"| {len(found) - index} | {name} | {', '.join(f'`{module}`' for module in modules)} |"
