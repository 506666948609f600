"""Rings of sonars: where each sonar is and looks, when it fires, and what it can measure.

A ring is the table [model.ring] of a model file; values that it omits are those of the ring of the model above it:

    angles_deg          direction of each sonar, counter-clockwise from the front; the sonars are numbered in this order
    mounts_in           [x, y] of each sonar from the robot's axis, x to the front, y to the left (also _cm, _m);
                        omitted: on a circle of the model's `sonar_ring_radius`, looking away from the axis
    half_cone_deg       a sonar detects up to this angle from its axis; omitted: as the setup says
    order               which sonars fire, a number or a list of numbers that fire at once each; omitted beside
                        `angles_deg`: one after the other
    interval_s          time from one entry of the order to the next
    min_range_in        nearer obstacles read this (also _cm, _m)
    max_range_in        farther ones read "no echo"
    resolution_in       step of the readings
    no_echo_in          the reading that means "no echo"; omitted beside `max_range`: that range

A sonar is described by its direction and a shift: its beam starts on a line that it would also meet from the circle of
the ring, moved forwards and to the left. A ring whose sonars all look away from the axis has no shifts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import cos, floor, radians, sin
from typing import Annotated, Any, Final, NamedTuple

from msgspec import UNSET, Meta, UnsetType

from nclient.common.validation import InvalidValue
from nclient.protocol import types
from nclient.protocol.types import MAX_SONAR_IN, MIN_SONAR_IN, SONAR_RATE_STEP_S, SONAR_SLOTS
from worlds.schema import Distance, Length, Points, Table, table

MAX_SONARS: Final = 64
"""Sonars of a ring in a model file."""
MIN_INTERVAL_S, MAX_INTERVAL_S = SONAR_RATE_STEP_S, types.MAX_SONAR_RATE * SONAR_RATE_STEP_S
"""Interval of a ring: what conf_sn can set as well."""
MAX_RANGE_IN: Final = 480.0
"""Longest range of a ring, 12 m: the simulation looks no farther for other robots."""
MAX_MOUNT_IN: Final = 100.0
MIN_RESOLUTION_IN: Final = 1e-3
_ROUNDING_IN: Final = 1e-9
"""A shift, or a distance from the maximum range, below this is rounding."""


class SonarMount(NamedTuple):
    """A sonar on a robot: it stands `ring_in` along its beam, which passes the axis `left_in` to the left.

    Attributes
    ----------
    direction_rad
        From the front of the turret, or, where it is used, from the heading.
    ring_in
        Distance along that direction: the radius of the ring for a sonar that looks away from the axis.
    left_in
        Distance of the beam to the left of the axis.
    """

    direction_rad: Any
    ring_in: float
    left_in: float = 0.0


@dataclass(frozen=True, slots=True)
class Ring:
    """A ring of n sonars.

    Attributes
    ----------
    radius_in
        Radius of the circle that the sonars stand on, before their shifts, inches.
    angles_rad
        (n,) directions from the front of the turret (Scout: of the body), counter-clockwise.
    firing
        Sonars in the order of firing; those of an entry fire at once.
    interval_s
        Time from one entry to the next.
    min_range_in, max_range_in
        A shorter range reads `min_range_in`, one of `max_range_in` or more `no_echo_in`.
    resolution_in
        Step of the readings.
    no_echo_in
        The reading without an echo; outside of the range between the limits.
    half_cone_rad
        Angle from its axis within which a sonar detects; None: as the setup says.
    shifts_in
        Position of each sonar less its place on the circle, (n, 2): along its direction, and to the left of it; empty
        where all are 0.
    """

    radius_in: float
    angles_rad: tuple[float, ...]
    firing: tuple[tuple[int, ...], ...]
    interval_s: float
    min_range_in: float
    max_range_in: float
    resolution_in: float
    no_echo_in: float
    half_cone_rad: float | None = None
    shifts_in: tuple[tuple[float, float], ...] = ()

    @property
    def count(self) -> int:
        """Number of sonars."""
        return len(self.angles_rad)

    @property
    def round_s(self) -> float:
        """Time until the same entry of the order fires again."""
        return self.interval_s * len(self.firing)

    @property
    def range_span_in(self) -> float:
        """Length of the interval in which a reading is a range."""
        return self.max_range_in - self.min_range_in

    @property
    def fits_state(self) -> bool:
        """True if State shows the readings of this ring as they are, and conf_sn can set its order and interval."""
        rate = self.interval_s / SONAR_RATE_STEP_S
        return (self.count <= SONAR_SLOTS and all(len(group) == 1 for group in self.firing)
                and abs(rate - round(rate)) < _ROUNDING_IN and self.resolution_in == 1.0
                and self.min_range_in >= MIN_SONAR_IN and self.max_range_in <= MAX_SONAR_IN == self.no_echo_in)

    @property
    def rate(self) -> int:
        """The interval in units of conf_sn."""
        return round(self.interval_s / SONAR_RATE_STEP_S)

    @property
    def mounts(self) -> tuple[SonarMount, ...]:
        """The sonars as filters see them: direction, and distances of the beam from the robot's axis."""
        return tuple(SonarMount(angle_rad, self.radius_in + self.shift_in(sonar)[0], self.shift_in(sonar)[1])
                     for sonar, angle_rad in enumerate(self.angles_rad))

    def shift_in(self, sonar: int) -> tuple[float, float]:
        """Return a sonar's shift: along its direction, and to the left of it."""
        return self.shifts_in[sonar] if self.shifts_in else (0.0, 0.0)

    def mount_in(self, sonar: int) -> tuple[float, float]:
        """Return the position of a sonar from the robot's axis: x to the front, y to the left."""
        forwards, left = self.shift_in(sonar)
        cosine, sine, along = cos(self.angles_rad[sonar]), sin(self.angles_rad[sonar]), self.radius_in + forwards
        return along * cosine - left * sine, along * sine + left * cosine

    def reading(self, range_in: float) -> float:
        """Return the reading of a range from the sonar, rounded to the resolution; infinity has no echo."""
        limits = self.min_range_in, self.max_range_in, self.resolution_in, self.no_echo_in
        return self.plain(quantized_range(range_in, *limits))

    def plain(self, reading_in: float) -> float:
        """Return a reading, as an int where the ring measures in whole inches."""
        return int(reading_in) if self.resolution_in == 1.0 and reading_in == int(reading_in) else reading_in

    def is_reading(self, reading_in: float) -> bool:
        """Return True for a number that this ring may show, 0 for a dead sonar among them."""
        return reading_in in (0.0, self.no_echo_in) or self.min_range_in <= reading_in <= self.max_range_in

    def check(self) -> None:
        """Raise InvalidValue (key "") if the values do not fit together; those of a snapshot may be any."""
        if not 0 < self.count <= MAX_SONARS:
            raise InvalidValue(f"expected 1 to {MAX_SONARS} sonars, found {self.count}")
        if not 0.0 <= self.min_range_in < self.max_range_in <= MAX_RANGE_IN:
            raise InvalidValue(f"expected a minimum below the maximum range and a maximum of at most {MAX_RANGE_IN:g} "
                               f"in, found {self.min_range_in:g} and {self.max_range_in:g} in")
        if self.min_range_in < self.no_echo_in < self.max_range_in:
            raise InvalidValue(f"expected a no_echo reading outside of the ranges, found {self.no_echo_in:g}")
        if not MIN_RESOLUTION_IN <= self.resolution_in <= self.range_span_in:
            raise InvalidValue(f"expected a resolution from {MIN_RESOLUTION_IN:g} in to the range, found "
                               f"{self.resolution_in:g} in")
        if not MIN_INTERVAL_S <= self.interval_s <= MAX_INTERVAL_S:
            raise InvalidValue(f"expected an interval of {MIN_INTERVAL_S:g} to {MAX_INTERVAL_S:g} s")
        fired = [sonar for group in self.firing for sonar in group]
        if not all(self.firing) or sorted({*fired}) != sorted(fired) or not {*fired} <= {*range(self.count)}:
            raise InvalidValue(f"expected sonars from 0 to {self.count - 1} in the order, each once, found {fired}")
        if not fired:
            raise InvalidValue("expected an order of one sonar at least, found none")
        if self.shifts_in and len(self.shifts_in) != self.count:
            raise InvalidValue(f"expected {self.count} mounts, as many as angles, found {len(self.shifts_in)}")
        if not (abs(self.radius_in) <= MAX_MOUNT_IN * 10 and all(
            abs(number) <= 2.0 * MAX_MOUNT_IN for shift in self.shifts_in for number in shift
        )):
            raise InvalidValue(f"expected mounts within {MAX_MOUNT_IN:g} in of the axis")


