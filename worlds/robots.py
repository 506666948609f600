"""Robot bodies, and the calibration of one robot: systematic errors of its wheels and sonars.

Bodies contain what simulation, filters and viewer must agree on (numbers as in ROBOTS.md). The protocol's view of a
model is in nclient.protocol.types; speeds and accelerations are in the simulation.

    frame       x to the front, y to the left, angles counter-clockwise, inches and radians
    sonars      fixed to the turret (Scout: to the body); a beam points away from the axis, so its reading is the
                range from the axis minus the radius of the ring
    bumpers     fixed to the body, which never turns on the synchro drives

The sonars are a `worlds.rings.Ring`, the table [model.ring] of model files. A calibration is a part of them as well:

    [[model]]
    name = "n150"
    [model.odometry]    way_scale, turn_scale, drift_rad_in    true per counted distance and turn; turn per inch
    [model.sonar]       offsets_in, turned_deg                 reading minus range; rotation of the ring
    [model.spread]      all of these keys                      standard deviations
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import degrees, radians, tau
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final, TypeVar

from msgspec import UNSET, Meta, UnsetType

from nclient.common.validation import InvalidValue, Text, convert, reported_as
from nclient.errors import WorldFileError, suggest
from nclient.protocol.types import SONAR_RING_IN, SONAR_SLOTS
from worlds.rings import MAX_SONARS, Ring, RingTable, evenly, nomad_ring
from worlds.schema import Distance, PositiveAngle, Table, parse_toml, read_text, table

T = TypeVar("T")

SONARS: Final = SONAR_SLOTS
"""Sonars of a Nomad; sonar i looks i x 22.5 degrees counter-clockwise from the front."""


@dataclass(frozen=True, slots=True)
class Body:
    """Shape of a robot model: a vertical cylinder with a ring of sonars and a band of bumpers.

    Attributes
    ----------
    name
        "n150", "n200", "scout", or that of a model file.
    radius_in
        Radius of the cylinder that touches walls, inches.
    ring
        The sonars. On the N200 they are 0.06 in farther out than the body: rays are cast from the axis, so that no beam
        starts behind a wall.
    bumper_angles_rad
        20 angles (Scout: 6) relative to the body.
    """

    name: str
    radius_in: float
    ring: Ring
    bumper_angles_rad: tuple[float, ...]

    @property
    def sonar_ring_radius_in(self) -> float:
        """Distance of the sonars from the axis, inches, before the shifts of the ring."""
        return self.ring.radius_in

    @property
    def sonar_angles_rad(self) -> tuple[float, ...]:
        """Directions of the sonars relative to the front of the turret (Scout: of the body)."""
        return self.ring.angles_rad


N150: Final = Body("n150", 9.72, nomad_ring(SONAR_RING_IN["n150"]), evenly(20))
N200: Final = Body("n200", 9.0, nomad_ring(SONAR_RING_IN["n200"]), evenly(20))
# The radii of the Scout and the positions of its six bumpers are assumptions: no source states them.
SCOUT: Final = Body("scout", 8.0, nomad_ring(SONAR_RING_IN["scout"]), evenly(6))

BODIES: Final[Mapping[str, Body]] = MappingProxyType({body.name: body for body in (N150, N200, SCOUT)})
"""All bodies by name."""


_ODOMETRY: Final = MappingProxyType(
    {"way_scale": "distance_scale", "turn_scale": "turn_scale", "drift_rad_in": "drift_rad_in"}
)
"""Keys of [model.odometry] and the attributes they set."""
MAX_OFFSET_IN: Final = 24.0
MAX_DRIFT_RAD_IN: Final = 0.1
MAX_RING_TURN_DEG: Final = 45.0
MAX_BUMPERS: Final = 24
"""Bits in the three bytes of State[33]."""
_NONE: Final = (0.0,) * SONARS


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of a calibration's numbers; 0 if a number is known exactly."""

    distance_scale: float = 0.0
    turn_scale: float = 0.0
    drift_rad_in: float = 0.0
    offsets_in: tuple[float, ...] = _NONE
    turned_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """Systematic errors of one robot.

    Attributes
    ----------
    distance_scale
        True distance per counted distance.
    turn_scale
        True turn per counted turn.
    drift_rad_in
        Turn per distance, rad/in.
    offsets_in
        Reading minus range of each sonar.
    turned_rad
        Rotation of the sonar ring relative to the turret.
    spread
        Standard deviations of all these numbers.
    """

    distance_scale: float = 1.0
    turn_scale: float = 1.0
    drift_rad_in: float = 0.0
    offsets_in: tuple[float, ...] = _NONE
    turned_rad: float = 0.0
    spread: Spread = Spread()


def calibration_as_json(calibration: Calibration) -> dict[str, Any]:
    """Return a calibration as plain data, with the keys of a model file's tables."""

    def numbers(part: Calibration | Spread) -> dict[str, Any]:
        scales = {key: getattr(part, attribute) for key, attribute in _ODOMETRY.items()}
        return {**scales, "offsets_in": part.offsets_in, "turned_rad": part.turned_rad}

    return {**numbers(calibration), "spread": numbers(calibration.spread)}


