"""Run every command of docs/missions.md and load its list and its program."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import get_args

import pytest
from msgspec.inspect import StructType, multi_type_info

from localization.navigation.mission_steps import CONDITIONS, Step, parse_program, parse_step_list
from tests.docs.pages import DOCS, ROOT, code_blocks, command_lines, run

PAGE = "missions.md"


@pytest.mark.parametrize("command", command_lines(PAGE))
def test_command_runs(command: str, tmp_path: Path) -> None:
    line = command.replace("out/", f"{tmp_path}/out/")
    # The pages write below the clone: the test writes to its own folder.
    output = run(f"{line} --out {tmp_path}" if "localization.experiments" in line else line, ROOT)
    if "--json" in command:
        assert json.loads(output)["ending"] == "done"
    elif "--check" not in command and "experiments" not in command:
        assert re.search(r"^ *[\d.]+ s  done at \(", output, re.MULTILINE)
    if "--report" in command:
        assert json.loads((tmp_path / "out" / "report.json").read_text())["ending"] == "done"


def test_list_and_program_are_missions() -> None:
    (steps,), (program,) = code_blocks(PAGE, "toml"), code_blocks(PAGE, "python")
    assert parse_step_list(steps, "page").settings.title == "Rounds"
    assert parse_program(program, "page").settings.title == "Mail"


def test_page_has_every_step_and_condition() -> None:
    text = (DOCS / PAGE).read_text(encoding="utf-8")
    steps = [str(kind.tag) for kind in multi_type_info(get_args(Step)) if isinstance(kind, StructType)]
    assert len(steps) == 8
    assert [word for word in (*steps, *CONDITIONS) if f"`{word}`" not in text] == []
