"""docs/safety.md: every danger has a test that is there, and that pytest collects."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = re.compile(r"`(tests/[\w/]+\.py::\w+)`")
DANGERS = [row.split("|")[1:-1] for row in re.findall(r"^\| .*\|$", PAGE, re.MULTILINE)[1:]]


def test_every_danger_has_its_test() -> None:
    dangers = " ".join(danger for danger, _, _ in DANGERS)
    for what in ("killed", "laptop sleeps", "cable is pulled", "corrupted", "two clients", "model is wrong", "stuck"):
        assert what in dangers
    assert [danger for danger, _, shown in DANGERS if not NAMED.findall(shown)] == []
    assert [danger for danger, _, shown in DANGERS if NAMED.sub("", shown).strip()] == []


def test_pytest_collects_every_test_of_the_page() -> None:
    named = sorted(set(NAMED.findall(PAGE)))
    command = [sys.executable, "-m", "pytest", "--collect-only", "--quiet", "-p", "no:cacheprovider", *named]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {line.partition("[")[0] for line in done.stdout.splitlines() if "::" in line} == set(named)
