"""Setup files: what they change, what they leave, how they are refused; every key, and the page of keys."""

from __future__ import annotations

import tomllib
from dataclasses import fields, replace
from math import degrees, radians
from pathlib import Path
from typing import Any

import pytest

from nclient.errors import AddressError, WorldFileError
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.noise import (
    BUILDING,
    IDEAL,
    KEYS,
    MEASURED,
    NOISY,
    POLAROID,
    SETUPS,
    TABLES,
    WORN,
    RobotSetup,
    load_setup,
    parse_setup,
    setup_named,
)
from nserver_emu.simulation.settings import Key
from nserver_emu.simulation.sonar import SonarNoise

PAGE = Path(__file__).parents[3] / "docs" / "setups.md"

GOOD = """
base = "measured"
ramps = false

[motion]
alpha1 = 0.25
[odometry]
scales = [1.01, 1, 0.99]
[sonar]
dead = [11, 3]
cone_deg = 30
[infrared]
slanted = false
[compass]
deviation_deg = 3.5
"""


def parsed(text: str) -> RobotSetup:
    return parse_setup(text, "m", "mine")


def test_a_file_changes_what_it_names_and_leaves_the_rest() -> None:
    # Each table of the file changes one or two values of its base; angles are in degrees there.
    expected = replace(
        MEASURED,
        name="mine",
        ramps=False,
        motion=replace(MEASURED.motion, alpha1=0.25),
        sonar=replace(Polaroid(), dead=(3, 11), cone_rad=radians(30.0)),
        odometry=replace(MEASURED.odometry, scales=(1.01, 1.0, 0.99)),
        infrared=replace(MEASURED.infrared, slanted=False),
        compass=replace(MEASURED.compass, deviation_rad=radians(3.5)),
    )
    assert parsed(GOOD) == expected


def test_an_empty_file_is_its_base_by_another_name() -> None:
    assert parsed("") == replace(IDEAL, name="mine")
    for name, setup in SETUPS.items():
        assert parsed(f'base = "{name}"\nname = "room 12"') == replace(setup, name="room 12")


def test_another_sonar_model_keeps_what_both_have() -> None:
    sonar_model = parsed('base = "noisy"\n[sonar]\nmodel = "polaroid"\nstd_share = 0.03\ncone_deg = 20').sonar
    assert sonar_model == Polaroid(range_std_relative=0.03, range_std_floor_in=0.05, cone_rad=radians(20.0))
    ray = parsed('base = "measured"\n[sonar]\nmodel = "ray"\ndead = [2]').sonar
    assert ray == SonarNoise(0.01, 0.05, (2,))


# Every key


def parts(setup: RobotSetup) -> set[tuple[str, str]]:
    """Tables and fields of a setup, from its dataclasses."""
    found = set()
    for field in fields(setup):
        value = getattr(setup, field.name)
        if field.name in TABLES:
            found |= {(field.name, inner.name) for inner in fields(value)}
        elif field.name != "name":
            found.add(("", field.name))
    return found


def test_every_field_has_a_key_and_every_key_a_field() -> None:
    assert {(key.table, key.field) for key in KEYS} == parts(IDEAL) | parts(MEASURED)
    assert len(set(KEYS)) == len({(key.table, key.field) for key in KEYS})
    only_polaroid = {name for table, name in parts(MEASURED) - parts(IDEAL) if table == "sonar"}
    assert {key.field for key in KEYS if key.sonar_model == POLAROID} == only_polaroid
    assert {key.sonar_model for key in KEYS} == {"", POLAROID}


def written(key: Key, value: Any) -> str:
    """A file that sets one key of the measured setup."""
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return "\n".join(['base = "measured"', *([f"[{key.table}]"] if key.table else []), f"{key.name} = {text}"])


def ends(key: Key) -> tuple[Any, Any]:
    """The lowest and the highest that a key takes, and as long a list as it is one."""
    now = key.of(MEASURED)
    if isinstance(now, bool):
        return False, True
    if isinstance(now, tuple):
        return [key.low] * (len(now) or 1), [key.high] * (len(now) or 1)
    return key.low, key.high


@pytest.mark.parametrize("key", KEYS, ids=lambda key: f"{key.table}.{key.name}")
def test_each_key_takes_its_whole_range_and_nothing_beyond(key: Key) -> None:
    # The ends of the range are valid.
    low, high = ends(key)
    for value in (low, high):
        got = key.of(parsed(written(key, value)))
        assert got == (tuple(value) if isinstance(value, list) else pytest.approx(
            radians(value) if key.in_degrees else value))  # fmt: skip
    # A hundredth beyond is not, nor is text.
    for beyond in (key.low - 0.01, key.high + 0.01, "'high'"):
        wrong = [beyond] * len(low) if isinstance(low, list) else beyond
        with pytest.raises(WorldFileError, match=f"m: .*{key.name}"):
            parsed(written(key, wrong))


