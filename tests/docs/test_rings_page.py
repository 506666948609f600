"""The model file of the page about rings: read, simulated and localized as the page says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from nclient.cli.main import main
from nserver_emu.simulation.models import load_models
from tests.docs.pages import code_blocks, command_lines
from worlds.robots import N150, load_bodies


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a working directory with the file of the page."""
    (example,) = code_blocks("rings.md", "toml")
    (tmp_path / "my_ring.toml").write_text(example, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_example_is_a_model(folder: Path) -> None:
    ring = load_bodies(folder / "my_ring.toml")["eight"].ring
    assert ring == load_models(folder / "my_ring.toml")["eight"].body.ring
    assert ring.firing == ((0, 7), (2, 5), (1, 6), (3,), (4,))
    # The page has centimetres, the model inches.
    assert [round(length * 2.54, 6) for length in (ring.min_range_in, ring.max_range_in, ring.no_echo_in)] == [
        15.0, 500.0, 511.0
    ]  # fmt: skip


def test_the_command_localizes_it(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (folder / "my_ring.toml").exists()
    localize, serve = command_lines("rings.md")
    program, *words = localize.replace('"', "").split()
    assert program == "nomad"
    assert main([*words, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert (result["trust"], result["reached"]) == ("OK", 1)
    assert result["rmse_position_in"] < 0.5
    assert serve.startswith("nserver ")


def test_the_program_reads_all_sonars(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert (folder / "my_ring.toml").exists()
    (program,) = code_blocks("rings.md", "python")
    exec(compile(program, "rings.md", "exec"), {})
    count, _, readings = capsys.readouterr().out.partition(" ")
    assert count == "8"
    assert len(json.loads(readings)) == 8


def test_the_table_states_the_numbers_of_a_nomad() -> None:
    page = Path(__file__).parents[2].joinpath("docs", "rings.md").read_text(encoding="utf-8")
    cells = {line.split("|")[1].strip().strip("`"): line.split("|")[3].strip() for line in page.splitlines()
             if line.startswith("| `")}  # fmt: skip
    ring = N150.ring
    for key in ("interval_s", "min_range_in", "max_range_in", "resolution_in", "no_echo_in"):
        assert float(cells[key]) == getattr(ring, key)
    assert cells["order"] == ", ".join(str(sonar) for (sonar,) in ring.firing[:4]) + ", ..."
