"""No page has a command that nobody tries: each is run by a test or, where that takes hours, at least understood."""

from __future__ import annotations

import ast
import importlib
import re
import runpy
import shlex
from pathlib import Path

import pytest

from localization.experiments import __main__ as figures
from nclient import cli
from nserver_emu.options import nserver_parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TESTS = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py") if path != Path(__file__)]
HOURS = ("methods.md", "results.md")
BENCHMARK = "python benchmarks/"
EXPERIMENTS = "python -m localization.experiments "
TYPED = ("sh", "python", "c", "nomad", "toml", "ini")
"""Kinds of blocks for the reader to type or to save."""
OURS = re.compile(r"^(?:\$ )?(?:\w+=\S+ )*(?:nomad|nserver|scripts/|python|pytest|make)\b", re.MULTILINE)
"""A command of ours, whatever its block is called."""


def blocks(text: str) -> list[str]:
    """Those of a page with something to type: of such a kind, or of any other that has a command of ours."""
    found = re.findall(r"^ *```([^\n]*)\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    return [str(block) for kind, block in found if kind in TYPED or OURS.search(block)]


def takes_blocks_of(test: str, path: Path) -> bool:
    """Whether a test has the page's file in its code, not in prose alone, and looks for fences in what it reads."""
    named = {path.name, path.relative_to(DOCS).as_posix(), path.relative_to(ROOT).as_posix()}
    said = {node.value for node in ast.walk(ast.parse(test)) if isinstance(node, ast.Constant)}
    return "```" in test and not named.isdisjoint(said)


def lines(path: Path) -> list[str]:
    return [line for block in blocks(path.read_text(encoding="utf-8")) for line in block.splitlines()]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: str(path.relative_to(DOCS)))
def test_a_page_with_something_to_type_has_a_test(path: Path) -> None:
    if blocks(path.read_text(encoding="utf-8")) and path.name not in HOURS:
        assert any(takes_blocks_of(test, path) for test in TESTS), f"no test takes the blocks of {path.name}"


def test_what_a_block_is_called_hides_no_command_of_ours() -> None:
    for typed in ("$ scripts/fuzz --list", "nomad state sim:", "NOMAD_ROBOT=sim: ./a\nnserver --version"):
        for kind in ("console", "", "text"):
            assert blocks(f"```{kind}\n{typed}\n```\n") == [f"{typed}\n"]
    assert blocks("```console\n$ ssh lab\n```\n") == blocks("```text\nnomads\n```\n") == []


@pytest.mark.parametrize("command", [
    line for path in PAGES for line in lines(path) if path.name in HOURS or line.startswith(BENCHMARK)
])  # fmt: skip
def test_what_takes_hours_is_understood(command: str) -> None:
    if command.startswith(BENCHMARK):
        _, script, *words = shlex.split(command)
        cut = words.index("--") if "--" in words else len(words)
        assert runpy.run_path(str(ROOT / script))["options_parser"]().parse_args(words[:cut])
        if words[cut:]:
            assert script == "benchmarks/calibration.py"
            assert cli.whole_parser().parse_args(["calibrate", "sim:", *words[cut + 1 :]])
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
