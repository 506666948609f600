"""Check that every test that docs/safety.md names is one that pytest collects."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
TEST_ID = re.compile(r"`(tests/[\w/]+\.py::\w+)`")


def test_pytest_collects_every_test_of_the_page() -> None:
    named = sorted(set(TEST_ID.findall(PAGE)))
    assert named
    # Collecting is enough: it finds each name, and the tests run elsewhere.
    command = [sys.executable, "-m", "pytest", "--collect-only", "--quiet", "-p", "no:cacheprovider", *named]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {line.partition("[")[0] for line in done.stdout.splitlines() if "::" in line} == set(named)
