"""docs/safety.md: every danger has a test of an emulated robot; each is collected, and of the kind that the page says.

    on a line          what the test runs has a daemon with `--serial-link`
    in this process    it opens `sim:`, or has an emulator
    in bytes           neither

Rules: what a test runs is its own code and what it names of its file, fixtures among it, and so on from there.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "safety.md").read_text(encoding="utf-8")
NAMED = re.compile(r"`(tests/[\w/]+\.py::\w+)`")
DANGERS = [row.split("|")[1:-1] for row in re.findall(r"^\| .*\|$", PAGE, re.MULTILINE)[1:]]


KINDS = {
    "on a line": re.compile(r'"--serial-link", str\('),
    "in this process": re.compile(r"\bsim:|\b(Emulator|emulated)\("),
}
IN_BYTES = "in bytes"


def shown_by(cell: str) -> list[tuple[str, str]]:
    """Kind and test, of a danger's last cell."""
    found = []
    for part in cell.strip().split("; "):
        kind, _, tests = part.partition(": ")
        assert NAMED.sub("", tests).strip() == "", tests
        found += [(kind, test) for test in NAMED.findall(tests)]
    return found


def what_it_runs(test: str) -> str:
    """The code of a test and of what it uses of its own file."""
    path, _, name = test.partition("::")
    text = (ROOT / path).read_text(encoding="utf-8")
    there: dict[str, ast.stmt] = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            there[node.name] = node
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            there[node.targets[0].id] = node
    used, new = set[str](), {name}
    while new:
        used |= new
        nodes = [inner for each in new for inner in ast.walk(there[each])]
        said = {node.id for node in nodes if isinstance(node, ast.Name)}
        said |= {node.arg for node in nodes if isinstance(node, ast.arg)}
        new = (said & set(there)) - used
    return "\n".join(ast.get_source_segment(text, there[each]) or "" for each in sorted(used))


def kind_of(test: str) -> str:
    code = what_it_runs(test)
    return next((kind for kind, sign in KINDS.items() if sign.search(code)), IN_BYTES)


def test_every_danger_has_a_test_of_an_emulated_robot() -> None:
    dangers = " ".join(danger for danger, _, _ in DANGERS)
    for what in ("killed", "laptop sleeps", "cable is pulled", "corrupted", "two clients", "model is wrong", "stuck"):
        assert what in dangers
    for danger, _, cell in DANGERS:
        assert {kind for kind, _ in shown_by(cell)} & set(KINDS), danger


@pytest.mark.parametrize(("kind", "test"), sorted({pair for _, _, cell in DANGERS for pair in shown_by(cell)}))
def test_a_test_is_of_the_kind_that_the_page_says(kind: str, test: str) -> None:
    assert kind_of(test) == kind
    assert f"- **{kind}**: " in PAGE


def test_pytest_collects_every_test_of_the_page() -> None:
    named = sorted(set(NAMED.findall(PAGE)))
    command = [sys.executable, "-m", "pytest", "--collect-only", "--quiet", "-p", "no:cacheprovider", *named]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {line.partition("[")[0] for line in done.stdout.splitlines() if "::" in line} == set(named)
