"""Robot models: body, drive, limits of the axes; predefined ones and those of model files.

Top speeds and the accelerations at power-on are those of the user's manuals (20 in/s, 45 deg/s; 30 in/s2, 50 deg/s2;
Scout 39 in/s per wheel, 30 in/s2). Assumptions, for no source gives them: robots start at their top speeds,
accelerations go up to twice those numbers, and the encoders report velocities in tenths (0.1 in/s, 0.1 deg/s), as State
does.

A model file (TOML) derives models from existing ones:

    [[model]]
    name, like                    its name, and the model it derives from (omitted: the existing one of that name)
    radius, sonar_ring_radius     of the body; track: between the wheels of a differential drive
    bumpers                       number of bumpers around the body
    [model.ring]                  its sonars (worlds/rings.py)
    compass                       true or false
    [model.odometry], [model.sonar], [model.spread]     its calibration (worlds/robots.py)
    [model.translation]           an axis: top_speed, top_acceleration, speed, acceleration; also steering, turret;
                                  of a differential drive right and left

Lengths end in their unit, _in, _cm or _m, and so do speeds, per second; angles of steering and turret in _deg. Omitted
values are those of the original model. Errors are WorldFileError: file, key, expected value.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import degrees, radians
from pathlib import Path
from types import MappingProxyType
from typing import Final, TypeVar

from msgspec import UNSET, UnsetType

from nclient.common.validation import InvalidValue, given, keys_of, reported_as, unknown_key
from nclient.errors import WorldFileError
from nserver_emu.simulation.axis import MAX_RESTORED_SPEED, AxisLimits
from nserver_emu.simulation.drive import NO_AXIS, DifferentialDrive, Drive, SynchroDrive
from worlds import robots
from worlds.robots import MAX_BUMPERS, AngularAxis, Body, Calibration, LinearAxis, ModelTable, base_of, read_model_file
from worlds.schema import INCHES_PER_UNIT, read_text

T = TypeVar("T")

ROLLING: Final = AxisLimits(top_speed=20.0, top_acceleration=60.0, min_acceleration=0.1, speed=20.0, acceleration=30.0,
                            resolution=0.1)
"""Translation of the synchro drives: inches and seconds."""

TURNING: Final = AxisLimits(top_speed=radians(45.0), top_acceleration=radians(100.0), min_acceleration=radians(0.1),
                            speed=radians(45.0), acceleration=radians(50.0), resolution=radians(0.1))
"""Steering and turret of the synchro drives: radians and seconds."""

WHEEL: Final = AxisLimits(top_speed=39.0, top_acceleration=60.0, min_acceleration=0.1, speed=39.0, acceleration=30.0,
                          resolution=0.1)
"""A wheel of the Scout: inches and seconds."""

SCOUT_WHEEL_IN_PER_DEGREE: Final = 0.118597
"""Travel of each wheel of a Scout per degree of a turn on the spot, the rate constant of its user's manual."""

SCOUT_TRACK_IN: Final = 2.0 * degrees(SCOUT_WHEEL_IN_PER_DEGREE)
"""Distance between the wheels of a Scout that this constant implies: 13.590 in."""

MIN_TRACK_IN: Final = 0.1
MAX_RADIUS_IN: Final = 1000.0
"""Bounds for a model of a snapshot, beyond which its simulation would take too long."""


@dataclass(frozen=True, slots=True)
class RobotModel:
    """A simulated robot model.

    Attributes
    ----------
    name
        Name for users.
    body
        Radii, sonars, bumpers.
    axes
        Limits of the axes in the order of the commands.
    track_in
        Distance between the wheels of a differential drive, inches; None: a synchro drive.
    family
        The model that clients see, one of n150, n200, scout.
    has_light_sensors
        True for a robot with infrared sensors and a laser.
    has_compass
        True for a robot with a compass.
    calibration
        Systematic errors of this individual robot, in place of its setup's; None: not calibrated.
    """

    name: str
    body: Body
    axes: tuple[AxisLimits, AxisLimits, AxisLimits]
    track_in: float | None = None
    family: str = ""
    has_light_sensors: bool = False
    has_compass: bool = True
    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "family", self.family or self.name)

    @property
    def in_inches(self) -> tuple[bool, bool, bool]:
        """True for each axis that counts inches; the others count radians."""
        return SynchroDrive.in_inches if self.track_in is None else DifferentialDrive.in_inches

    def drive(self, ramps: bool) -> Drive:
        """Return a new drive of this model; without `ramps` its axes jump to their speeds."""
        if self.track_in is None:
            return SynchroDrive(self.axes, ramps)
        return DifferentialDrive(self.axes, ramps, self.track_in)

    def check(self) -> None:
        """Raise ValueError if a model from a snapshot cannot be simulated in bounded time."""
        body, track_in = self.body, self.track_in
        if not (0.0 < body.radius_in <= MAX_RADIUS_IN and 0.0 <= body.ring.radius_in <= MAX_RADIUS_IN):
            raise ValueError("a robot without a radius")
        body.ring.check()
        if not 0 < len(body.bumper_angles_rad) <= MAX_BUMPERS:
            raise ValueError("a robot without bumpers")
        if track_in is not None and not MIN_TRACK_IN <= track_in <= MAX_RADIUS_IN:
            raise ValueError("a robot without a track")
        for axis in self.axes:
            # Speeds bound the number of chords and quadrature pieces per segment.
            speeds = (axis.top_speed, axis.speed, axis.resolution)
            if not all(0.0 <= speed <= MAX_RESTORED_SPEED for speed in speeds) or axis.acceleration <= 0.0:
                raise ValueError("an axis without limits")


