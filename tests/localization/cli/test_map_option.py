"""The choice of the map: the option, the default of the command, or the simulation of the address."""

from __future__ import annotations

import argparse
from pathlib import Path

import pytest

from localization.cli.arguments import add_map_option, resolve_world
from nclient.cli.main import main
from nclient.errors import AddressError
from worlds.io import DEFAULT_WORLD


def arguments(option: str | None, address: str | None) -> argparse.Namespace:
    """Options as a command has them."""
    parser = argparse.ArgumentParser()
    add_map_option(parser)
    parser.add_argument("address", nargs="?")
    return parser.parse_args([*(("--map", option) if option else ()), *((address,) if address else ())])


@pytest.mark.parametrize(("option", "address", "default", "world"), [
    # The scheme is not case-sensitive, and a path names the same world.
    (None, "sim:thesis_room?noisy=1", "", "thesis_room"),
    (None, "SIM:worlds/several_walls.toml", "", "several_walls"),
    (None, "sim:?seed=3", "", DEFAULT_WORLD),
    ("several_walls", "sim:thesis_room", "empty_room", "several_walls"),
    # The default of a command is stronger than the simulation of the address.
    (None, "sim:thesis_room", "several_walls", "several_walls"),
    ("several_walls", "nserver://host/1", "", "several_walls"),
])  # fmt: skip
def test_map_precedence_is_option_command_address(
    option: str | None, address: str, default: str, world: str
) -> None:
    assert resolve_world(arguments(option, address), default).name == world


def test_the_default_address_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", "sim:several_walls?seed=1")
    assert resolve_world(arguments(None, None)).name == "several_walls"


@pytest.mark.parametrize("address", ["nserver://host/1", "serial:///dev/ttyUSB0?model=n150", None])
def test_missing_map_error_names_the_option(
    address: str | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    with pytest.raises(SystemExit, match="2"):
        resolve_world(arguments(None, address))
    assert "a map is required: --map WORLD" in capsys.readouterr().err


@pytest.mark.parametrize("address", ["thesis_room", "sin:thesis_room"])
def test_invalid_address_is_reported_before_missing_map(address: str) -> None:
    with pytest.raises(AddressError, match="is no address"):
        resolve_world(arguments(None, address))


@pytest.mark.parametrize("words", [
    ["localize", "nserver://127.0.0.1:1/1", "--waypoints", "5,0"],
    ["calibrate", "nserver://127.0.0.1:1/1", "--out", "mine.toml"],
    ["go", "nserver://127.0.0.1:1/1", "--to", "5,0"],
])  # fmt: skip
def test_every_command_requires_map_before_connecting(
    words: list[str], capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(words)
    assert "a map is required: --map WORLD" in capsys.readouterr().err


@pytest.mark.long
def test_a_simulation_is_localized_in_its_own_walls(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["localize", "sim:thesis_room?seed=1", "--waypoints", "5,0"]) == 0
    assert "reached" in capsys.readouterr().out
