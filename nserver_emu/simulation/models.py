"""The models that can be simulated: body, drive, limits of the axes. Data; what the wire says of a model is protocol's.

Top speeds and the accelerations at power-on are the users' numbers (20 in/s, 45 deg/s; 30 in/s2, 50 deg/s2; Scout
39 in/s a wheel, 30 in/s2). Decisions of ours, for no source gives them: robots wake at their top speeds, accelerations
go up to twice those numbers, and the encoders tell velocities in tenths (0.1 in/s, 0.1 deg/s), as State does.

Model files: TOML in, robot models out, each made from one that is known. It and setup_toml.py alone touch the disk.

    [[model]]
    name, like                    its name, and the model it is made from: left out, the known one of that name
    radius, sonar_ring_radius     of the body; track: between the wheels of a differential drive
    bumpers                       how many around the body
    compass                       true or false: whether it has one
    [model.odometry], [model.sonar], [model.spread]     what it gets wrong every time (worlds/robots.py)
    [model.translation]           an axis: top_speed, top_acceleration, speed, acceleration; so steering, turret;
                                  of a differential drive right and left

Lengths end in their unit, _in, _cm or _m, and so do speeds, a second; angles of steering and turret in _deg. What is
left out is as it was. Whatever is wrong is a WorldFileError: file, key, what was expected.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import degrees, radians, tau
from pathlib import Path
from types import MappingProxyType
from typing import Final

from nclient.common.hints import suggest
from nserver_emu.simulation.axis import AxisLimits
from nserver_emu.simulation.drive import NO_AXIS, DifferentialDrive, Drive, SynchroDrive
from worlds.robots import N150 as N150_BODY
from worlds.robots import N200 as N200_BODY
from worlds.robots import SCOUT as SCOUT_BODY
from worlds.robots import TABLES as CALIBRATION_TABLES
from worlds.robots import Body, Calibration, parse_calibration
from worlds.schema import INCHES_PER_UNIT, Table, parse_toml, read_text

ROLLING: Final = AxisLimits(
    top_speed=20.0,
    top_acceleration=60.0,
    least_acceleration=0.1,
    speed=20.0,
    acceleration=30.0,
    resolution=0.1,
)
"""Translation of the synchro drives: inches and seconds."""

TURNING: Final = AxisLimits(
    top_speed=radians(45.0),
    top_acceleration=radians(100.0),
    least_acceleration=radians(0.1),
    speed=radians(45.0),
    acceleration=radians(50.0),
    resolution=radians(0.1),
)
"""Steering and turret of the synchro drives: radians and seconds."""

WHEEL: Final = AxisLimits(
    top_speed=39.0,
    top_acceleration=60.0,
    least_acceleration=0.1,
    speed=39.0,
    acceleration=30.0,
    resolution=0.1,
)
"""A wheel of the Scout: inches and seconds."""

SCOUT_WHEEL_IN_PER_DEGREE: Final = 0.118597
"""Way of each wheel of a Scout for a turn of one degree on the spot, the users' rate constant."""

SCOUT_TRACK_IN: Final = 2.0 * degrees(SCOUT_WHEEL_IN_PER_DEGREE)
"""Distance between the wheels of a Scout that this constant means: 13.590 in."""


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A model as physics sees it.

    name        what users call it
    body        radii, sonars, bumpers
    axes        limits of the axes in the order of the commands
    track_in    distance between the wheels of a differential drive, inches; None: a synchro drive
    family      the model that it is to a client, which knows three: n150, n200, scout
    sees        whether it has infrareds and a laser
    compass     whether it has a compass
    errs        what this very robot gets wrong every time, whatever its setup says of that; None: nothing is known
    """

    name: str
    body: Body
    axes: tuple[AxisLimits, AxisLimits, AxisLimits]
    track_in: float | None = None
    family: str = ""
    sees: bool = False
    compass: bool = True
    errs: Calibration | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "family", self.family or self.name)

    @property
    def rolls(self) -> tuple[bool, bool, bool]:
        """Which axes count inches; the others count radians."""
        return SynchroDrive.rolls if self.track_in is None else DifferentialDrive.rolls

    def drive(self, ramps: bool) -> Drive:
        """A new drive of this model; `ramps` False: its axes jump to their speeds."""
        if self.track_in is None:
            return SynchroDrive(self.axes, ramps)
        return DifferentialDrive(self.axes, ramps, self.track_in)


N150: Final = RobotModel("n150", N150_BODY, (ROLLING, TURNING, TURNING))
N200: Final = RobotModel("n200", N200_BODY, (ROLLING, TURNING, TURNING), sees=True)
SCOUT: Final = RobotModel("scout", SCOUT_BODY, (WHEEL, WHEEL, NO_AXIS), SCOUT_TRACK_IN, compass=False)

MODELS: Final[Mapping[str, RobotModel]] = MappingProxyType({model.name: model for model in (N150, N200, SCOUT)})
"""Every model that can be simulated by its name."""


MOST_BUMPERS: Final = 24
"""Bits in the three bytes of State[33]."""

SYNCHRO_AXES: Final = ("translation", "steering", "turret")
WHEELS: Final = ("right", "left")
SPEEDS: Final = ("top_speed", "top_acceleration", "speed", "acceleration")


def load_models(path: Path) -> Mapping[str, RobotModel]:
    """Every model there is with a file's: those it overrides and those it adds. Raises WorldFileError."""
    return parse_models(read_text(path), str(path))