N150: Final = RobotModel("n150", robots.N150, (ROLLING, TURNING, TURNING))
N200: Final = RobotModel("n200", robots.N200, (ROLLING, TURNING, TURNING), has_light_sensors=True)
SCOUT: Final = RobotModel("scout", robots.SCOUT, (WHEEL, WHEEL, NO_AXIS), SCOUT_TRACK_IN, has_compass=False)

MODELS: Final[Mapping[str, RobotModel]] = MappingProxyType({model.name: model for model in (N150, N200, SCOUT)})
"""The predefined models by name."""

SYNCHRO_AXES: Final = ("translation", "steering", "turret")
WHEELS: Final = ("right", "left")
SPEEDS: Final = ("top_speed", "top_acceleration", "speed", "acceleration")


def load_models(path: Path) -> Mapping[str, RobotModel]:
    """Return the predefined models and those of a file, which may override them. Raises WorldFileError."""
    return parse_models(read_text(path), str(path))


def parse_models(text: str, file: str) -> Mapping[str, RobotModel]:
    """Return the models of a file's text; `file` is its name in errors. A model may derive from an earlier one."""
    rows = read_model_file(text, file)
    models = dict(MODELS)
    with reported_as(WorldFileError, file):
        if not rows:
            raise InvalidValue("expected at least one [[model]], found none")
        for number, row in enumerate(rows):
            if any(row.name == earlier.name for earlier in rows[:number]):
                complaint = f"{row.name!r} is taken by an earlier model; expected another"
                raise InvalidValue(complaint, f"model[{number}].name")
            models[row.name] = _parse_model(row, models, f"model[{number}]")
    return MappingProxyType(models)


def _parse_model(row: ModelTable, models: Mapping[str, RobotModel], place: str) -> RobotModel:
    # 1. The model it derives from.
    base = base_of(row, models, place)
    # 2. Keys of the other drive.
    axes = SYNCHRO_AXES if base.track_in is None else WHEELS
    other = {*SYNCHRO_AXES, *WHEELS, *(f"track_{unit}" for unit in INCHES_PER_UNIT if base.track_in is None)} - {*axes}
    for key in given(row):
        if key in other:
            unknown = unknown_key(key, (name for name in keys_of(row) if name not in other))
            raise InvalidValue(unknown.complaint, f"{place}.{key}")
    # 3. Values.
    limits = [_parse_axis(getattr(row, axis), base.axes[number]) for number, axis in enumerate(axes)]
    first, second, third = (*limits, *base.axes[len(limits) :])
    body = row.body(base.body, place)
    # Offsets of a base with another number of sonars are not its own.
    calibration = row.calibration(body.ring.count, place)
    if calibration is None and body.ring.count == base.body.ring.count:
        calibration = base.calibration
    return replace(base, name=row.name, body=body, axes=(first, second, third),
                   has_compass=_or(row.compass, base.has_compass), track_in=_or(row.track, base.track_in),
                   calibration=calibration)


def _parse_axis(row: LinearAxis | AngularAxis | UnsetType, base: AxisLimits) -> AxisLimits:
    """Return the limits of one axis; a speed at power-on above the new top speed is reduced to it."""
    if row is UNSET:
        return base
    if isinstance(row, LinearAxis):
        values = [_or(getattr(row, key), getattr(base, key)) for key in SPEEDS]
    else:
        angles = {key: getattr(row, f"{key}_deg") for key in SPEEDS}
        values = [getattr(base, key) if angle is UNSET else radians(angle) for key, angle in angles.items()]
    top_speed, top_acceleration, speed, acceleration = values
    return replace(base, top_speed=top_speed, top_acceleration=top_acceleration,
                   min_acceleration=min(base.min_acceleration, acceleration, top_acceleration),
                   speed=min(speed, top_speed), acceleration=min(acceleration, top_acceleration))


def _or(value: T | UnsetType, default: T) -> T:
    return default if value is UNSET else value
