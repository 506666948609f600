"""Generate the layers of docs/architecture.md from the import contracts in pyproject.toml."""

from __future__ import annotations

from collections.abc import Iterator


def blocks() -> dict[str, Iterator[str]]:
    """Return the diagram of the page."""
    return {}
