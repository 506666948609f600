"""Chance: a stream of it for each robot and purpose, and how the true motion strays from the commanded one.

No global generator: whoever draws is handed a stream. Errors that are the same every time are odometry.py's.

Setups: how much like a real robot a simulated one is. Data; whoever uses a number explains it.

ideal     axes jump to their speed, motion is exact, one exact ray a sonar
noisy     axes ramp, motion strays like a random walk, sonars with 1 % noise: the settings of the experiments
measured  as noisy, but the sonars hear like a Polaroid ring: cone, mirrors, second echoes, cross-talk;
          infrareds, compass and clock err as well
worn      as noisy, on wheels that err the same way every time: at the end of UMBmark's square of 4 m a robot with
          a synchro drive is 126 mm off, a Scout 338 mm, as robots are that nobody has calibrated

Files can make more of them: setup_toml.py.

Every key of a setup file: where it goes, what it may be, what it means. Data; reader and page of keys read it.

    Key    table | field of the table's dataclass | lowest and highest | unit | meaning

Rules: one row for each field of the dataclasses that a setup is made of; a field in radians is a key in degrees.

Setup files of our own: TOML in, a RobotSetup out. Only this file and model_files.py touch the disk.

    base = "measured"                   what it is made from: a named setup; left out: ideal
    name = "room 12"                    left out: the file's name
    ramps, clock_step_s                 and by table [motion], [odometry], [sonar], [infrared], [compass]
    [sonar]
    model = "polaroid"                  or "ray"; left out: the base's
    dead = [3, 11]

All keys are setup_keys.py's; what is left out is as in the base. Whatever is wrong is a WorldFileError: file, key, what
was expected.

A robot's own errors in place of its setup's: what a calibration says, as errors of this drive's axes and this ring.

    synchro         translation and steering are way and turn themselves: scales (way, turn), drifts (drift, 0)
    differential    right = way + b turn / 2, left = way - b turn / 2: wheels of one scale, and drifts that part them,

                    drift_1 = drift / 2 + (turn - way) / b        drift_2 = drift / 2 - (turn - way) / b

Rules: pure. Slip and the turret's gears stay the setup's.

The parts of a setup that can be switched while a robot runs: how its sensors err, and how its motion strays.

    sensors    sonar, infrared, compass        motion    motion, odometry

Rules: ramps and the robot's clock are no noise and stay as they are. A part is called after the first named setup that
has it so, or after the setup that the robot began with.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from enum import IntEnum
from math import radians, sqrt
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.common.hints import suggest
from nclient.errors import AddressError
from nserver_emu.simulation.acoustics import Polaroid
from nserver_emu.simulation.compass import TRUE_NEEDLE, CompassNoise
from nserver_emu.simulation.infrared import CLEAR_SIGHT, InfraredNoise
from nserver_emu.simulation.models import RobotModel
from nserver_emu.simulation.odometry import EXACT, Odometry
from nserver_emu.simulation.segments import Stretch
from nserver_emu.simulation.sonar import EchoModel, SonarNoise
from worlds.robots import SONARS, Calibration
from worlds.schema import Table, parse_toml, read_text


class Purpose(IntEnum):
    """What a stream is for. Numbers are kept for ever: they are part of what a seed means."""

    MOTION = 0
    SONAR = 1
    INFRARED = 2
    COMPASS = 3


class Identity(NamedTuple):
    """Which robot of which run: the key of all its chance. Both numbers are 0 or more."""

    robot_id: int
    seed: int

    def stream(self, purpose: Purpose) -> np.random.Generator:
        """The stream of this robot for one purpose: independent of all others, always the same for the same key."""
        return np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.robot_id, purpose)))


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """A random walk that grows with the way, in the names of Probabilistic Robotics' odometry model (section 5.4).

    A stretch of length |d| inches that turns by |a| radians goes d + e instead and turns the whole body by f, with

        var(f) = alpha1 |a| + alpha2 |d|      alpha1  rad        turn, from turning
                                              alpha2  rad^2/in   turn, from driving
        var(e) = alpha3 |d| + alpha4 |a|      alpha3  in         way, from driving
                                              alpha4  in^2/rad   way, from turning

    The book's variances grow with the squares d^2 and a^2, so that the spread of a way depends on how it is cut; here
    variances of pieces add up. Of a localizer that updates every D inches and A radians, the numbers for one update
    are alpha1 / A, alpha3 / D, and alpha2 / D, alpha4 / A.
    """

    alpha1: float = 0.0
    alpha2: float = 0.0
    alpha3: float = 0.0
    alpha4: float = 0.0

    @classmethod
    def walk(cls, along: float = 0.0, turn: float = 0.0, drift: float = 0.0) -> MotionNoise:
        """By the roots that the experiments' table of settings gives.

        along   sqrt(inch)          alpha3 = along^2
        turn    sqrt(radian)        alpha1 = turn^2
        drift   radian/sqrt(inch)   alpha2 = drift^2
        """
        return cls(alpha1=turn**2, alpha2=drift**2, alpha3=along**2)

    def way_std_in(self, way_in: float, angle_rad: float) -> float:
        """Standard deviation of the length of a way on which the robot turns by an angle, inches."""
        return sqrt(self.alpha3 * abs(way_in) + self.alpha4 * abs(angle_rad))

    def turn_std_rad(self, way_in: float, angle_rad: float) -> float:
        """Standard deviation of the turn of the body on the same way."""
        return sqrt(self.alpha1 * abs(angle_rad) + self.alpha2 * abs(way_in))

    def disturbed(self, stretch: Stretch, chance: np.random.Generator) -> Stretch:
        """The stretch that is really driven: the same seconds, another length, and a turn that carries the body along.

        Its turn less that of the commanded stretch is the body's. Draws twice if anything moves and there
        is noise, else never; then the very same stretch comes back.
        """
        duration = stretch.duration_s
        way, angle = stretch.distance_at(duration), stretch.turn_at(duration)
        if self == NO_NOISE or (way == 0.0 and angle == 0.0):
            return stretch
        longer = self.way_std_in(way, angle) * chance.standard_normal()
        turned = self.turn_std_rad(way, angle) * chance.standard_normal()
        scale = 1.0 + longer / way if way else 1.0
        return Stretch(
            duration,
            stretch.speed * scale if way else longer / duration,
            stretch.acceleration * scale,
            stretch.turn_rate + turned / duration,
            stretch.turn_acceleration,
        )


NO_NOISE: Final = MotionNoise()
"""Every motion as commanded."""


@dataclass(frozen=True, slots=True)
class RobotSetup:
    """A named way to simulate a robot.

    name      what users call it
    ramps     False: axes jump to their speed, as the original documents; True: trapezoids
    motion    how the true motion strays from the commanded one: alpha1 to alpha4
    sonar     what the sonars hear, and how readings stray from the true range
    odometry  what the wheels get wrong every time: scales, drifts, slip
    infrared  how light comes back to the infrareds
    compass   noise and deviation of the compass
    clock_step_s   the robot's clock goes in steps of this; 0: in milliseconds
    """

    name: str
    ramps: bool
    motion: MotionNoise
    sonar: EchoModel
    odometry: Odometry = EXACT
    infrared: InfraredNoise = CLEAR_SIGHT
    compass: CompassNoise = TRUE_NEEDLE
    clock_step_s: float = 0.0

    @property
    def moves_as_told(self) -> bool:
        """Whether every motion is as commanded; there may be slip."""
        return self.motion == NO_NOISE and self.odometry.turns_as_told


IDEAL: Final = RobotSetup("ideal", ramps=False, motion=NO_NOISE, sonar=SonarNoise())
NOISY: Final = RobotSetup(
    "noisy",
    ramps=True,
    motion=MotionNoise.walk(along=0.1, turn=0.1, drift=0.005),
    sonar=SonarNoise(std_share=0.01, least_std_in=0.05),
)
MEASURED: Final = RobotSetup(
    "measured",
    ramps=True,
    motion=NOISY.motion,
    sonar=Polaroid(),
    infrared=InfraredNoise(std_share=0.05, slanted=True),
    compass=CompassNoise(std_rad=radians(0.5), deviation_rad=radians(6.0)),
    clock_step_s=0.0164,
)
WORN: Final = replace(
    NOISY,
    name="worn",
    odometry=Odometry(scales=(1.0015, 1.0, 1.0), drifts=(7e-5, 0.0), slip_in=0.1),
)

SETUPS: Final[Mapping[str, RobotSetup]] = MappingProxyType(
    {setup.name: setup for setup in (IDEAL, NOISY, MEASURED, WORN)}
)
"""Every setup by its name."""


def setup_names() -> tuple[str, ...]:
    """The setups that have a name."""
    return tuple(SETUPS)


SONAR_NUMBERS: Final = "sonars"
"""The unit of a list of sonars, 0 to 15."""


class Key(NamedTuple):
    """A row; "" as table: the top of the file. `ears`: which of the two sonar models has it, "" for both."""

    table: str
    field: str
    low: float
    high: float
    unit: str
    meaning: str
    ears: str = ""

    @property
    def name(self) -> str:
        """What users write."""
        return f"{self.field.removesuffix('_rad')}_deg" if self.in_degrees else self.field

    @property
    def in_degrees(self) -> bool:
        """Whether it is an angle, which physics has in radians."""
        return self.field.endswith("_rad")

    def of(self, setup: RobotSetup) -> object:
        """What a setup has there, in physics' units; None where its sonar model has no such thing."""
        return getattr(getattr(setup, self.table) if self.table else setup, self.field, None)


