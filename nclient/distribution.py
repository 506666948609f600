"""What this is called where it is installed, and of which version."""

from __future__ import annotations

import functools
from importlib import metadata
from typing import Final

DISTRIBUTION: Final = "nomad-nserver"


@functools.cache
def version() -> str:
    """As its metadata have it, which are read once: they hold the whole README."""
    return metadata.version(DISTRIBUTION)
