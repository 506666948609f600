"""docs/shell.md says what is so: its conversation and its script are done again."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from nclient import cli

PAGE = (Path(__file__).parents[3] / "docs" / "shell.md").read_text()


def block(kind: str) -> str:
    found = re.search(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_conversation(capsys: pytest.CaptureFixture[str]) -> None:
    lines = block("").splitlines()[2:]
    typed = [line.removeprefix("n150> ") for line in lines if line.startswith("n150> ")]
    *good, wrong = typed
    assert cli.main(["shell", "sim:thesis_room", "--command", "; ".join(good)]) == 0
    shown = [line for line in lines if not line.startswith(("n150> ", "nomad: "))]
    assert capsys.readouterr().out.splitlines() == shown
    assert cli.main(["shell", "sim:thesis_room", "--command", wrong]) == 1
    told = capsys.readouterr().err.removeprefix("nomad: --command:1: ").strip()
    assert f"nomad: {told}" == lines[-1]


def test_the_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "square.nomad"
    script.write_text(block("nomad"))
    assert cli.main(["shell", "sim:thesis_room", "--script", str(script)]) == 0
    pose = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r"pose +x 0\.0 in  y -?0\.0 in  steering 270\.0 deg  turret 0\.0 deg", pose)
