"""docs/gym.md: its programs run, its command has valid arguments, and its table of observations is complete."""

from __future__ import annotations

import re
import shlex

import gymnasium
import pytest

import nserver_emu.gym  # noqa: F401  registers
from localization.experiments import baselines
from tests.docs.pages import DOCS, code_blocks, command_lines

PAGE = "gym.md"


@pytest.mark.usefixtures("plain_batch")
def test_programs_run(capsys: pytest.CaptureFixture[str]) -> None:
    for program in code_blocks(PAGE, "python"):
        # Plain Python is a thousand times slower than the compiled batch.
        text = program.replace("num_envs=1000", "num_envs=2").replace("range(300)", "range(3)")
        exec(compile(text, PAGE, "exec"), {})
    assert "robot_1" in capsys.readouterr().out


def test_command_has_valid_arguments() -> None:
    (command,) = (line for line in command_lines(PAGE) if "experiments" in line)
    assert baselines._parser().parse_args(shlex.split(command)[4:]).episodes == 20


def test_observations_of_the_page_are_those_of_the_spaces() -> None:
    page = (DOCS / PAGE).read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)
    keys = {
        # All keys of the three environments; the page may have further rows.
        key for name in ("GoTo", "Explore", "Localize")
        for key in gymnasium.make(f"Nomad/{name}-v0").observation_space.spaces  # type: ignore[attr-defined]
    }
    assert keys <= set(rows)