RAY, POLAROID = "ray", "polaroid"
"""The two sonar models: one exact ray with noise; a Polaroid ring."""

KEYS: Final = (
    Key("", "ramps", 0, 1, "", "axes ramp as trapezoids; else they jump to their speed"),
    Key("", "clock_step_s", 0, 1, "s", "the robot's clock goes in steps of this; 0: in milliseconds"),
    Key("motion", "alpha1", 0, 10, "rad", "variance of the turn a radian turned"),
    Key("motion", "alpha2", 0, 10, "rad^2/in", "variance of the turn an inch driven"),
    Key("motion", "alpha3", 0, 10, "in", "variance of the way an inch driven"),
    Key("motion", "alpha4", 0, 10, "in^2/rad", "variance of the way a radian turned"),
    Key("odometry", "scales", 0.5, 2, "", "true travel per counted travel: translation, steering, turret (Scout: "
        "right, left wheel, nothing)"),
    Key("odometry", "drifts", -0.1, 0.1, "rad/in, rad/rad", "turn of the body per counted travel of the first two axes "
        "(Scout: rad/in both)"),
    Key("odometry", "slip_in", 0, 10, "in", "way the wheels roll on the spot at every contact"),
    Key("sonar", "std_share", 0, 1, "", "standard deviation of a range as a share of it"),
    Key("sonar", "least_std_in", 0, 10, "in", "and never less than this"),
    Key("sonar", "dead", 0, 15, SONAR_NUMBERS, "sonars that read 0 for ever"),
    Key("sonar", "offsets_in", -24, 24, "in", "what each of the 16 sonars reads more than the range, always"),
    Key("sonar", "turned_rad", -45, 45, "deg", "the ring stands turned by this against the turret"),
    Key("sonar", "cone_rad", 1, 90, "deg", "whole angle of the cone inside which a sonar cries and hears", POLAROID),
    Key("sonar", "sound_in_s", 1000, 100000, "in/s", "speed of sound", POLAROID),
    Key("sonar", "margin_db", 0, 200, "dB", "how much louder than just audible a near wall is, met head-on", POLAROID),
    Key("sonar", "margin_std_db", 0, 20, "dB", "standard deviation of that from cry to cry", POLAROID),
    Key("sonar", "cone_loss_db", 0, 200, "dB", "lost at the rim of the cone, out and back together", POLAROID),
    Key("sonar", "way_loss_db_in", 0.02, 100, "dB/in", "lost an inch of range", POLAROID),
    Key("sonar", "bounce_loss_db", 0, 200, "dB", "lost at each wall after the first", POLAROID),
    Key("sonar", "edge_loss_db", 0, 200, "dB", "lost at an edge, against a wall", POLAROID),
    Key("sonar", "skin_loss_db", 0, 200, "dB", "lost at the skin of a robot that does not face the sonar", POLAROID),
    Key("sonar", "blanking_in", 0, 24, "in", "echoes of neighbours from nearer are not heard", POLAROID),
    Key("sonar", "recess_in", 0, 4, "in", "how deep behind the ring the transducers sit", POLAROID),
    Key("infrared", "std_share", 0, 1, "", "standard deviation of a range as a share of it"),
    Key("infrared", "slanted", 0, 1, "", "what is seen at a slant looks farther"),
    Key("compass", "std_rad", 0, 90, "deg", "standard deviation of a reading"),
    Key("compass", "deviation_rad", 0, 90, "deg", "the robot's iron, until calibrated: d sin(heading + phase)"),
    Key("compass", "phase_rad", -360, 360, "deg", "the phase in that"),
)  # fmt: skip


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
            f"{suggest(name, SETUPS)}"
        )
    return load_setup(Path(name))


