"""Models, masks, units and position stamps as both protocols use them.

The mask selects the sensors and numbers in a state reply, and the sensors whose position stamps it carries:

    Smask[0]      position-data bits: 1 infrared, 2 sonar, 4 bumper, 8 laser, 16 compass
    Smask[1..43]  0 or 1 for the State slot of that number ([41] is sent over TCP only and has no effect)

    byte   b0    b1     b2      b3      b4      b5                                b6
    TCP    1..8  9..16  17..24  25..32  33..40  any position | [41] [42] [43]     Smask[0]
    line   1..8  9..16  17..24  25..32  33..40  laser                             compass + 2 x Smask[0]

N150 and Scout have a fixed mask: sonars, bumpers, pose, velocities and compass.

A position stamp is the encoder pose at the time of a sensor's reading, nine numbers in wire units:

    x y steering turret | v_trans v_steer v_turret | pose time ms | sensor time ms

Stamps in a reply come in this order: 16 infrared, 16 sonar, bumper, laser, compass.
Wire units are tenths of an inch and of a degree; conversions round to the nearest, ties away from zero.

State shared by both ends of a connection that determines the layout of replies: mask, laser mode, word size.

    laser words per reading in a TCP state reply: 4 in line modes 1 and 33, 2 in point modes 51, 50 and 19, else 1;
    4 after get_sg, 2 after get_ls in a line mode, until the next conf_ls (as the C client reads them)

Both ends call `codec.update_from_request` for every request, in order; nothing else changes this state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import IntFlag
from typing import NamedTuple

from nclient.errors import AddressError, WireError, suggest


@dataclass(frozen=True, slots=True)
class Model:
    """A robot model as far as the protocols depend on it; dimensions are in `worlds.robots`."""

    name: str
    number: int
    """Number in the C libraries."""
    sends_mask: bool
    """True if the serial line has a mask (ct), position data, infrared, get_cp and laser."""
    bumpers_low_first: bool
    """Byte order of the bumper bits: Scout b0 + 256 b1 + 65536 b2, the others b2 + 256 b1 + 65536 b0."""
    bumper_rest: int
    """State[33] over the serial line when no bumper is pressed."""
    has_infrared: bool
    has_laser: bool
    has_turret: bool
    top_speed_in_s: int = 20
    """Top speed of the user's manual, of a Scout of each wheel."""
    top_turn_deg_s: int = 45
    """Top rate of steering and turret."""


N200 = Model("n200", 0, True, False, 0xF00000, has_infrared=True, has_laser=True, has_turret=True)
N150 = Model("n150", 1, False, False, 0xF00000, has_infrared=False, has_laser=False, has_turret=True)
SCOUT = Model("scout", 2, False, True, 0, has_infrared=False, has_laser=False, has_turret=False, top_speed_in_s=39)

MODELS = {model.name: model for model in (N150, N200, SCOUT)}
"""Models by lower-case name."""


def get_model(name: str) -> Model:
    """Return the model of a name in any case. Raises AddressError, listing the models, if there is none."""
    try:
        return MODELS[name.lower()]
    except KeyError:
        hint = suggest(name.lower(), MODELS)
        raise AddressError(f"no robot model {name!r}; there are {', '.join(MODELS)}{hint}") from None


SONAR_SLOTS = 16
"""Sonars that State has slots for."""
MIN_SONAR_IN, MAX_SONAR_IN = 6, 255
"""Sonar readings of a Nomad: "no farther than 6 in", and "no echo up to 255 in"."""
SONAR_RING_IN = {"n150": 9.06, "n200": 9.06, "scout": 8.0}
"""Distance of the sonars from the robot's axis, inches; that of the Scout is an assumption: no source states it."""
DEFAULT_SONAR_ORDER = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)
"""Firing order of the sonar ring before any conf_sn (docs/protocol.md, State vector)."""
DEFAULT_SONAR_RATE = 15
"""Firing rate before any conf_sn: 60 ms between two sonars."""
SONAR_RATE_STEP_S = 0.004
"""Unit of conf_sn's rate in seconds."""
MAX_SONAR_RATE = 255
"""Largest rate that a byte of conf_sn on a serial line holds."""


SLOTS = 44
"""Length of Smask."""
LASER_SLOT = 42
COMPASS_SLOT = 43
BUMPER_SLOT = 33


class Position(IntFlag):
    """Position-data bits of Smask[0]: the sensors whose stamps a reply carries."""

    INFRARED = 1
    SONAR = 2
    BUMPER = 4
    LASER = 8
    COMPASS = 16


