"""No page has a command that nobody tries: each is run by a test or, where that takes hours, at least understood."""

from __future__ import annotations

import importlib
import re
import runpy
import shlex
from pathlib import Path

import pytest

from localization.experiments import __main__ as figures
from nserver_emu.options import nserver_parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TESTS = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py") if path != Path(__file__)]
HOURS = ("methods.md", "results.md")
EXPERIMENTS = "python -m localization.experiments "


def blocks(page: str) -> list[str]:
    found = re.findall(r"^ *```(?:sh|python|c|nomad|toml|ini)\n(.*?)^ *```", (DOCS / page).read_text(encoding="utf-8"),
                       re.MULTILINE | re.DOTALL)  # fmt: skip
    return [str(block) for block in found]


@pytest.mark.parametrize("page", sorted(path.name for path in DOCS.glob("*.md")))
def test_a_page_with_something_to_type_has_a_test(page: str) -> None:
    if blocks(page) and page not in HOURS:
        assert any(page in text for text in TESTS), f"no test reads {page}"


@pytest.mark.parametrize("command", [line for page in HOURS for block in blocks(page) for line in block.splitlines()])
def test_what_takes_hours_is_understood(command: str) -> None:
    if command.startswith("python benchmarks/"):
        _, script, *words = shlex.split(command)
        assert runpy.run_path(str(ROOT / script))["options_parser"]().parse_args(words)
        return
    assert command.startswith(EXPERIMENTS)
    kind, *words = shlex.split(command.removeprefix(EXPERIMENTS))
    if kind in ("live", "lost", "plan"):
        room = importlib.import_module(f"localization.experiments.{kind}.command")
        assert room._parser().parse_args(words)
    else:
        assert figures._parser().parse_args([kind, *words]).figures[0] == kind


def test_the_options_of_the_service_are_the_daemons() -> None:
    page = (DOCS / "service.md").read_text(encoding="utf-8")
    found = re.findall(r'NSERVER_OPTIONS="?([^"`\n]+)', page)
    assert len(found) == 2
    for words in found:
        assert nserver_parser().parse_args(shlex.split(words)).robots == 2
