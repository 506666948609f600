"""Every command of the pages on calibration and maps, as a reader would run it, in this process."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from nclient.cli import main
from worlds.calibration import load_calibration

pytestmark = pytest.mark.long

DOCS = Path(__file__).parents[2] / "docs"


def commands(page: str) -> list[list[str]]:
    """The words of each command of nomad, without that name; programs of benchmarks/ have tests of their own."""
    blocks = re.findall(r"```sh\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), re.DOTALL)
    return [shlex.split(line)[1:] for block in blocks for line in block.splitlines() if line.startswith("nomad ")]


@pytest.mark.parametrize("page", ["calibration.md", "maps.md"])
def test_every_command_of_the_page_works(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    given = commands(page)
    assert len(given) >= 2
    for words in given:
        assert main.main(words) == 0, words


def test_the_file_of_the_page_is_a_model_file(tmp_path: Path) -> None:
    (text,) = re.findall(r"```toml\n(.*?)```", (DOCS / "calibration.md").read_text(encoding="utf-8"), re.DOTALL)
    file = tmp_path / "mine.toml"
    file.write_text(text)
    assert load_calibration(file, "n150").spread.way_scale == 0.001
