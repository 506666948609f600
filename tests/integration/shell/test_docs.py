"""docs/shell.md says what is so: its conversation, its script and what it has for a shell are done again."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from nclient.cli import main

PAGE = (Path(__file__).parents[3] / "docs" / "shell.md").read_text()


def block(kind: str) -> str:
    found = re.search(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)
    assert found is not None
    return found[1]


def test_the_conversation(capsys: pytest.CaptureFixture[str]) -> None:
    lines = block("").splitlines()[2:]
    typed = [line.removeprefix("n150> ") for line in lines if line.startswith("n150> ")]
    *good, wrong = typed
    assert main.main(["shell", "sim:thesis_room", "--command", "; ".join(good)]) == 0
    shown = [line for line in lines if not line.startswith(("n150> ", "nomad: "))]
    assert capsys.readouterr().out.splitlines() == shown
    assert main.main(["shell", "sim:thesis_room", "--command", wrong]) == 1
    told = capsys.readouterr().err.removeprefix("nomad: --command:1: ").strip()
    assert f"nomad: {told}" == lines[-1]


def test_the_script(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = tmp_path / "square.nomad"
    script.write_text(block("nomad"))
    assert main.main(["shell", "sim:thesis_room", "--script", str(script)]) == 0
    pose = capsys.readouterr().out.splitlines()[-1]
    assert re.fullmatch(r"pose +x 0\.0 in  y -?0\.0 in  steering 270\.0 deg  turret 0\.0 deg", pose)


def test_what_is_typed_into_a_shell_completes_both_commands() -> None:
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    typed = block("sh") + "complete -p nomad nserver"
    done = subprocess.run(["bash", "-c", typed], env=os.environ | {"PATH": path}, capture_output=True, text=True,
                          timeout=60, check=False)  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert [line.split()[-1] for line in done.stdout.splitlines()] == ["nomad", "nserver"]