IDEAL_CALIBRATION: Final = Calibration()
"""A robot without systematic errors."""


ScaleSpread = Annotated[float, Meta(ge=0.0, le=1.0, description="standard deviation of this number")]
_PerSonar = Meta(min_length=1, max_length=MAX_SONARS, title="a list of numbers, one for each sonar",
                 description="reading minus range of each sonar, or its standard deviation, inches")


@table()
class _Odometry(Table):
    """Systematic errors of the odometry."""

    way_scale: Annotated[float, Meta(ge=0.5, le=2.0, description="true distance per counted distance")] = 1.0
    turn_scale: Annotated[float, Meta(ge=0.5, le=2.0, description="true turn per counted turn")] = 1.0
    drift_rad_in: Annotated[
        float, Meta(ge=-MAX_DRIFT_RAD_IN, le=MAX_DRIFT_RAD_IN, description="turn per distance, rad/in")
    ] = 0.0


@table()
class _Sonar(Table):
    """Systematic errors of the sonars."""

    offsets_in: (
        Annotated[tuple[Annotated[float, Meta(ge=-MAX_OFFSET_IN, le=MAX_OFFSET_IN)], ...], _PerSonar] | UnsetType
    ) = UNSET
    turned_deg: Annotated[
        float, Meta(ge=-MAX_RING_TURN_DEG, le=MAX_RING_TURN_DEG, description="rotation of the ring, degrees")
    ] = 0.0


@table()
class _Spread(Table):
    """Standard deviations of the calibration."""

    way_scale: ScaleSpread = 0.0
    turn_scale: ScaleSpread = 0.0
    drift_rad_in: ScaleSpread = 0.0
    offsets_in: (Annotated[tuple[Annotated[float, Meta(ge=0.0, le=MAX_OFFSET_IN)], ...], _PerSonar] | UnsetType) = UNSET
    turned_deg: Annotated[
        float, Meta(ge=0.0, le=MAX_RING_TURN_DEG, description="of the ring's rotation, degrees")
    ] = 0.0


@table()
class LinearAxis(Table):
    """Limits of an axis that counts distance, per second."""

    top_speed: Distance | UnsetType = UNSET
    top_acceleration: Distance | UnsetType = UNSET
    speed: Distance | UnsetType = UNSET
    acceleration: Distance | UnsetType = UNSET


@table()
class AngularAxis(Table):
    """Limits of an axis that counts angles, in degrees and seconds."""

    top_speed_deg: Annotated[PositiveAngle, Meta(description="largest speed, per second")] | UnsetType = UNSET
    top_acceleration_deg: (
        Annotated[PositiveAngle, Meta(description="largest acceleration, per second squared")] | UnsetType
    ) = UNSET
    speed_deg: Annotated[PositiveAngle, Meta(description="speed at power-on")] | UnsetType = UNSET
    acceleration_deg: Annotated[PositiveAngle, Meta(description="acceleration at power-on")] | UnsetType = UNSET


@table()
class ModelTable(Table):
    """A [[model]]: what differs from the model it derives from."""

    name: Annotated[str, Meta(pattern=r"^[^\sA-Z]([^A-Z]*[^\sA-Z])?$", title="a name in small letters",
                              description="a name in small letters, which selects the model")]
    like: Annotated[Text, Meta(description="model it derives from; default: the existing one of its name")] = ""
    bumpers: Annotated[int, Meta(ge=1, le=MAX_BUMPERS, description="bumpers around the body")] | UnsetType = UNSET
    compass: Annotated[bool, Meta(description="true for a robot with a compass")] | UnsetType = UNSET
    translation: LinearAxis | UnsetType = UNSET
    steering: AngularAxis | UnsetType = UNSET
    turret: AngularAxis | UnsetType = UNSET
    right: LinearAxis | UnsetType = UNSET
    left: LinearAxis | UnsetType = UNSET
    odometry: _Odometry | UnsetType = UNSET
    sonar: _Sonar | UnsetType = UNSET
    spread: _Spread | UnsetType = UNSET
    ring: RingTable | UnsetType = UNSET
    radius: Distance | UnsetType = UNSET
    sonar_ring_radius: Distance | UnsetType = UNSET
    track: Distance | UnsetType = UNSET

    def calibration(self, sonars: int = SONARS, place: str = "") -> Calibration | None:
        """Return the calibration, with ideal values for missing numbers; None if the table has none.

        Parameters
        ----------
        sonars
            Number of sonars of the model's ring.
        place
            Name of the table in errors.

        Raises
        ------
        InvalidValue
            Another number of offsets than of sonars.
        """
        if not (self.odometry or self.sonar or self.spread):
            return None
        odometry, sonar, spread = self.odometry or _Odometry(), self.sonar or _Sonar(), self.spread or _Spread()
        offsets, offset_stds = (_offsets_of(part.offsets_in, sonars, f"{place}.{name}.offsets_in")
                                for part, name in ((sonar, "sonar"), (spread, "spread")))
        return Calibration(
            odometry.way_scale, odometry.turn_scale, odometry.drift_rad_in, offsets, radians(sonar.turned_deg),
            Spread(spread.way_scale, spread.turn_scale, spread.drift_rad_in, offset_stds, radians(spread.turned_deg)),
        )  # fmt: skip

    def body(self, base: Body, place: str) -> Body:
        """Return the body that this table makes of another one. Raises InvalidValue."""
        # 1. The ring; with mounts of its own it has no radius.
        ring = base.ring
        if self.sonar_ring_radius is not UNSET:
            if self.ring and self.ring.mounts is not UNSET:
                complaint = "expected a radius of the ring or mounts of its sonars, found both"
                raise InvalidValue(complaint, f"{place}.{self.key_of('sonar_ring_radius')}")
            ring = replace(ring, radius_in=self.sonar_ring_radius)
        if self.ring:
            ring = self.ring.ring(ring, f"{place}.ring")
        # 2. Bumpers are evenly spaced from the front.
        angles = base.bumper_angles_rad
        if self.bumpers is not UNSET:
            angles = tuple(tau * number / self.bumpers for number in range(self.bumpers))
        return Body(self.name, base.radius_in if self.radius is UNSET else self.radius, ring, angles)


