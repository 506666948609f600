"""Repeat the session of docs/shell.md, run its script, and check its completion command."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nclient.cli import main
from tests.docs.pages import code_blocks, run

PAGE = "shell.md"


def test_session(capsys: pytest.CaptureFixture[str]) -> None:
    lines = code_blocks(PAGE, "")[0].splitlines()[2:]
    # The page shows the prompt, the typed lines, and what is printed below each of them.
    typed = [line.removeprefix("n150> ") for line in lines if line.startswith("n150> ")]
    *valid, misspelt = typed
    assert main.main(["shell", "sim:thesis_room", "--command", "; ".join(valid)]) == 0
    printed = [line for line in lines if not line.startswith(("n150> ", "nomad: "))]
    assert capsys.readouterr().out.splitlines() == printed
    assert main.main(["shell", "sim:thesis_room", "--command", misspelt]) == 1
    error = capsys.readouterr().err.removeprefix("nomad: --command:1: ").strip()
    assert f"nomad: {error}" == lines[-1]


def test_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "square.nomad"
    (text,) = code_blocks(PAGE, "nomad")
    script.write_text(text)
    assert main.main(["shell", "sim:thesis_room", "--script", str(script)]) == 0
    pose = capsys.readouterr().out.splitlines()[-1]
    # Four sides and three turns of 90 degrees: back at the start, and turned by 270.
    assert re.fullmatch(r"pose +x 0\.0 in  y -?0\.0 in  steering 270\.0 deg  turret 0\.0 deg", pose)


def test_completion_command_completes_both_commands(tmp_path: Path) -> None:
    (command,) = code_blocks(PAGE, "sh")
    output = run(f"{command}complete -p nomad nserver", tmp_path)
    assert [line.split()[-1] for line in output.splitlines()] == ["nomad", "nserver"]
