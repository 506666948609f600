"""The bodies of the three robots: what filter, physics and page must agree on. Numbers as in ROBOTS.md.

Lives here: radii, where the sonars and the bumpers sit. Lives elsewhere: what the wire says of a model
(nclient/protocol/types.py), speeds and limits (simulation). No arithmetic but degrees to radians.

    frame       x to the front, y to the left, angles counter-clockwise, inches and radians
    sonars      fixed to the turret (Scout: to the body); a beam points away from the axis, so its reading is
                the range from the axis less the radius of the ring
    bumpers     fixed to the body, which on the synchro drives never turns: not turret, not steering

What one robot gets wrong every time, as it was found out: wheels and sonars. A part of model files.

    [[model]]
    name = "n150"
    [model.odometry]    way_scale, turn_scale, drift_rad_in       true way a counted way, turn a turn; turn an inch
    [model.sonar]       offsets_in, turned_deg                    readings less ranges; the ring against the turret
    [model.spread]      all of these keys                         standard deviations: how well each is known

Physics makes a robot that errs so (model_files.py), a filter one that knows it. Rules: values, and their reading and
writing as text; inches, radians. Whatever is wrong is a WorldFileError: file, key, what was expected.
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
"""Sonars in a ring, number i at i x 22.5 degrees from the front."""


@dataclass(frozen=True, slots=True)
class Body:
    """The outside of one model: a vertical cylinder with a ring of sonars and a band of bumpers.

    name                    "n150", "n200" or "scout"
    radius_in               the cylinder that touches walls, inches
    sonar_ring_radius_in    distance of the sonars from the axis, inches (on the N200 0.06 in more than the
                            body: cast from the axis, never from the ring, and no beam starts behind a wall)
    sonar_angles_rad        16 angles against the front of the turret (Scout: of the body)
    bumper_angles_rad       20 angles (Scout: 6) against the body
    """

    name: str
    radius_in: float
    sonar_ring_radius_in: float
    sonar_angles_rad: tuple[float, ...]
    bumper_angles_rad: tuple[float, ...]


def _evenly(count: int) -> tuple[float, ...]:
    """`count` angles around the circle in radians, the first at 0, counter-clockwise."""
    return tuple(radians(360.0 * number / count) for number in range(count))


N150: Final = Body("n150", 9.72, 9.06, _evenly(SONARS), _evenly(20))
N200: Final = Body("n200", 9.0, 9.06, _evenly(SONARS), _evenly(20))
# The radii of the Scout and the places of its six bumpers are decisions of ours: no source gives them.
SCOUT: Final = Body("scout", 8.0, 8.0, _evenly(SONARS), _evenly(6))

BODIES: Final[Mapping[str, Body]] = MappingProxyType({body.name: body for body in (N150, N200, SCOUT)})
"""Every body by its name."""


TABLES: Final = ("odometry", "sonar", "spread")
"""The tables of a model that are a calibration's."""
_ODOMETRY: Final = ("way_scale", "turn_scale", "drift_rad_in")
_SONAR: Final = ("offsets_in", "turned_deg")
FARTHEST_OFFSET_IN: Final = 24.0
LARGEST_DRIFT: Final = 0.1
WIDEST_TURN_DEG: Final = 45.0
_NONE: Final = (0.0,) * SONARS


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviations of a calibration's numbers, 0 where nothing is left to find out."""

    way_scale: float = 0.0
    turn_scale: float = 0.0
    drift_rad_in: float = 0.0
    offsets_in: tuple[float, ...] = _NONE
    turned_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class Calibration:
    """See the head of this file. `offsets_in`: 16, what each sonar reads more than the range."""

    way_scale: float = 1.0
    turn_scale: float = 1.0
    drift_rad_in: float = 0.0
    offsets_in: tuple[float, ...] = _NONE
    turned_rad: float = 0.0
    spread: Spread = Spread()


IDEAL_CALIBRATION: Final = Calibration()
"""Of a robot that does what it says."""


def parse_calibration(model: Table) -> Calibration:
    """What the table of a model says of it; faultless where it says nothing."""
    spread = Spread(**dict(_spreads(model.table("spread")))) if "spread" in model.values else Spread()
    found: dict[str, Any] = {}
    if "odometry" in model.values:
        table = model.table("odometry")
        table.allow(_ODOMETRY)
        limits = ((0.5, 2.0), (0.5, 2.0), (-LARGEST_DRIFT, LARGEST_DRIFT))
        found |= {
            key: table.number(key, *limit)
            for key, limit in zip(_ODOMETRY, limits, strict=True) if key in table.values
        }  # fmt: skip
    if "sonar" in model.values:
        table = model.table("sonar")
        table.allow(_SONAR)
        if "offsets_in" in table.values:
            found["offsets_in"] = table.numbers("offsets_in", SONARS, -FARTHEST_OFFSET_IN, FARTHEST_OFFSET_IN)
        if "turned_deg" in table.values:
            found["turned_rad"] = radians(table.number("turned_deg", -WIDEST_TURN_DEG, WIDEST_TURN_DEG))
    return Calibration(**found, spread=spread)


def _spreads(table: Table) -> Iterator[tuple[str, Any]]:
    table.allow((*_ODOMETRY, *_SONAR))
    for key in _ODOMETRY:
        if key in table.values:
            yield key, table.number(key, 0.0, 1.0)
    if "offsets_in" in table.values:
        yield "offsets_in", table.numbers("offsets_in", SONARS, 0.0, FARTHEST_OFFSET_IN)
    if "turned_deg" in table.values:
        yield "turned_rad", radians(table.number("turned_deg", 0.0, WIDEST_TURN_DEG))


def load_calibration(path: Path, name: str) -> Calibration:
    """The calibration of the model `name` in a model file. Raises WorldFileError, also where there is none of it."""
    text = read_text(path)
    values = parse_toml(text, str(path))
    names = []
    for model in Table(str(path), "", values).tables("model"):
        names.append(model.text("name", ""))
        if names[-1] == name:
            return parse_calibration(model)
    raise WorldFileError(f"{path}: has no model {name!r}, but {', '.join(map(repr, names)) or 'none'}")


def format_calibration(name: str, found: Calibration, said: str = "") -> str:
    """A model file of one model; `said` stands above it as a comment, line by line."""
    spread = found.spread
    lines = [
        *(f"# {line}" for line in said.splitlines()),
        "[[model]]", f'name = "{name}"', "", "[model.odometry]", *_numbers(found),
        "", "[model.sonar]", *_offsets(found), "", "[model.spread]", *_numbers(spread), *_offsets(spread),
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def _numbers(of: Calibration | Spread) -> list[str]:
    return [f"{key} = {getattr(of, key):.6g}" for key in _ODOMETRY]


def _offsets(of: Calibration | Spread) -> list[str]:
    listed = ", ".join(f"{offset:.4g}" for offset in of.offsets_in)
    return [f"offsets_in = [{listed}]", f"turned_deg = {degrees(of.turned_rad):.5g}"]
