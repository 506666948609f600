"""Check that the files and names that the pages refer to exist."""

from __future__ import annotations

import re
import shlex
from functools import reduce
from importlib import import_module
from pathlib import Path

import pytest

from nclient.cli import main
from nclient.protocol.commands import BY_NAME, COMMANDS
from nclient.protocol.types import BUMPER_SLOT

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "clib/README.md", *DOCS.rglob("*.md")]
FOLDERS = (
    "benchmarks", "clib", "docs", "fuzz", "localization", "nclient", "nserver_emu", "packaging", "scripts", "tests",
    "worlds",
)  # fmt: skip
PATH = re.compile(rf"`((?:{'|'.join(FOLDERS)})/[^`\s]*)`")
GENERATED = {"fuzz/found/"}
"""Exists after a program has run."""
# Rows of the table of questions: the first cell ends with a question mark.
QUESTIONS = [row for row in (DOCS / "architecture.md").read_text().splitlines() if re.match(r"\| .*\? \|", row)]


def cells(question: str) -> list[str]:
    return [cell.strip() for cell in question.strip("|").split(" | ")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_paths_of_a_page_exist(page: Path) -> None:
    # A test named by its id is looked for by its file.
    paths = {path.partition("::")[0] for path in PATH.findall(page.read_text(encoding="utf-8"))} - GENERATED
    assert [path for path in paths if not [*ROOT.glob(path.rstrip("/"))]] == []


def test_pages_name_paths() -> None:
    # A pattern that matches nothing would make the tests above pass.
    assert sum(len(PATH.findall(page.read_text(encoding="utf-8"))) for page in PAGES) > 50
    assert len(QUESTIONS) >= 9


@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: cells(question)[0])
def test_names_of_a_question_exist(question: str) -> None:
    _, where, _ = cells(question)
    module, found = None, 0
    for name in re.findall(r"`([^`]+)`", where):
        # A name behind a file is an attribute of that module, possibly of a class in it.
        if name.endswith(".py"):
            assert (ROOT / name).is_file()
            module = import_module(name.removesuffix(".py").replace("/", "."))
            assert module.__doc__, f"{name} has no module docstring"
        else:
            assert module is not None
            assert reduce(getattr, name.split("."), module) is not None
        found += 1
    assert found


@pytest.mark.parametrize("command", [
    command for question in QUESTIONS for command in re.findall(r"`(nomad [^`]*(?:-50 0|thesis_room)[^`]*)`", question)
])  # fmt: skip
def test_commands_of_the_questions_run(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(shlex.split(command)[1:]) == 0
    assert capsys.readouterr().out


def test_bumper_slot_of_the_questions() -> None:
    assert BY_NAME["vm"] in COMMANDS
    assert BUMPER_SLOT == 33
