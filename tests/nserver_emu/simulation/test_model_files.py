"""Model files: what they change, what they leave, and how they are refused."""

from __future__ import annotations

from math import degrees, radians
from pathlib import Path

import pytest

from nclient.errors import WorldFileError
from nserver_emu.simulation.drive import DifferentialDrive
from nserver_emu.simulation.models import MODELS, N150, N200, SCOUT, load_models, parse_models

GOOD = """
[[model]]
name = "n150"
radius_cm = 25.4

[[model]]
name = "tortoise"
like = "n150"
bumpers = 8
sonar_ring_radius_in = 9.5
[model.translation]
top_speed_in = 5
acceleration_cm = 25.4
[model.turret]
top_speed_deg = 90
speed_deg = 30

[[model]]
name = "wide"
like = "scout"
track_in = 16
[model.right]
top_speed_in = 20
"""


def test_new_models_derive_from_predefined_ones() -> None:
    models = parse_models(GOOD, "mine.toml")
    assert list(models) == ["n150", "n200", "scout", "tortoise", "wide"]
    assert (models["n200"], models["scout"]) == (N200, SCOUT)
    assert MODELS["n150"] is N150


def test_a_model_may_lack_a_compass_or_have_one() -> None:
    text = '[[model]]\nname = "n150"\ncompass = false\n[[model]]\nname = "needle"\nlike = "scout"\ncompass = true\n'
    models = parse_models(text, "mine.toml")
    assert {name: model.has_compass for name, model in models.items()} == {
        "n150": False, "n200": True, "scout": False, "needle": True
    }  # fmt: skip
    with pytest.raises(WorldFileError, match=r"compass: .*true.*false, .*1"):
        parse_models('[[model]]\nname = "n150"\ncompass = 1\n', "mine.toml")


def test_an_override_keeps_all_that_it_does_not_name() -> None:
    model = parse_models(GOOD, "mine.toml")["n150"]
    assert model.body.radius_in == pytest.approx(10.0)
    assert model.body.sonar_ring_radius_in == N150.body.sonar_ring_radius_in
    assert (model.axes, model.family) == (N150.axes, "n150")


def test_a_new_model_is_of_the_family_of_the_one_above_it() -> None:
    model = parse_models(GOOD, "mine.toml")["tortoise"]
    assert (model.name, model.body.name, model.family) == ("tortoise", "tortoise", "n150")
    # Values of its own replace those of the model above it; the others stay.
    assert model.body.radius_in == pytest.approx(10.0)
    assert model.body.sonar_ring_radius_in == 9.5
    assert [degrees(angle) for angle in model.body.bumper_angles_rad] == pytest.approx([45.0 * i for i in range(8)])
    translation, steering, turret = model.axes
    assert (translation.top_speed, translation.speed, translation.acceleration) == pytest.approx((5.0, 5.0, 10.0))
    # Degrees in the file are radians in the model.
    assert steering == N150.axes[1]
    assert (turret.top_speed, turret.speed) == pytest.approx((radians(90.0), radians(30.0)))


def test_a_differential_drive_has_wheels_and_a_track() -> None:
    model = parse_models(GOOD, "mine.toml")["wide"]
    drive = model.drive(ramps=False)
    assert isinstance(drive, DifferentialDrive)
    assert drive.track_in == 16.0
    assert [axis.top_speed for axis in model.axes] == [20.0, 39.0, 0.0]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"m: expected at least one \[\[model\]\]"),
        ("x =", "m: is no TOML"),
        ("modle = 1", "m: modle: unknown key.*did you mean model"),
        ("[[model]]", r"model\[0\].name: is missing: a name in small letters"),
        ('[[model]]\nname = "N150"', "name in small letters"),
        ('[[model]]\nname = "snail"', r"model\[0\].name: expected a model to be made from"),
        ('[[model]]\nname = "a"\nlike = "skout"', r"model\[0\].like: .*did you mean scout"),
        ('[[model]]\nname = "n150"\nraduis_in = 3', r"raduis_in: unknown key.*did you mean radius_in"),
        ('[[model]]\nname = "n150"\nradius_in = 0', r"radius_in: expected more than 0"),
        ('[[model]]\nname = "n150"\nradius_in = 1\nradius_cm = 1', "expected exactly one of"),
        ('[[model]]\nname = "n150"\nbumpers = 0', "bumpers: expected a whole number from 1 to 24, found 0"),
        ('[[model]]\nname = "n150"\nbumpers = 25', "whole number from 1 to 24, found 25"),
        ('[[model]]\nname = "n150"\ntrack_in = 9', "track_in: unknown key"),
        ('[[model]]\nname = "n150"\nturret = 3', r"model\[0\].turret: expected a table, found 3"),
        ('[[model]]\nname = "n150"\n[model.turret]\ntop_speed_in = 3', r"model\[0\].turret.top_speed_in: unknown key"),
        ('[[model]]\nname = "scout"\n[model.left]\nspeed_in = -3', r"model\[0\].left.speed_in: expected more than 0"),
        ('[[model]]\nname = "n150"\n[[model]]\nname = "n150"', r"model\[1\].name: 'n150' is taken"),
    ],
)
def test_errors_name_the_key(text: str, words: str) -> None:
    with pytest.raises(WorldFileError, match=words):
        parse_models(text, "m")


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    with pytest.raises(WorldFileError, match="be read: No such"):
        load_models(path)
    with pytest.raises(WorldFileError, match="embedded null byte"):
        load_models(tmp_path / "mine\0.toml")
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(WorldFileError, match="UTF-8"):
        load_models(path)
    path.write_text(GOOD, encoding="utf-8")
    assert load_models(path)["wide"].track_in == 16.0
