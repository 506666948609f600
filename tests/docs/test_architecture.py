"""What the pages name is there: files by their paths, and in the table of what is where the names in them as well."""

from __future__ import annotations

import re
import shlex
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

from nclient import cli
from nclient.protocol.commands import BY_NAME, COMMANDS
from nclient.protocol.mask import BUMPER_SLOT

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "clib/README.md", *DOCS.rglob("*.md")]
FOLDERS = (
    "benchmarks", "clib", "docs", "fuzz", "localization", "nclient", "nserver_emu", "packaging", "scripts", "tests",
    "worlds",
)  # fmt: skip
NAMED = re.compile(rf"`((?:{'|'.join(FOLDERS)})/[^`\s]*)`")
MADE = {"fuzz/found/"}
"""What is there once a program has run."""
QUESTIONS = [row for row in (DOCS / "architecture.md").read_text().splitlines() if re.match(r"\| .*\? \|", row)]


def cells(question: str) -> list[str]:
    return [cell.strip() for cell in question.strip("|").split(" | ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_paths_that_a_page_names_are_there(page: Path) -> None:
    named = {path.partition("::")[0] for path in NAMED.findall(page.read_text(encoding="utf-8"))} - MADE
    assert [path for path in named if not [*ROOT.glob(path.rstrip("/"))]] == []


def test_the_pages_name_paths() -> None:
    assert sum(len(NAMED.findall(page.read_text(encoding="utf-8"))) for page in PAGES) > 50
    assert len(QUESTIONS) == 9


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: cells(question)[0])
def test_a_newcomers_question_is_answered_by_names_that_are_there(question: str) -> None:
    _, where, _ = cells(question)
    module, found = None, 0
    for name in re.findall(r"`([^`]+)`", where):
        if name.endswith(".py"):
            assert (ROOT / name).is_file()
            module = import_module(name.removesuffix(".py").replace("/", "."))
            assert module.__doc__, f"{name} says nothing at its head"
        else:
            assert module is not None
            assert reduce(getattr, name.split("."), module) is not None
        found += 1
    assert found


@pytest.mark.parametrize("command", [
    command for question in QUESTIONS for command in re.findall(r"`(nomad [^`]*(?:-50 0|thesis_room)[^`]*)`", question)
])  # fmt: skip
def test_who_asks_is_answered(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out


def test_the_answers_are_right() -> None:
    assert BY_NAME["vm"] in COMMANDS
    assert BUMPER_SLOT == 33
