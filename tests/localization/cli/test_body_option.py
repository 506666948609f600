"""The choice of the robot model."""

from __future__ import annotations

from pathlib import Path

import pytest

from localization.live.assumptions import resolve_robot_model
from nclient.cli.main import main
from nclient.errors import AddressError


@pytest.mark.parametrize(("option", "model", "address", "body"), [
    (None, "n200", "sim:thesis_room?robot=n200", "n200"),
    ("n200", "n200", "sim:thesis_room?robot=n200", "n200"),
    # The address names no model: the one of the connection counts, and an option overrides it.
    (None, "n150", "nserver://host/1", "n150"),
    ("scout", "n150", "nserver://host/1", "scout"),
    ("scout", "scout", "serial:///dev/ttyUSB0?model=scout", "scout"),
])  # fmt: skip
def test_the_address_comes_first_then_the_option(option: str | None, model: str, address: str, body: str) -> None:
    assert resolve_robot_model(option, model, address) == body


@pytest.mark.parametrize("address", ["sim:thesis_room", "nserver://host/1?model=n150"])
def test_contradicting_models_are_refused(address: str) -> None:
    with pytest.raises(AddressError, match=r"scout.* n150.*omit --body"):
        resolve_robot_model("scout", "n150", address)


# NOMAD_ROBOT stands in for an address that is not given.
def test_the_default_address_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", "sim:?robot=scout")
    with pytest.raises(AddressError):
        resolve_robot_model("n150", "scout", None)


@pytest.mark.parametrize("words", [
    ["localize", "sim:thesis_room?robot=n200", "--map", "thesis_room", "--waypoints", "5,0"],
    ["go", "sim:thesis_room?robot=n200", "--to", "5,0"],
    ["calibrate", "sim:thesis_room?robot=n200", "--world", "thesis_room"],
])  # fmt: skip
def test_every_command_that_drives_refuses_another_body(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words, "--body", "n150"]) == 2
    output = capsys.readouterr()
    assert output.out == ""
    assert "is of model n200; omit --body" in output.err


def test_calibrate_writes_the_robots_own_name(tmp_path: Path) -> None:
    quick = ["--laps", "1", "--square", "4,4,3", "--spins", "0", "--speed", "24", "--turn-speed", "90"]
    words = ["--world", "thesis_room", *quick, "--out", f"{tmp_path}/found.toml"]
    assert main(["calibrate", "sim:thesis_room?robot=n200&start=4,4", *words]) == 0
    assert 'name = "n200"' in (tmp_path / "found.toml").read_text()
