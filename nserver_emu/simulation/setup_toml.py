"""Setup files of our own: TOML in, a RobotSetup out. Only this file and model_files.py touch the disk.

    base = "measured"                   what it is made from: a named setup; left out: ideal
    name = "room 12"                    left out: the file's name
    ramps, clock_step_s                 and by table [motion], [odometry], [sonar], [infrared], [compass]
    [sonar]
    model = "polaroid"                  or "ray"; left out: the base's
    dead = [3, 11]

All keys are setup_keys.py's; what is left out is as in the base. Whatever is wrong is a WorldFileError: file, key, what
was expected.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from math import radians
from pathlib import Path
from typing import Any, Final

from nclient.errors import AddressError
from nclient.suggesting import did_you_mean
from nserver_emu.simulation.polaroid import Polaroid
from nserver_emu.simulation.setup import IDEAL, SETUPS, RobotSetup
from nserver_emu.simulation.setup_keys import KEYS, POLAROID, RAY, SONAR_NUMBERS, Key
from nserver_emu.simulation.sonar import EchoModel, SonarNoise
from worlds.bodies import SONARS
from worlds.tables import Table
from worlds.texts import read_text, toml_of

SUFFIX: Final = ".toml"
TABLES: Final = tuple(dict.fromkeys(key.table for key in KEYS if key.table))
EARS: Final[dict[str, type[SonarNoise] | type[Polaroid]]] = {RAY: SonarNoise, POLAROID: Polaroid}


def setup_named(name: str) -> RobotSetup:
    """The setup of that name, or of the file `name`, which ends in .toml. Raises AddressError or WorldFileError."""
    if name in SETUPS:
        return SETUPS[name]
    if not name.endswith(SUFFIX):
        raise AddressError(
            f"no setup {name!r}; there are {', '.join(SETUPS)}, and files that end in {SUFFIX}"
            f"{did_you_mean(name, SETUPS)}"
        )
    return load_setup(Path(name))


def load_setup(path: Path) -> RobotSetup:
    """The setup of a file. Raises WorldFileError."""
    return parse_setup(read_text(path), str(path), path.stem)


def parse_setup(text: str, file: str, name: str) -> RobotSetup:
    """The same from a text; `file` is what errors call it, `name` what the setup is called unless it says so."""
    values = toml_of(text, file)
    top = Table(file, "", values)
    top.allow(("base", "name", *(key.name for key in KEYS if not key.table), *TABLES))
    base_name = top.text("base", IDEAL.name)
    if base_name not in SETUPS:
        known = ", ".join(SETUPS)
        top.fail("base", f"expected one of {known}, found {base_name!r}{did_you_mean(base_name, SETUPS)}")
    base = SETUPS[base_name]
    parts: dict[str, Any] = {part: _part(top.table(part), base) for part in TABLES if part in values}
    return replace(base, name=top.text("name", name), **_read(top, base, KEYS), **parts)


def _part(table: Table, base: RobotSetup) -> Any:
    """One part of a setup as its table says."""
    keys = [key for key in KEYS if key.table == table.path]
    if table.path != "sonar":
        table.allow(key.name for key in keys)
        return replace(getattr(base, table.path), **_read(table, base, keys))
    model = _ears(table, base.sonar)
    ours = RAY if isinstance(model, SonarNoise) else POLAROID
    table.allow(("model", *(key.name for key in keys)))
    for key in keys:
        if key.name in table.values and key.ears not in ("", ours):
            table.fail(key.name, f'is a number of the model "{key.ears}"; expected it beside model = "{key.ears}"')
    return replace(model, **_read(table, replace(base, sonar=model), keys))


def _ears(table: Table, base: EchoModel) -> EchoModel:
    """The sonar model, before its numbers are set: another one than the base's keeps what both have."""
    ours = RAY if isinstance(base, SonarNoise) else POLAROID
    asked = table.text("model", ours)
    if asked not in EARS:
        table.fail("model", f"expected one of {', '.join(EARS)}, found {asked!r}{did_you_mean(asked, EARS)}")
    if asked == ours:
        return base
    both = {field.name for field in fields(SonarNoise)} & {field.name for field in fields(Polaroid)}
    return EARS[asked](**{name: getattr(base, name) for name in both})


def _read(table: Table, base: RobotSetup, keys: Iterable[Key]) -> dict[str, Any]:
    """The fields that a table sets, in physics' units."""
    ours = [key for key in keys if key.table == table.path and key.name in table.values]
    return {key.field: _value(table, key, key.of(base)) for key in ours}


def _value(table: Table, key: Key, now: object) -> Any:
    if isinstance(now, bool):
        return table.flag(key.name)
    if key.unit == SONAR_NUMBERS:
        return table.indices(key.name, SONARS)
    if isinstance(now, tuple):
        return table.numbers(key.name, len(now), key.low, key.high)
    number = table.number(key.name, key.low, key.high)
    return radians(number) if key.in_degrees else number
