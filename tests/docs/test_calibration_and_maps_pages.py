"""Run every `nomad` command of the pages on calibration, maps and mapping in this process, and read the model file."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from nclient.cli import main
from tests.docs.pages import code_blocks, command_lines
from worlds.robots import load_calibration

pytestmark = pytest.mark.long


@pytest.mark.parametrize("page", ["calibration.md", "maps.md", "mapping.md"])
def test_every_command_succeeds(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    # The commands of a page write their results below out/, and later ones read them.
    Path("out").mkdir()
    commands = [shlex.split(line)[1:] for line in command_lines(page) if line.startswith("nomad ")]
    assert len(commands) >= 2
    for words in commands:
        assert main.main(words) == 0, words


def test_model_file_of_the_page_is_valid(tmp_path: Path) -> None:
    (text,) = code_blocks("calibration.md", "toml")
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert load_calibration(file, "n150").spread.distance_scale == 0.001