def quantized_range(range_in: float, min_range_in: float, max_range_in: float, resolution_in: float,
                    no_echo_in: float) -> float:
    """Return the reading of a range; limits and resolution are those of a `Ring`."""
    if range_in >= max_range_in:
        return no_echo_in
    rounded = resolution_in * floor(max(range_in, min_range_in) / resolution_in + 0.5)
    return no_echo_in if rounded >= max_range_in - _ROUNDING_IN else max(rounded, min_range_in)


def evenly(count: int) -> tuple[float, ...]:
    """Return `count` evenly spaced angles in radians, the first at 0, counter-clockwise."""
    return tuple(radians(360.0 * number / count) for number in range(count))


def nomad_ring(radius_in: float) -> Ring:
    """Return the ring of the Nomads: 16 sonars, one every 60 ms, whole inches from 6 to 255."""
    order = tuple((sonar,) for sonar in types.DEFAULT_SONAR_ORDER)
    return Ring(radius_in, evenly(SONAR_SLOTS), order, types.DEFAULT_SONAR_RATE * SONAR_RATE_STEP_S,
                float(MIN_SONAR_IN), float(MAX_SONAR_IN), 1.0, float(MAX_SONAR_IN))


SonarNumber = Annotated[int, Meta(ge=0, lt=MAX_SONARS)]
_Angles = Annotated[
    tuple[Annotated[float, Meta(ge=-360.0, le=360.0)], ...],
    Meta(min_length=1, max_length=MAX_SONARS, title="a list of angles", description="direction of each sonar, degrees"),
]
_Order = Annotated[
    tuple[SonarNumber | tuple[SonarNumber, ...], ...],
    Meta(min_length=1, max_length=MAX_SONARS, title="a list of sonar numbers, or of lists that fire at once",
         description="firing order"),
]