def test_values_of_named_setups_lie_in_the_ranges() -> None:
    for setup in SETUPS.values():
        for key in KEYS:
            value = key.of(setup)
            for number in value if isinstance(value, tuple) else (value,) if value is not None else ():
                assert key.low <= (degrees(number) if key.in_degrees else number) <= key.high


# The page



def test_the_page_has_a_row_for_each_key() -> None:
    # One section per table, one row per key, with the default in its cell.
    tables = PAGE.read_text(encoding="utf-8").split("\n## ")[1:]
    rows = {
        (title.split("`")[1].strip("[]") if "`[" in title.splitlines()[0] else "", line.split("`")[1]): line
        for title in tables for line in title.splitlines() if line.startswith("| `")
    }  # fmt: skip
    assert set(rows) == {(key.table, key.name) for key in KEYS} | {("sonar", "model")}
    # 25 degrees is the cone of the data sheet, and four setups have scales of 1.
    assert "| 25 |" in rows["sonar", "cone_deg"]
    assert rows["odometry", "scales"].count("[1, 1, 1]") == 4
    for name in SETUPS:
        assert f"**{name}**" in PAGE.read_text(encoding="utf-8")


def test_the_example_of_the_page_is_a_setup() -> None:
    example = PAGE.read_text(encoding="utf-8").split("```toml\n")[1].split("```")[0]
    setup = parsed(example)
    assert (setup.sonar.dead, setup.odometry.slip_in) == ((3, 11), 0.1)
    assert tomllib.loads(example)["base"] == "measured"


# Errors and files


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x =", "m: is no TOML"),
        ('base = "measurd"', "base: expected one of building, ideal, measured, noisy, worn, found .*did you mean meas"),
        ("name = 3", "name: expected a text, found 3"),
        ("rampes = true", "rampes: unknown key.*did you mean ramps"),
        ("ramps = 1", "ramps: expected true or false, found 1"),
        ("clock_step_s = -1", "clock_step_s: expected 0 to 1, found -1"),
        ("clock_step_s = true", "clock_step_s: expected 0 to 1, a number, found true"),
        ("clock_step_s = nan", "clock_step_s: expected 0 to 1, a finite number, found nan"),
        ("sonar = 3", "sonar: expected a table, found 3"),
        ("[motion]\nalfa1 = 1", r"motion.alfa1: unknown key.*did you mean alpha1"),
        ("[odometry]\nscales = [1, 1]", "odometry.scales: expected a list of 3 numbers, found the list"),
        ("[odometry]\nscales = [1, 3, 1]", r"odometry.scales\[1\]: expected 0.5 to 2, found 3"),
        ("[odometry]\nscales = 1.0", "odometry.scales: expected a list of 3 numbers, found 1.0"),
        ("[sonar]\ndead = 3", "sonar.dead: expected a list of whole numbers from 0 to 63, found 3"),
        ("[sonar]\ndead = [64]", r"sonar.dead\[0\]: expected a whole number from 0 to 63, found 64"),
        ("[sonar]\ndead = [1, true]", r"sonar.dead\[1\]: expected a whole number"),
        ("[sonar]\ndead = [1, 1]", "sonar.dead: expected each number once"),
        ("[sonar]\ncone_deg = 20", 'cone_deg: belongs to the model "polaroid"; expected it beside model = "pol'),
        ('[sonar]\nmodel = "polaroyd"', "sonar.model: expected one of polaroid, ray, .*did you mean polaroid"),
        ("[sonar]\nstd = 1", "sonar.std: unknown key"),
    ],
)
def test_errors_name_the_key(text: str, words: str) -> None:
    with pytest.raises(WorldFileError, match=words):
        parsed(text)


def test_names_and_files(tmp_path: Path) -> None:
    assert [setup_named(name) for name in ("ideal", "noisy", "measured", "building", "worn")] == [
        IDEAL, NOISY, MEASURED, BUILDING, WORN
    ]
    with pytest.raises(AddressError, match=r"'worm'.* ideal, .*\.toml.* worn"):
        setup_named("worm")
    path = tmp_path / "mine.toml"
    with pytest.raises(WorldFileError, match="be read: No such"):
        setup_named(str(path))
    with pytest.raises(WorldFileError, match="embedded null byte"):
        setup_named(str(tmp_path / "mine\0.toml"))
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(WorldFileError, match="UTF-8"):
        load_setup(path)
    path.write_text(GOOD, encoding="utf-8")
    assert setup_named(str(path)) == parsed(GOOD)
