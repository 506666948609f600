"""Check that the generated tables of the reference pages and of the C library are up to date."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.generate.__main__ import FILES, text

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", FILES)
def test_generated_tables_are_up_to_date(name: str) -> None:
    assert text(name) == (ROOT / name).read_text(encoding="utf-8"), "run scripts/reference-pages"