@table()
class RingTable(Table):
    """A [model.ring]: the sonars of a model."""

    angles_deg: _Angles | UnsetType = UNSET
    half_cone_deg: Annotated[float, Meta(gt=0.0, le=90.0, description="detects up to this angle")] | UnsetType = UNSET
    order: _Order | UnsetType = UNSET
    interval_s: Annotated[
        float, Meta(ge=MIN_INTERVAL_S, le=MAX_INTERVAL_S, description="time from one entry of the order to the next")
    ] | UnsetType = UNSET
    mounts: Points | UnsetType = UNSET
    min_range: Length | UnsetType = UNSET
    max_range: Distance | UnsetType = UNSET
    resolution: Distance | UnsetType = UNSET
    no_echo: Length | UnsetType = UNSET

    def ring(self, base: Ring, place: str) -> Ring:
        """Return the ring that this table makes of another one; `place` is the table's name in errors."""
        # 1. Directions, and mounts if the sonars are not on a circle.
        found = replace(base)
        if self.angles_deg is not UNSET:
            angles = tuple(radians(angle) for angle in self.angles_deg)
            found = replace(found, angles_rad=angles, shifts_in=(), firing=tuple((k,) for k in range(len(angles))))
        if self.mounts is not UNSET:
            if len(self.mounts) != found.count:
                complaint = f"expected {found.count} points, one for each angle, found {len(self.mounts)}"
                raise InvalidValue(complaint, f"{place}.{self.key_of('mounts')}")
            found = _mounted(found, self.mounts)
        # 2. Firing.
        if self.order is not UNSET:
            found = replace(found, firing=tuple((each,) if isinstance(each, int) else each for each in self.order))
        # 3. What a reading may be. A new maximum is also the reading without an echo.
        maximum = _or(self.max_range, found.max_range_in)
        found = replace(
            found,
            interval_s=_or(self.interval_s, found.interval_s),
            min_range_in=_or(self.min_range, found.min_range_in),
            max_range_in=maximum,
            no_echo_in=_or(self.no_echo, found.no_echo_in if self.max_range is UNSET else maximum),
            resolution_in=_or(self.resolution, found.resolution_in),
            half_cone_rad=found.half_cone_rad if self.half_cone_deg is UNSET else radians(self.half_cone_deg),
        )
        try:
            found.check()
        except InvalidValue as error:
            raise InvalidValue(error.complaint, place) from None
        return found


def _mounted(ring: Ring, mounts_in: tuple[tuple[float, float], ...]) -> Ring:
    """Return the ring with its sonars at these points (n, 2), x to the front and y to the left of the axis."""
    # 1. Each mount along and across its direction.
    parts = []
    for (x, y), angle in zip(mounts_in, ring.angles_rad, strict=True):
        cosine, sine = cos(angle), sin(angle)
        parts.append((x * cosine + y * sine, y * cosine - x * sine))
    # 2. The circle: beams start on it, so it must not lie in front of any sonar.
    radius_in = max(min(along for along, _ in parts), 0.0)
    shifts = tuple((along - radius_in, across) for along, across in parts)
    on_circle = all(abs(number) <= _ROUNDING_IN for shift in shifts for number in shift)
    return replace(ring, radius_in=radius_in, shifts_in=() if on_circle else shifts)


def _or(value: Any, default: float) -> float:
    return default if value is UNSET else float(value)
