"""docs/own-filter.md: its command and its program run, and the class that it shows has at most thirty lines."""

from __future__ import annotations

import ast
import runpy
import shlex
from pathlib import Path

import pytest

from nserver_emu.cli import nserver_parser
from tests.docs.pages import ROOT, code_blocks, command_lines, run

PAGE = "own-filter.md"


def test_command_reaches_the_waypoints() -> None:
    command, _ = command_lines(PAGE)
    assert "2 of 2 waypoints reached" in run(command, ROOT)


def test_server_takes_the_class_for_its_page(monkeypatch: pytest.MonkeyPatch) -> None:
    _, command = command_lines(PAGE)
    monkeypatch.chdir(ROOT)
    options = nserver_parser().parse_args(shlex.split(command)[1:])
    assert options.method == [f"{ROOT}/examples/own_filter.py:MyFilter"]


def test_program_writes_its_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (program,) = code_blocks(PAGE, "python")
    (tmp_path / "program.py").write_text(program, encoding="utf-8")
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    runpy.run_path("program.py")
    assert {path.name for path in tmp_path.glob("*.png")} == {
        "trajectory.png", "errors.png", "innovations.png", "nees.png"}


def test_example_has_thirty_lines() -> None:
    module = ast.parse((ROOT / "examples" / "own_filter.py").read_text(encoding="utf-8"))
    (example,) = (node for node in module.body if isinstance(node, ast.ClassDef))
    assert example.end_lineno is not None
    # The first line is that of the class itself.
    assert example.end_lineno - example.lineno < 32