def load_setup(path: Path) -> RobotSetup:
    """The setup of a file. Raises WorldFileError."""
    return parse_setup(read_text(path), str(path), path.stem)


def parse_setup(text: str, file: str, name: str) -> RobotSetup:
    """The same from a text; `file` is what errors call it, `name` what the setup is called unless it says so."""
    values = parse_toml(text, file)
    top = Table(file, "", values)
    top.allow(("base", "name", *(key.name for key in KEYS if not key.table), *TABLES))
    base_name = top.text("base", IDEAL.name)
    if base_name not in SETUPS:
        known = ", ".join(SETUPS)
        top.fail("base", f"expected one of {known}, found {base_name!r}{suggest(base_name, SETUPS)}")
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
        table.fail("model", f"expected one of {', '.join(EARS)}, found {asked!r}{suggest(asked, EARS)}")
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


def setup_of(model: RobotModel, setup: RobotSetup) -> RobotSetup:
    """How a robot of this model is simulated with this setup."""
    errs = model.errs
    if errs is None:
        return setup
    sonar = replace(setup.sonar, offsets_in=errs.offsets_in, turned_rad=errs.turned_rad)
    return replace(setup, odometry=_odometry(errs, setup.odometry, model.track_in), sonar=sonar)


def _odometry(errs: Calibration, odometry: Odometry, track_in: float | None) -> Odometry:
    way, turn, drift, turret = errs.way_scale, errs.turn_scale, errs.drift_rad_in, odometry.scales[2]
    if track_in is None:
        return replace(odometry, scales=(way, turn, turret), drifts=(drift, 0.0))
    apart = (turn - way) / track_in
    return replace(odometry, scales=(way, way, turret), drifts=(drift / 2.0 + apart, drift / 2.0 - apart))