@dataclass(frozen=True, slots=True)
class Mask:
    """Immutable Smask: 44 numbers, [0] the position-data bits 0..31, the others 0 or 1.

    Raises
    ------
    WireError
        If the numbers are not valid.
    """

    smask: tuple[int, ...]
    whole: bool = field(init=False, compare=False, repr=False)
    """True if every sensor and number is selected."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "whole", all(self.smask[1:41]) and all(self.smask[LASER_SLOT:]))
        if len(self.smask) != SLOTS:
            raise WireError(f"a mask has {SLOTS} numbers, Smask[0] to Smask[{SLOTS - 1}]; got {len(self.smask)}")
        if not 0 <= self.smask[0] <= 31 or any(bit not in (0, 1) for bit in self.smask[1:]):
            raise WireError("a mask is position-data bits 0..31 followed by zeros and ones")

    @property
    def position(self) -> int:
        """Return the position-data bits."""
        return self.smask[0]

    def has(self, slot: int) -> bool:
        """Return True if the mask selects State[slot] (slot 1..43)."""
        return bool(self.smask[slot])

    def with_position(self, bits: int) -> Mask:
        """Return the same mask with other position-data bits."""
        return Mask((bits, *self.smask[1:]))

    def tcp_bytes(self) -> tuple[int, ...]:
        """Return the seven bytes of a ct request over TCP."""
        last = bool(self.position) | self.smask[41] << 1 | self.smask[42] << 2 | self.smask[43] << 3
        return (*self._common_bytes(), last, self.position)

    def line_bytes(self) -> tuple[int, ...]:
        """Return the seven bytes of a ct request on the serial line."""
        return (*self._common_bytes(), self.smask[LASER_SLOT], self.smask[COMPASS_SLOT] | self.position << 1)

    def _common_bytes(self) -> list[int]:
        # b0 to b4: Smask[1..40], lowest bit first.
        bits = self.smask
        return [sum(bits[1 + 8 * byte + k] << k for k in range(8)) for byte in range(5)]


def mask_from_tcp(data: Sequence[int]) -> Mask:
    """Return the mask of a ct request over TCP (seven bytes, one per word; only the low eight bits count)."""
    tail = [data[5] >> 1 & 1, data[5] >> 2 & 1, data[5] >> 3 & 1]
    return Mask((data[6] & 31, *_bits(data[:5]), *tail))


def mask_from_line(data: Sequence[int]) -> Mask:
    """Return the mask of a ct request on the serial line, which does not carry Smask[41]: it is set to 1."""
    return Mask((data[6] >> 1 & 31, *_bits(data[:5]), 1, data[5] & 1, data[6] & 1))


def _bits(data: Sequence[int]) -> list[int]:
    return [byte >> k & 1 for byte in data for k in range(8)]


EVERYTHING = Mask((0,) + (1,) * (SLOTS - 1))
"""Mask that clients send right after connecting: all sensors, no position data."""
NO_MASK_MODELS = Mask((0,) + (0,) * 16 + (1,) * 24 + (0, 0, 1))
"""Fixed mask of N150 and Scout: everything except infrared and laser."""


M_PER_IN = 0.0254
"""Metres per inch, exact."""

FULL_TURN_TENTHS = 3600
SCOUT_WHEEL_IN_PER_DEG = 0.118597
"""Travel of a Scout's wheel per degree of turn: half its track of 13.590 in, times pi / 180."""
WORD_LIMIT = 2**31
# Full range of the two battery measurements in volts (docs/protocol.md, State vector).
CPU_RANGE_V = 12.0
MOTOR_RANGE_V = 12.85


def tenths(value: float) -> int:
    """Convert inches or degrees to tenths, rounded to the nearest, ties away from zero."""
    return math.floor(value * 10 + 0.5) if value >= 0 else -math.floor(-value * 10 + 0.5)


def tenths_from_rad(angle_rad: float) -> int:
    """Convert radians (or rad/s) to tenths of a degree, signed."""
    return tenths(math.degrees(angle_rad))


def heading_tenths(angle_rad: float) -> int:
    """Convert a direction in radians to 0..3599 tenths of a degree, as in State[36] and State[37]."""
    return tenths_from_rad(angle_rad) % FULL_TURN_TENTHS


def clamp_word(value: int) -> int:
    """Clamp to the range of a signed 32-bit word."""
    return value if -WORD_LIMIT <= value < WORD_LIMIT else max(-WORD_LIMIT, min(WORD_LIMIT - 1, value))


