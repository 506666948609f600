"""What is fuzzed stands beside the packages; its parts can be imported by name. Files of inputs are gone in the end."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(scope="session", autouse=True)
def _files() -> Iterator[None]:
    from fuzz.place import folder

    kept = folder()
    yield
    folder().cleanup()
    kept.cleanup()