PARTS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "sensors": ("sonar", "infrared", "compass"), "motion": ("motion", "odometry"),
})  # fmt: skip
"""The fields of RobotSetup that each part is made of."""


def part_choices(part: str, model: RobotModel, began: RobotSetup) -> dict[str, RobotSetup]:
    """What a part can be switched to, by name: the named setups that differ in it, and the one begun with; all with
    what this model errs by itself (individual)."""
    choices: dict[str, RobotSetup] = {}
    for setup in (*(setup_of(model, named) for named in SETUPS.values()), began):
        if all(_fields(part, setup) != _fields(part, other) for other in choices.values()):
            choices[setup.name if setup.name not in choices else f"{setup.name} as begun"] = setup
    return choices


def part_name(part: str, setup: RobotSetup, model: RobotModel, began: RobotSetup) -> str:
    """What a part of a setup is called; the setup's own name for one that is none of the choices."""
    wanted = _fields(part, setup)
    choices = part_choices(part, model, began).items()
    return next((name for name, choice in choices if _fields(part, choice) == wanted), setup.name)


def with_part(setup: RobotSetup, part: str, source: RobotSetup) -> RobotSetup:
    """The setup with a part as another one has it."""
    return replace(setup, **_fields(part, source))


def _fields(part: str, setup: RobotSetup) -> dict[str, Any]:
    return {field: getattr(setup, field) for field in PARTS[part]}
