"""TOML readers reject numbers that Python can read but not format, with their documented errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from localization.navigation.mission_steps import load_mission
from nclient.errors import NomadError
from nclient.faults.plan import load_plan
from nserver_emu.simulation.models import load_models
from nserver_emu.simulation.noise import load_setup
from worlds.io import load_world
from worlds.robots import load_calibration

READERS: list[Callable[[Path], object]] = [
    load_plan, load_mission, load_models, load_setup, load_world, lambda path: load_calibration(path, "worn"),
]  # fmt: skip


@pytest.mark.parametrize("load", READERS)
@pytest.mark.parametrize("key", ["name", "seed", "base"])
def test_huge_number_raises_documented_error(load: Callable[[Path], object], key: str, tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text(f"{key} = [0x{'f' * 3600}]")
    with pytest.raises(NomadError, match="4096"):
        load(path)