def parse_models(text: str, file: str) -> Mapping[str, RobotModel]:
    """The same from the text of a file; `file` is what errors call it. A model may be like one above it."""
    values = parse_toml(text, file)
    top = Table(file, "", values)
    top.allow(("model",))
    models = dict(MODELS)
    taken: set[str] = set()
    for table in top.tables("model"):
        model = _model(table, models)
        if model.name in taken:
            table.fail("name", f"{model.name!r} is taken by an earlier model; expected another")
        taken.add(model.name)
        models[model.name] = model
    if not taken:
        top.fail("", "expected at least one [[model]], found none")
    return MappingProxyType(models)


def _model(table: Table, models: Mapping[str, RobotModel]) -> RobotModel:
    name = table.text("name", "")
    if not name or name != name.strip().lower():
        table.fail("name", f"expected a name in small letters, found {name!r}")
    like = table.text("like", name)
    if like not in models:
        key = "like" if "like" in table.values else "name"
        table.fail(
            key, f"expected a model to be made from, `like` one of {', '.join(models)}, found {like!r}"
            f"{suggest(like, models)}"
        )  # fmt: skip
    base = models[like]
    axes = SYNCHRO_AXES if base.track_in is None else WHEELS
    table.allow(
        ("name", "like", "bumpers", "compass", *axes, *CALIBRATION_TABLES),
        ("radius", "sonar_ring_radius", *(() if base.track_in is None else ("track",))),
    )
    limits = [_axis(table, axis, base.axes[number], base.rolls[number]) for number, axis in enumerate(axes)]
    first, second, third = (*limits, *base.axes[len(limits) :])
    return replace(
        base,
        name=name,
        family=base.family,
        body=_body(table, name, base.body),
        axes=(first, second, third),
        compass=table.flag("compass") if "compass" in table.values else base.compass,
        track_in=None if base.track_in is None else _length(table, "track", base.track_in),
        errs=parse_calibration(table) if {*CALIBRATION_TABLES} & {*table.values} else base.errs,
    )


def _body(table: Table, name: str, base: Body) -> Body:
    count = table.index("bumpers", MOST_BUMPERS + 1)
    if count == 0:
        table.fail("bumpers", f"expected 1 to {MOST_BUMPERS}, found 0")
    angles = base.bumper_angles_rad if count is None else tuple(tau * number / count for number in range(count))
    return replace(
        base,
        name=name,
        radius_in=_length(table, "radius", base.radius_in),
        sonar_ring_radius_in=_length(table, "sonar_ring_radius", base.sonar_ring_radius_in),
        bumper_angles_rad=angles,
    )


def _axis(model: Table, name: str, base: AxisLimits, rolls: bool) -> AxisLimits:
    """The limits of one axis; one that wakes faster than its new top speed wakes at that."""
    if name not in model.values:
        return base
    table = model.table(name)
    table.allow(*(((), SPEEDS) if rolls else ([f"{speed}_deg" for speed in SPEEDS],)))
    top_speed, top_acceleration, speed, acceleration = (
        _length(table, key, getattr(base, key)) if rolls else _angle(table, key, getattr(base, key)) for key in SPEEDS
    )
    least = min(base.least_acceleration, acceleration, top_acceleration)
    return replace(
        base,
        top_speed=top_speed,
        top_acceleration=top_acceleration,
        least_acceleration=least,
        speed=min(speed, top_speed),
        acceleration=min(acceleration, top_acceleration),
    )


def _length(table: Table, name: str, default_in: float) -> float:
    """A length, or a speed in lengths, above 0; the default where no unit of it is given."""
    if not any(f"{name}_{unit}" in table.values for unit in INCHES_PER_UNIT):
        return default_in
    return _positive(table, table.key_of(name), table.length_in(name))


def _angle(table: Table, name: str, default_rad: float) -> float:
    key = f"{name}_deg"
    return _positive(table, key, table.angle_rad(name)) if key in table.values else default_rad


def _positive(table: Table, key: str, value: float) -> float:
    if value <= 0.0:
        table.fail(key, f"expected more than 0, found {table.values[key]}")
    return value
