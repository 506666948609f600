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

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import degrees, radians
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from nclient.errors import WorldFileError
from worlds.schema import Table, parse_toml, read_text

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


TABLES: Final = ("odometry", "sonar", "spread")
"""Tables of a [[model]] that belong to a calibration."""
_ODOMETRY: Final = MappingProxyType(
    {"way_scale": "distance_scale", "turn_scale": "turn_scale", "drift_rad_in": "drift_rad_in"}
)
"""Keys of [model.odometry] and the attributes they set."""
_SONAR: Final = ("offsets_in", "turned_deg")
MAX_OFFSET_IN: Final = 24.0
MAX_DRIFT_RAD_IN: Final = 0.1
MAX_RING_TURN_DEG: Final = 45.0
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


def parse_calibration(model: Table) -> Calibration:
    """Return the calibration in the table of a model; missing numbers are ideal."""
    spread = Spread(**dict(_spreads(model.table("spread")))) if "spread" in model.values else Spread()
    # Wheels.
    found: dict[str, Any] = {}
    if "odometry" in model.values:
        table = model.table("odometry")
        table.allow(_ODOMETRY)
        limits = ((0.5, 2.0), (0.5, 2.0), (-MAX_DRIFT_RAD_IN, MAX_DRIFT_RAD_IN))
        found |= {
            _ODOMETRY[key]: table.number(key, *limit)
            for key, limit in zip(_ODOMETRY, limits, strict=True) if key in table.values
        }  # fmt: skip
    # Sonar ring.
    if "sonar" in model.values:
        table = model.table("sonar")
        table.allow(_SONAR)
        if "offsets_in" in table.values:
            found["offsets_in"] = table.numbers("offsets_in", SONARS, -MAX_OFFSET_IN, MAX_OFFSET_IN)
        if "turned_deg" in table.values:
            found["turned_rad"] = radians(table.number("turned_deg", -MAX_RING_TURN_DEG, MAX_RING_TURN_DEG))
    return Calibration(**found, spread=spread)


def _spreads(table: Table) -> Iterator[tuple[str, Any]]:
    table.allow((*_ODOMETRY, *_SONAR))
    for key in _ODOMETRY:
        if key in table.values:
            yield _ODOMETRY[key], table.number(key, 0.0, 1.0)
    if "offsets_in" in table.values:
        yield "offsets_in", table.numbers("offsets_in", SONARS, 0.0, MAX_OFFSET_IN)
    if "turned_deg" in table.values:
        yield "turned_rad", radians(table.number("turned_deg", 0.0, MAX_RING_TURN_DEG))


def load_calibration(path: Path, name: str) -> Calibration:
    """Return the calibration of the model `name` in a model file. Raises WorldFileError if there is none."""
    text = read_text(path)
    values = parse_toml(text, str(path))
    names = []
    for model in Table(str(path), "", values).tables("model"):
        names.append(model.text("name", ""))
        if names[-1] == name:
            return parse_calibration(model)
    raise WorldFileError(f"{path}: has no model {name!r}; it has {', '.join(map(repr, names)) or 'none'}")


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
