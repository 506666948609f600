"""For what sonars are taken: against what the simulation makes of the same address."""

from __future__ import annotations

from pathlib import Path

import pytest

from localization.live.assumptions import Taken, sonar_model_of_address, taken
from nserver_emu.server.inprocess import open_address
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.noise import SETUPS

FILES = {
    "bare": "",
    "of_measured": 'base = "measured"\n',
    "rays_of_measured": 'base = "measured"\n[sonar]\nmodel = "ray"\n',
    "ring_of_noisy": 'base = "noisy"\n[sonar]\nmodel = "polaroid"\n',
    "dead": 'base = "measured"\n[sonar]\ndead = [3]\n',
}


def simulated_rays(address: str) -> bool:
    """Whether the simulation of an address has rays."""
    (robot,) = open_address(address).emulator.simulation.robots.values()
    return not isinstance(robot.setup.sonar, Polaroid)


@pytest.mark.parametrize("query", ["", "?noisy=1&seed=1", *(f"?seed=2&setup={name}" for name in SETUPS)])
def test_a_simulation_in_this_process_says_what_it_is(query: str) -> None:
    address = f"sim:thesis_room{query}"
    rays = simulated_rays(address)
    assert sonar_model_of_address(address) is rays
    assert taken(None, True, address) == Taken(rays, guessed=False)
    assert taken(None, True, address).line() == ""


@pytest.mark.parametrize("name", FILES)
def test_so_does_one_of_a_setup_of_ones_own(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.toml"
    file.write_text(FILES[name])
    address = f"sim:?setup={file}"
    assert sonar_model_of_address(address) is simulated_rays(address)


@pytest.mark.parametrize("text", ["base = ", "sonar = 3"])
def test_a_file_that_is_none_says_nothing_wrong(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    assert sonar_model_of_address(f"sim:?setup={file}") is (None if text.endswith("= ") else True)
    assert sonar_model_of_address(f"sim:?setup={tmp_path}/none.toml") is None
    file.write_text("x = " + 5000 * "[")
    assert sonar_model_of_address(f"sim:?setup={file}") is None


def test_a_server_does_not_tell_and_a_robot_has_cones(monkeypatch: pytest.MonkeyPatch) -> None:
    assert taken(None, True, "nserver://localhost/1") == Taken(rays=True, guessed=True)
    assert "taken for exact rays" in taken(None, True, "nserver://localhost/1").line()
    assert taken(None, False, "serial:///dev/ttyUSB0") == Taken(rays=False, guessed=True)
    assert taken(None, False, "serial:///dev/ttyUSB0").line() == ""
    monkeypatch.setenv("NOMAD_ROBOT", "sim:thesis_room?setup=measured")
    assert taken(None, True, None) == Taken(rays=False, guessed=False)


def test_the_option_decides() -> None:
    assert taken("rays", False, "sim:?setup=measured") == Taken(rays=True, guessed=False)
    assert taken("cones", True, "sim:") == Taken(rays=False, guessed=False)
