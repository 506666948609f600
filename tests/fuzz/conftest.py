"""What is fuzzed stands beside the packages; its parts can be imported by name. Files of inputs are gone in the end."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))


@pytest.fixture(scope="session", autouse=True)
def _files() -> Iterator[None]:
    from fuzz.place import folder

    kept = folder()
    yield
    folder().cleanup()
    kept.cleanup()