def _offsets_of(offsets_in: tuple[float, ...] | UnsetType, sonars: int, key: str) -> tuple[float, ...]:
    """Return an offset for each sonar, 0 without any. Raises InvalidValue for another number of them."""
    if offsets_in is UNSET:
        return (0.0,) * sonars
    if len(offsets_in) != sonars:
        raise InvalidValue(f"expected a list of {sonars} numbers, found {len(offsets_in)}", key)
    return offsets_in


@table(condition={"required": ["model"], "properties": {"model": {"minItems": 1}}})
class ModelFile(Table):
    """A model file: robot models, and calibrations of single robots."""

    model: tuple[ModelTable, ...] = ()


def read_model_file(text: str, file: str) -> tuple[ModelTable, ...]:
    """Return the tables of a model file's text; `file` is its name in errors. Raises WorldFileError."""
    with reported_as(WorldFileError, file):
        return convert(parse_toml(text, file), ModelFile).model


def base_of(row: ModelTable, models: Mapping[str, T], place: str) -> T:
    """Return the model that a table derives from. Raises InvalidValue if there is none of that name."""
    like = row.like or row.name
    if like not in models:
        raise InvalidValue(
            f"expected a model to be made from, `like` one of {', '.join(models)}, found {like!r}"
            f"{suggest(like, models)}", f"{place}.{'like' if row.like else 'name'}",
        )  # fmt: skip
    return models[like]


def load_bodies(path: Path) -> Mapping[str, Body]:
    """Return the bodies of the Nomads and those of a model file, which may override them. Raises WorldFileError."""
    bodies = dict(BODIES)
    with reported_as(WorldFileError, str(path)):
        for number, row in enumerate(read_model_file(read_text(path), str(path))):
            place = f"model[{number}]"
            bodies[row.name] = row.body(base_of(row, bodies, place), place)
    return MappingProxyType(bodies)


def load_calibration(path: Path, name: str) -> Calibration:
    """Return the calibration of the model `name` in a model file. Raises WorldFileError if there is none."""
    rows = read_model_file(read_text(path), str(path))
    models = {row.name: (number, row) for number, row in reversed([*enumerate(rows)])}
    if name not in models:
        names = ", ".join(map(repr, reversed(models))) or "none"
        raise WorldFileError(f"{path}: has no model {name!r}; it has {names}")
    number, row = models[name]
    with reported_as(WorldFileError, str(path)):
        return row.calibration(_sonars_of(row, rows[:number]), f"model[{number}]") or IDEAL_CALIBRATION


def _sonars_of(row: ModelTable, earlier: tuple[ModelTable, ...]) -> int:
    """Return the number of sonars of a model; what it derives from need not exist."""
    if row.ring and row.ring.angles_deg is not UNSET:
        return len(row.ring.angles_deg)
    like = row.like or row.name
    for number, other in reversed([*enumerate(earlier)]):
        if other.name == like:
            return _sonars_of(other, earlier[:number])
    return BODIES[like].ring.count if like in BODIES else SONARS


def format_calibration(name: str, found: Calibration, comment: str = "") -> str:
    """Return the text of a model file with one model; each line of `comment` precedes it as a comment."""
    spread = found.spread
    lines = [
        *(f"# {line}" for line in comment.splitlines()),
        "[[model]]", f'name = "{name}"', "", "[model.odometry]", *_numbers(found),
        "", "[model.sonar]", *_offsets(found), "", "[model.spread]", *_numbers(spread), *_offsets(spread),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _numbers(of: Calibration | Spread) -> list[str]:
    return [f"{key} = {getattr(of, attribute):.6g}" for key, attribute in _ODOMETRY.items()]


def _offsets(of: Calibration | Spread) -> list[str]:
    listed = ", ".join(f"{offset:.4g}" for offset in of.offsets_in)
    return [f"offsets_in = [{listed}]", f"turned_deg = {degrees(of.turned_rad):.5g}"]
