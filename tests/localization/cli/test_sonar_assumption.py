"""The assumed sonar model: against the simulation of the same address."""

from __future__ import annotations

from pathlib import Path

import pytest

from localization.live.assumptions import SonarAssumption, resolve_sonar_model, sonar_model_of_address
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
    """Return True if the simulation of an address has ray sonars."""
    (robot,) = open_address(address).emulator.simulation.robots.values()
    # The oracle is the simulated robot itself.
    return not isinstance(robot.setup.sonar, Polaroid)


@pytest.mark.parametrize("query", ["", "?noisy=1&seed=1", *(f"?seed=2&setup={name}" for name in SETUPS)])
def test_sonar_model_of_simulation_address(query: str) -> None:
    address = f"sim:thesis_room{query}"
    rays = simulated_rays(address)
    assert sonar_model_of_address(address) is rays
    building = query.endswith("building")
    assert resolve_sonar_model(None, True, address) == SonarAssumption(rays, guessed=False, building=building)
    assert resolve_sonar_model(None, True, address).line() == ""


@pytest.mark.parametrize("name", FILES)
def test_sonar_model_of_custom_setup_file(name: str, tmp_path: Path) -> None:
    file = tmp_path / f"{name}.toml"
    # Each file is read by the simulation and by the function under test.
    file.write_text(FILES[name])
    address = f"sim:?setup={file}"
    assert sonar_model_of_address(address) is simulated_rays(address)


@pytest.mark.parametrize("text", ["base = ", "sonar = 3"])
def test_invalid_setup_file_gives_no_model_or_default(text: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    assert sonar_model_of_address(f"sim:?setup={file}") is (None if text.endswith("= ") else True)
    assert sonar_model_of_address(f"sim:?setup={tmp_path}/none.toml") is None
    # Deeper than the parser's recursion limit.
    file.write_text("x = " + 5000 * "[")
    assert sonar_model_of_address(f"sim:?setup={file}") is None


def test_a_server_does_not_report_and_a_robot_has_cones(monkeypatch: pytest.MonkeyPatch) -> None:
    assert resolve_sonar_model(None, True, "nserver://localhost/1") == SonarAssumption(rays=True, guessed=True)
    assert "exact rays" in resolve_sonar_model(None, True, "nserver://localhost/1").line()
    assert resolve_sonar_model(None, False, "serial:///dev/ttyUSB0") == SonarAssumption(rays=False, guessed=True)
    assert resolve_sonar_model(None, False, "serial:///dev/ttyUSB0").line() == ""
    monkeypatch.setenv("NOMAD_ROBOT", "sim:thesis_room?setup=measured")
    assert resolve_sonar_model(None, True, None) == SonarAssumption(rays=False, guessed=False)


def test_the_setup_building_has_the_walls_of_a_building(tmp_path: Path) -> None:
    building = SonarAssumption(rays=False, guessed=False, building=True)
    assert resolve_sonar_model(None, True, "sim:thesis_room?setup=building") == building
    assert resolve_sonar_model("building", False, "serial:///dev/ttyUSB0") == building
    file = tmp_path / "mine.toml"
    file.write_text('base = "building"\n', encoding="utf-8")
    assert resolve_sonar_model(None, True, f"sim:?setup={file}") == building
    file.write_text('base = "building"\nsonar.model = "ray"\n', encoding="utf-8")
    assert resolve_sonar_model(None, True, f"sim:?setup={file}") == SonarAssumption(rays=True, guessed=False)


def test_the_option_decides() -> None:
    assert resolve_sonar_model("rays", False, "sim:?setup=measured") == SonarAssumption(rays=True, guessed=False)
    assert resolve_sonar_model("cones", True, "sim:") == SonarAssumption(rays=False, guessed=False)
