"""Run every command of docs/missions.md and load its list and its program."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from localization.missions.steps import CONDITIONS, VERBS, parse_list, parse_program

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "missions.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)
COMMANDS = [line for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]


def run(command: str, folder: Path) -> str:
    words = [str(folder / word) if word.startswith("out/") else word for word in shlex.split(command)]
    programs = {"nomad": [str(Path(sys.executable).parent / "nomad")], "python": [sys.executable]}
    more = ["--out", str(folder)] if "localization.experiments" in words else []
    line = [*programs[words[0]], *words[1:], *more]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.parametrize("command", COMMANDS)
def test_command_runs(command: str, tmp_path: Path) -> None:
    output = run(command, tmp_path)
    if "--json" in command:
        assert json.loads(output)["ending"] == "done"
    elif "--check" not in command and "experiments" not in command:
        assert re.search(r"^ *[\d.]+ s  done at \(", output, re.MULTILINE)
    if "--report" in command:
        assert json.loads((tmp_path / "out" / "report.json").read_text())["ending"] == "done"


def test_list_and_program_are_missions() -> None:
    (steps,) = [text for kind, text in BLOCKS if kind == "toml"]
    (program,) = [text for kind, text in BLOCKS if kind == "python"]
    assert parse_list(steps, "page").settings.title == "Rounds"
    assert parse_program(program, "page").settings.title == "Mail"


def test_page_has_every_step_and_condition() -> None:
    for word in (*VERBS, *CONDITIONS):
        assert f"`{word}`" in PAGE
