"""Robot bodies, and the calibration of one robot: systematic errors of its wheels and sonars.

Bodies contain what simulation, filters and viewer must agree on (numbers as in ROBOTS.md). The protocol's view of a
model is in nclient.protocol.types; speeds and accelerations are in the simulation.

    frame       x to the front, y to the left, angles counter-clockwise, inches and radians
    sonars      fixed to the turret (Scout: to the body); a beam points away from the axis, so its reading is the
                range from the axis minus the radius of the ring
    bumpers     fixed to the body, which never turns on the synchro drives

A calibration is a part of model files:

    [[model]]
    name = "n150"
    [model.odometry]    way_scale, turn_scale, drift_rad_in    true per counted distance and turn; turn per inch
    [model.sonar]       offsets_in, turned_deg                 reading minus range; rotation of the ring
    [model.spread]      all of these keys                      standard deviations
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, radians
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final

from msgspec import UNSET, Meta, UnsetType

from nclient.common.validation import Text, convert, reported_as
from nclient.errors import WorldFileError
from worlds.schema import Distance, PositiveAngle, Table, parse_toml, read_text, table

SONARS: Final = 16
"""Sonars of a ring; sonar i looks i x 22.5 degrees counter-clockwise from the front."""


@dataclass(frozen=True, slots=True)
class Body:
    """Shape of a robot model: a vertical cylinder with a ring of sonars and a band of bumpers.

    Attributes
    ----------
    name
        "n150", "n200" or "scout".
    radius_in
        Radius of the cylinder that touches walls, inches.
    sonar_ring_radius_in
        Distance of the sonars from the axis, inches. On the N200 it is 0.06 in more than the body: rays are cast from
        the axis, so that no beam starts behind a wall.
    sonar_angles_rad
        16 angles relative to the front of the turret (Scout: of the body).
    bumper_angles_rad
        20 angles (Scout: 6) relative to the body.
    """

    name: str
    radius_in: float
    sonar_ring_radius_in: float
    sonar_angles_rad: tuple[float, ...]
    bumper_angles_rad: tuple[float, ...]


def _evenly(count: int) -> tuple[float, ...]:
    """Return `count` evenly spaced angles in radians, the first at 0, counter-clockwise."""
    return tuple(radians(360.0 * number / count) for number in range(count))


N150: Final = Body("n150", 9.72, 9.06, _evenly(SONARS), _evenly(20))
N200: Final = Body("n200", 9.0, 9.06, _evenly(SONARS), _evenly(20))
# The radii of the Scout and the positions of its six bumpers are assumptions: no source states them.
SCOUT: Final = Body("scout", 8.0, 8.0, _evenly(SONARS), _evenly(6))

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
        16 numbers: reading minus range of each sonar.
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


ScaleSpread = Annotated[float, Meta(ge=0.0, le=1.0)]
Sixteen = Meta(min_length=SONARS, max_length=SONARS, title=f"a list of {SONARS} numbers")


@table()
class _Odometry(Table):
    way_scale: Annotated[float, Meta(ge=0.5, le=2.0, description="true distance per counted distance")] = 1.0
    turn_scale: Annotated[float, Meta(ge=0.5, le=2.0, description="true turn per counted turn")] = 1.0
    drift_rad_in: Annotated[
        float, Meta(ge=-MAX_DRIFT_RAD_IN, le=MAX_DRIFT_RAD_IN, description="turn per distance, rad/in")
    ] = 0.0


@table()
class _Sonar(Table):
    offsets_in: Annotated[tuple[Annotated[float, Meta(ge=-MAX_OFFSET_IN, le=MAX_OFFSET_IN)], ...], Sixteen] = _NONE
    turned_deg: Annotated[
        float, Meta(ge=-MAX_RING_TURN_DEG, le=MAX_RING_TURN_DEG, description="rotation of the ring, degrees")
    ] = 0.0


@table()
class _Spread(Table):
    way_scale: ScaleSpread = 0.0
    turn_scale: ScaleSpread = 0.0
    drift_rad_in: ScaleSpread = 0.0
    offsets_in: Annotated[tuple[Annotated[float, Meta(ge=0.0, le=MAX_OFFSET_IN)], ...], Sixteen] = _NONE
    turned_deg: Annotated[float, Meta(ge=0.0, le=MAX_RING_TURN_DEG)] = 0.0


@table()
class LinearAxis(Table):
    """Limits of an axis that counts distance, per second."""

    top_speed: Distance | UnsetType = UNSET
    top_acceleration: Distance | UnsetType = UNSET
    speed: Distance | UnsetType = UNSET
    acceleration: Distance | UnsetType = UNSET


@table()
class AngularAxis(Table):
    """Limits of an axis that counts angles, degrees and seconds."""

    top_speed_deg: PositiveAngle | UnsetType = UNSET
    top_acceleration_deg: PositiveAngle | UnsetType = UNSET
    speed_deg: PositiveAngle | UnsetType = UNSET
    acceleration_deg: PositiveAngle | UnsetType = UNSET


@table()
class ModelTable(Table):
    """A [[model]]: what differs from the model it derives from."""

    name: Annotated[str, Meta(pattern=r"^[^\sA-Z]([^A-Z]*[^\sA-Z])?$", title="a name in small letters")]
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
    radius: Distance | UnsetType = UNSET
    sonar_ring_radius: Distance | UnsetType = UNSET
    track: Distance | UnsetType = UNSET

    def calibration(self) -> Calibration | None:
        """Return the calibration, with ideal values for missing numbers; None if the table has none."""
        if not (self.odometry or self.sonar or self.spread):
            return None
        odometry, sonar, spread = self.odometry or _Odometry(), self.sonar or _Sonar(), self.spread or _Spread()
        return Calibration(
            odometry.way_scale, odometry.turn_scale, odometry.drift_rad_in, sonar.offsets_in, radians(sonar.turned_deg),
            Spread(spread.way_scale, spread.turn_scale, spread.drift_rad_in, spread.offsets_in,
                   radians(spread.turned_deg)),
        )  # fmt: skip


@table(condition={"required": ["model"], "properties": {"model": {"minItems": 1}}})
class ModelFile(Table):
    """A model file: robot models, and calibrations of single robots."""

    model: tuple[ModelTable, ...] = ()


def read_model_file(text: str, file: str) -> tuple[ModelTable, ...]:
    """Return the tables of a model file's text; `file` is its name in errors. Raises WorldFileError."""
    with reported_as(WorldFileError, file):
        return convert(parse_toml(text, file), ModelFile).model


def load_calibration(path: Path, name: str) -> Calibration:
    """Return the calibration of the model `name` in a model file. Raises WorldFileError if there is none."""
    models = {model.name: model for model in reversed(read_model_file(read_text(path), str(path)))}
    if name not in models:
        names = ", ".join(map(repr, reversed(models))) or "none"
        raise WorldFileError(f"{path}: has no model {name!r}; it has {names}")
    return models[name].calibration() or IDEAL_CALIBRATION


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