def wrap_word(value: int) -> int:
    """Wrap an unbounded count to a signed 32-bit word, modulo 2^32."""
    return (value + WORD_LIMIT) % (2 * WORD_LIMIT) - WORD_LIMIT


def unwrap_word(word: int) -> int:
    """Convert a signed 32-bit word to the unsigned number of the same bits, 0 to 2^32 - 1."""
    return word % (2 * WORD_LIMIT)


def rad_from_tenths(angle_tenths: float) -> float:
    """Convert tenths of a degree to radians."""
    return math.radians(angle_tenths / 10)


def volts(raw: int, full_range_v: float) -> float:
    """Convert a raw battery byte r to volts: (2 + 3 r / 255) x range / 5 (docs/protocol.md, State vector)."""
    return (2 + 3 * raw / 255) * full_range_v / 5


def raw_volts(voltage_v: float, full_range_v: float) -> int:
    """Convert volts to the nearest raw battery byte 0..255; the inverse of `volts`, clamped."""
    return min(255, max(0, round((voltage_v * 5 / full_range_v - 2) * 255 / 3)))


class Stamp(NamedTuple):
    """Position stamp in wire units: tenths of inches and degrees, per second for velocities; milliseconds."""

    x: int
    y: int
    steer: int
    turret: int
    v_trans: int
    v_steer: int
    v_turret: int
    pose_time: int
    sensor_time: int


NO_STAMP = Stamp(0, 0, 0, 0, 0, 0, 0, 0, 0)
"""Stamp of a sensor without a reading yet."""

INFRARED_KEYS = tuple(f"ir_{i}" for i in range(16))
SONAR_KEYS = tuple(f"sonar_{i}" for i in range(SONAR_SLOTS))

STAMP_KEYS: dict[Position, tuple[str, ...]] = {
    Position.INFRARED: INFRARED_KEYS,
    Position.SONAR: SONAR_KEYS,
    Position.BUMPER: ("bumper",),
    Position.LASER: ("laser",),
    Position.COMPASS: ("compass",),
}
"""Names of the stamps for each position-data bit, in the order of the wire."""


DEFAULT_LASER_MODE = 51
POINT_MODES = frozenset({51, 50, 19})
TCP_LINE_MODES = frozenset({1, 33})
# Numbers per laser reading: a point is x y, a line segment x1 y1 x2 y2, a pixel one number.
POINTS, LINES, PIXELS = 2, 4, 1


def tcp_laser_width(mode: int) -> int:
    """Return the words per laser reading in a TCP state reply of this laser mode."""
    if mode in TCP_LINE_MODES:
        return LINES
    return POINTS if mode in POINT_MODES else PIXELS


def line_laser_width(mode: int) -> int:
    """Return the numbers per laser reading in a state packet on the serial line: 4 in line modes, else 1."""
    # docs/protocol.md, State vector, Laser: line mode is (mode & 0x1e) == 0.
    return LINES if mode & 0x1E == 0 else PIXELS


@dataclass(slots=True)
class WireState:
    """Mutable state of one connection that determines how its replies are read and written."""

    model: Model
    mask: Mask
    laser_mode: int = DEFAULT_LASER_MODE
    laser_width: int = POINTS
    """Numbers per laser reading in a state reply."""
    wide: bool = False
    """True for a 64-bit client over TCP: each word takes eight bytes."""
    line: bool = False
    """True on the robot's own serial line, False over TCP."""

    def copy(self) -> WireState:
        """Return an independent copy."""
        return replace(self)

    def set_mask(self, mask: Mask) -> None:
        """Apply a ct request."""
        self.mask = mask

    def set_laser_mode(self, mode: int) -> None:
        """Apply a conf_ls request: set the mode and reset the laser width to the mode's."""
        self.laser_mode = mode
        self.laser_width = line_laser_width(mode) if self.line else tcp_laser_width(mode)

    @property
    def get_laser_width(self) -> int:
        """Return the numbers per reading in the reply to get_ls: over TCP points in a line mode, else the mode's."""
        if self.line:
            return PIXELS
        width = tcp_laser_width(self.laser_mode)
        return POINTS if width == LINES else width


def tcp_wire_state(model: Model) -> WireState:
    """Return the state of a new TCP connection: all sensors enabled until a ct request."""
    return WireState(model, EVERYTHING)


def serial_wire_state(model: Model) -> WireState:
    """Return the state of a new serial connection; the mask of N150 and Scout is fixed."""
    return WireState(model, EVERYTHING if model.sends_mask else NO_MASK_MODELS, laser_width=PIXELS, line=True)
