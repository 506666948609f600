"""Random streams, and setups, which say how realistic a simulation is.

    ideal     axes jump to their speed, motion is exact, one exact ray per sonar
    noisy     axes ramp, motion errors are a random walk, sonars with 1 % noise: the settings of the experiments
    measured  as noisy, but the sonars are a Polaroid ring (cone, reflections, second echoes, cross-talk), and infrared
              sensors, compass and clock have errors as well
    building  as measured, in a real building: walls with doors and posts, whose errors last over metres, cones with
              a soft edge; fitted to a real corridor (docs/real-data.md)
    worn      as noisy, with systematic odometry errors: after UMBmark's square of 4 m a robot with a synchro drive is
              126 mm off, a Scout 338 mm, like robots without calibration

A setup file (TOML) derives a setup from one of them; its keys are declared next to the fields (settings.py):

    base = "measured"                   omitted: ideal
    name = "room 12"                    omitted: the name of the file
    ramps, clock_step_s                 and the tables [motion], [odometry], [sonar], [infrared], [compass]
    [sonar]
    model = "polaroid"                  or "ray"; omitted: the base's
    dead = [3, 11]

Errors are WorldFileError: file, key, expected value. There is no global random generator: everything that draws gets a
stream of its own.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from math import radians
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET, Meta, UnsetType

from nclient.common.validation import InvalidValue, Text, convert, given, one_of, reported_as
from nclient.errors import AddressError, WorldFileError, suggest
from nserver_emu.simulation.acoustics import Polaroid, SonarErrors
from nserver_emu.simulation.models import RobotModel
from nserver_emu.simulation.odometry import EXACT, NO_NOISE, MotionNoise, Odometry
from nserver_emu.simulation.sensors import NO_COMPASS_NOISE, NO_INFRARED_NOISE, CompassNoise, InfraredNoise
from nserver_emu.simulation.settings import Key, keys_of, setting
from nserver_emu.simulation.sonar import IDEAL_SONAR, SonarModel, SonarNoise
from worlds.robots import Calibration
from worlds.schema import parse_toml, read_text

log = logging.getLogger(__name__)


class Purpose(IntEnum):
    """The purpose of a random stream. The numbers must never change: they are part of the meaning of a seed."""

    MOTION = 0
    SONAR = 1
    INFRARED = 2
    COMPASS = 3


class RngFactory(NamedTuple):
    """The source of a robot's random streams: its number and the seed of the run, both 0 or more."""

    robot_id: int
    seed: int

    def stream(self, purpose: Purpose) -> np.random.Generator:
        """Return the robot's stream for a purpose: independent of all others, and the same for the same seed."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.robot_id, purpose)))


@dataclass(frozen=True, slots=True)
class RobotSetup:
    """A named combination of settings for the simulation of a robot: one field per table of a setup file."""

    name: str
    ramps: bool = setting(False, 0, 1, "", "axes ramp as trapezoids; otherwise they jump to their speed")
    motion: MotionNoise = NO_NOISE
    sonar: SonarModel = IDEAL_SONAR
    odometry: Odometry = EXACT
    infrared: InfraredNoise = NO_INFRARED_NOISE
    compass: CompassNoise = NO_COMPASS_NOISE
    clock_step_s: float = setting(0.0, 0, 1, "s", "step of the robot's clock; 0: milliseconds")

    @property
    def has_exact_motion(self) -> bool:
        """True if every motion is as commanded; there may be slip."""
        return self.motion == NO_NOISE and self.odometry.is_exact

    def check(self) -> None:
        """Raise ValueError if a value is outside the range of its key."""
        # The ranges of the keys bound the work that a snapshot can cause.
        for key in KEYS:
            key.check(self)


IDEAL: Final = RobotSetup("ideal")
NOISY: Final = RobotSetup("noisy", ramps=True, motion=MotionNoise.walk(along=0.1, turn=0.1, drift=0.005),
                          sonar=SonarNoise(range_std_relative=0.01, range_std_floor_in=0.05))
MEASURED: Final = RobotSetup("measured", ramps=True, motion=NOISY.motion, sonar=Polaroid(),
                             infrared=InfraredNoise(range_std_relative=0.05, slanted=True),
                             compass=CompassNoise(std_rad=radians(0.5), deviation_rad=radians(6.0)),
                             clock_step_s=0.0164)
BUILDING: Final = replace(
    MEASURED,
    name="building",
    # The level of the echo alone ends the cone: a wall is detected to 20 to 25 degrees, as posts are in real data.
    sonar=Polaroid(
        range_std_relative=0.003, cone_rad=radians(50.0), cone_loss_db=24.0, surface_std_in=1.6, surface_length_in=24.0,
        post_spacing_in=40.0, post_loss_db=8.0,
    ),
)
WORN: Final = replace(NOISY, name="worn", odometry=Odometry(scales=(1.0015, 1.0, 1.0), drifts=(7e-5, 0.0), slip_in=0.1))

SETUPS: Final[Mapping[str, RobotSetup]] = MappingProxyType(
    {setup.name: setup for setup in (IDEAL, NOISY, MEASURED, BUILDING, WORN)}
)
"""The predefined setups by name."""


RAY, POLAROID = "ray", "polaroid"
SONAR_MODELS: Final[dict[str, type[SonarNoise] | type[Polaroid]]] = {RAY: SonarNoise, POLAROID: Polaroid}
"""The two sonar models: one exact ray with noise; a Polaroid ring."""

_COMMON: Final = tuple(field.name for field in fields(SonarErrors))
KEYS: Final = (
    *keys_of("", RobotSetup),
    *keys_of("motion", MotionNoise),
    *keys_of("odometry", Odometry),
    *keys_of("sonar", SonarErrors),
    *(key for key in keys_of("sonar", Polaroid, POLAROID) if key.field not in _COMMON),
    *keys_of("infrared", InfraredNoise),
    *keys_of("compass", CompassNoise),
)
"""All keys of a setup file."""

SUFFIX: Final = ".toml"
TABLES: Final = tuple(dict.fromkeys(key.table for key in KEYS if key.table))


def setup_named(name: str) -> RobotSetup:
    """Return the predefined setup of that name, or that of the file `name`, which ends in .toml.

    Raises
    ------
    AddressError
        If there is no such setup.
    WorldFileError
        If the file cannot be read.
    """
    if name in SETUPS:
        return SETUPS[name]
    if not name.endswith(SUFFIX):
        raise AddressError(f"no setup {name!r}; there are {', '.join(SETUPS)}, and files that end in "
                           f"{SUFFIX}{suggest(name, SETUPS)}")
    return load_setup(Path(name))


def load_setup(path: Path) -> RobotSetup:
    """Return the setup of a file. Raises WorldFileError."""
    return parse_setup(read_text(path), str(path), path.stem)


def _table_type(name: str, keys: Iterable[Key], *more: tuple[str, Any, Any], conditions: Iterable[Any] = ()) -> Any:
    """Return the type of a table in which every key is optional; keys of earlier versions are still read.

    `more` are further fields, `conditions` those on several keys as JSON Schema.
    """
    fields = [*more, *((key.name, key.type | UnsetType, UNSET) for key in keys)]
    old = Meta(extra_json_schema={"deprecated": True})
    fields += [(key.former, Annotated[key.type | UnsetType, old], UNSET) for key in keys if key.former]
    both = [{"not": {"required": [key.name, key.former]}} for key in keys if key.former]
    namespace = {"__doc__": f"{name}: how realistic a simulation is.", "CONDITIONS": [*both, *conditions]}
    return msgspec.defstruct(name, fields, namespace=namespace, frozen=True, forbid_unknown_fields=True)


def _keys_in(table: str) -> list[Key]:
    return [key for key in KEYS if key.table == table]


# Keys of the Polaroid ring cannot stand beside exact rays, whether those are named or the base's.
_RING: Final = {"model": {"const": POLAROID}}
_RING_BASES: Final = [name for name, setup in SETUPS.items() if isinstance(setup.sonar, Polaroid)]
_RING_KEYS: Final = [name for key in KEYS if key.sonar_model for name in (key.name, key.former) if name]
_RING_CONDITIONS: Final = [{"anyOf": [
    {"properties": {"sonar": {"properties": _RING, "required": ["model"]}}, "required": ["sonar"]},
    {"properties": {"sonar": {"properties": _RING}, "base": {"enum": _RING_BASES}}, "required": ["base"]},
    {"properties": {"sonar": {"properties": dict.fromkeys(_RING_KEYS, False)}}},
]}]  # fmt: skip
_MODEL: Final = ("model", Annotated[one_of(SONAR_MODELS), Meta(description="one exact ray, or a Polaroid ring")], "")
SetupFile: Final = _table_type(
    "Setup", _keys_in(""),
    ("base", Annotated[one_of(SETUPS), Meta(description="setup that it derives from; default: ideal")], IDEAL.name),
    ("name", Annotated[Text, Meta(description="default: the name of the file")], ""),
    *((part, _table_type(part.capitalize(), _keys_in(part), *[_MODEL][: part == "sonar"]) | UnsetType, UNSET)
      for part in TABLES),
    conditions=_RING_CONDITIONS,
)  # fmt: skip
"""A setup file: how realistic a simulation is."""


def parse_setup(text: str, file: str, name: str) -> RobotSetup:
    """Return the setup of a file's text; `file` is its name in errors, `name` the setup's unless the text gives one."""
    with reported_as(WorldFileError, file):
        values = convert(parse_toml(text, file), SetupFile)
        base = SETUPS[values.base]
        tables = {part: getattr(values, part) for part in TABLES if getattr(values, part) is not UNSET}
        parts = {part: _read_part(row, part, base, file) for part, row in tables.items()}
        return replace(base, name=values.name or name, **_read_fields(values, "", file), **parts)


def _read_part(row: Any, part: str, base: RobotSetup, file: str) -> Any:
    """Return one part of a setup as its table gives it."""
    current, found = getattr(base, part), _read_fields(row, part, file)
    if part == "sonar":
        # The sonar table also selects the model, and has keys that only one model knows.
        model = SONAR_MODELS[row.model] if row.model else type(current)
        # A new model keeps the base's common settings.
        if not isinstance(current, model):
            current = model(**{field: getattr(current, field) for field in _COMMON})
        for key in _keys_in(part):
            if key.field in found and not hasattr(current, key.field):
                other = key.sonar_model
                complaint = f'belongs to the model "{other}"; expected it beside model = "{other}"'
                raise InvalidValue(complaint, f"{part}.{key.name}")
    return replace(current, **found)


def _read_fields(row: Any, table: str, file: str) -> dict[str, Any]:
    """Return the fields that a table gives; log a warning for each key of an earlier version."""
    found: dict[str, Any] = {}
    values = given(row)
    for key in _keys_in(table):
        if key.former in values:
            log.warning("%s: %s.%s is now called %s", file, table, key.former, key.name)
            if key.name in values:
                raise InvalidValue(f"is the former name of {key.name}; expected one of them", f"{table}.{key.former}")
            values[key.name] = values[key.former]
        if key.name in values:
            found[key.field] = key.from_file(values[key.name])
    return found


def apply_model(model: RobotModel, setup: RobotSetup) -> RobotSetup:
    """Return the setup with the calibration of a model in place of the setup's systematic errors, and with its cone.

    Slip and the turret's gears remain those of the setup. A calibration gives distance, turn and drift; in terms of the
    axes of a drive, b its track:

        synchro         scales (distance, turn), drifts (drift, 0)
        differential    right = distance + b turn / 2, left = distance - b turn / 2: scales of one value, and

                        drift_1 = drift / 2 + (turn - distance) / b     drift_2 = drift / 2 - (turn - distance) / b
    """
    half_cone_rad, calibration = model.body.ring.half_cone_rad, model.calibration
    if half_cone_rad is not None and isinstance(setup.sonar, Polaroid):
        setup = replace(setup, sonar=replace(setup.sonar, cone_rad=2.0 * half_cone_rad))
    if calibration is None:
        return setup
    sonar = replace(setup.sonar, offsets_in=calibration.offsets_in, turned_rad=calibration.turned_rad)
    return replace(setup, odometry=_calibrated_odometry(calibration, setup.odometry, model.track_in), sonar=sonar)


def _calibrated_odometry(calibration: Calibration, odometry: Odometry, track_in: float | None) -> Odometry:
    distance, turn, drift = calibration.distance_scale, calibration.turn_scale, calibration.drift_rad_in
    turret = odometry.scales[2]
    # A synchro drive has translation and steering as axes, a differential drive its two wheels.
    if track_in is None:
        return replace(odometry, scales=(distance, turn, turret), drifts=(drift, 0.0))
    apart = (turn - distance) / track_in
    return replace(odometry, scales=(distance, distance, turret), drifts=(drift / 2.0 + apart, drift / 2.0 - apart))


PARTS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "sensors": ("sonar", "infrared", "compass"), "motion": ("motion", "odometry"),
})  # fmt: skip
"""The parts of a setup that can be replaced while a robot runs, and their fields; ramps and clock cannot."""


def part_choices(part: str, model: RobotModel, initial: RobotSetup) -> dict[str, RobotSetup]:
    """Return the choices for a part by name: the predefined setups that differ in it, and the initial one.

    All have the calibration and the cone of the model.
    """
    # Setups that equal an earlier one in this part are not separate choices.
    choices: dict[str, RobotSetup] = {}
    for setup in (*(apply_model(model, named) for named in SETUPS.values()), initial):
        if all(_fields(part, setup) != _fields(part, other) for other in choices.values()):
            choices[setup.name if setup.name not in choices else f"{setup.name} as begun"] = setup
    return choices


def part_name(part: str, setup: RobotSetup, model: RobotModel, initial: RobotSetup) -> str:
    """Return the name of the choice that a part of a setup equals; the setup's own name if there is none."""
    wanted = _fields(part, setup)
    choices = part_choices(part, model, initial).items()
    return next((name for name, choice in choices if _fields(part, choice) == wanted), setup.name)


def with_part(setup: RobotSetup, part: str, source: RobotSetup) -> RobotSetup:
    """Return the setup with a part of another one."""
    return replace(setup, **_fields(part, source))


def _fields(part: str, setup: RobotSetup) -> dict[str, Any]:
    return {field: getattr(setup, field) for field in PARTS[part]}
