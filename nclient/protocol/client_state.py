"""Sensor data and pose as the client stores them: the State vector, laser, position stamps, clock, battery.

    0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steering turret | 38-40 velocities
    41 motors | 42 laser mode | 43 compass | 44 error        (docs/protocol.md, State vector)

Replies are stored as the C client does: a state reply over TCP fills 0..43 and clears 44; the serial line never
writes 0, 42 and 44; an error reply writes its code to 44 and nothing else; a prediction is not stored.

Also here: the handshake, eleven bytes without a frame that a N200 sends first when it is reached over TCP.

    b0 b1 b2 b3 b4 | bit 0 = compass | bit 0 = laser, position-data bits x 2 | laser mode | 3 unused

It reports the mask and laser mode in force. As on the serial line, Smask[41] is not sent and reads 1.

The ring packet: all sonars of a simulated robot, in thousandths of an inch, in a user packet.

State has slots for 16 sonars in whole inches. A ring of a model file may have more, or finer ones; clients that know it
send this special_request, which takes no simulated time. Robots and other servers refuse it.

    request     type 60, one byte: 0 read, 1 restart the ring with the order and interval of its model, and read
    reply       type 60, clock in ms (4 bytes), number of sonars (1 byte), 3 bytes for each reading; low bytes first
"""

from __future__ import annotations

from collections.abc import Sequence
from operator import itemgetter
from typing import NamedTuple

from construct import Bytes, ConstructError, Int8ub, Padding, Struct, Terminated

from nclient.errors import HELD, WireError
from nclient.protocol import layouts
from nclient.protocol.replies import LAST_TCP_SLOT, Reply
from nclient.protocol.types import COMPASS_SLOT, LASER_SLOT, Mask, Stamp, WireState, mask_from_line

RING_PACKET = 60
READ, RESTART = 0, 1
_HEAD, _CLOCK, _READING, _PER_IN = 5, 4, 3, 1000


class RingReadings(NamedTuple):
    """The clock of the robot, and the last reading of each sonar in inches, as its model file describes them."""

    clock_s: float
    readings_in: tuple[float, ...]


def pack_ring(clock_ms: int, readings_in: Sequence[float]) -> bytes:
    """Return the data of a reply."""
    words = [round(reading * _PER_IN).to_bytes(_READING, "little") for reading in readings_in]
    return clock_ms.to_bytes(_CLOCK, "little") + bytes((len(words),)) + b"".join(words)


def parse_ring(data: bytes) -> RingReadings:
    """Return the readings of a reply's data. Raises WireError if it is none."""
    if len(data) < _HEAD or len(data) != _HEAD + data[_HEAD - 1] * _READING:
        raise WireError(f"a ring packet of {len(data)} bytes, which do not match its number of sonars")
    numbers = [int.from_bytes(data[at : at + _READING], "little") for at in range(_HEAD, len(data), _READING)]
    clock_ms = int.from_bytes(data[:_CLOCK], "little")
    return RingReadings(clock_ms / 1000, tuple([number / _PER_IN for number in numbers]))


STATE_SIZE = 45
ERROR_SLOT = 44
_whole_state = itemgetter(*range(STATE_SIZE))
_UNSIGNED = 0xFFFFFFFF


def zero_extend(reply: Reply) -> Reply:
    """Return the reply as a 64-bit C client reads it: words without sign, so that -200 becomes 4294967096."""
    return reply._replace(
        slots={slot: value & _UNSIGNED for slot, value in reply.slots.items()},
        laser=None if reply.laser is None else tuple(value & _UNSIGNED for value in reply.laser),
        stamps={name: Stamp(*[value & _UNSIGNED for value in stamp]) for name, stamp in reply.stamps.items()},
        values=tuple(value & _UNSIGNED for value in reply.values),
    )


class ClientState:
    """The values that a client stores from replies, None where no reply has set one.

    Parameters
    ----------
    wide
        True to store values as a 64-bit C client does (`zero_extend`).
    """

    def __init__(self, wide: bool = False) -> None:
        self.slots: list[int | None] = [None] * STATE_SIZE
        self.laser: tuple[int, ...] | None = None
        self.stamps: dict[str, Stamp] = {}
        self.clock: int | None = None
        self.volts: tuple[int, int] | None = None
        self.is_held = False
        self._wide = wide

    def apply_reply(self, reply: Reply) -> None:
        """Store the values of one reply; call it for every reply, in order."""
        if self._wide:
            reply = zero_extend(reply)
        # 1. Errors set State[44] only; NAK and prediction change nothing.
        if reply.kind == "error":
            self.slots[ERROR_SLOT] = reply.values[0]
        if reply.kind in ("error", "nak", "prediction"):
            return
        # 2. State slots that the reply carries. A whole state reply, the usual one, is copied in one go.
        if len(reply.slots) == STATE_SIZE:
            self.slots[:] = _whole_state(reply.slots)
        else:
            for slot, value in reply.slots.items():
                self.slots[slot] = value
        # 3. C clients store 0 in State[44] after a TCP state reply, whatever its word 44 holds: that is HELD while a
        #    person holds the robot.
        if LAST_TCP_SLOT in reply.slots:
            self.is_held = reply.slots.get(ERROR_SLOT) == HELD
            self.slots[ERROR_SLOT] = 0
        # 4. Everything else is overwritten only where the reply has it.
        self.stamps.update(reply.stamps)
        self.laser = reply.laser if reply.laser is not None else self.laser
        self.clock = reply.clock if reply.clock is not None else self.clock
        self.volts = reply.volts or self.volts


HANDSHAKE_SIZE = 11
_LAYOUT = Struct("common" / Bytes(5), "compass" / Int8ub, "laser" / Int8ub, "mode" / Int8ub, Padding(3), Terminated)


class Handshake(NamedTuple):
    """Mask and laser mode that a N200 reports first over TCP."""

    mask: Mask
    laser_mode: int


def read_handshake(data: bytes) -> Handshake:
    """Parse the eleven bytes of a handshake.

    Raises
    ------
    WireError
        For any other number of bytes.
    """
    try:
        fields = layouts.parse(_LAYOUT, data)
    except ConstructError:
        raise WireError(f"a hello has {HANDSHAKE_SIZE} bytes, not {len(data)}") from None
    # Bytes 5 and 6 of a serial ct request: laser, then compass and position-data bits.
    as_ct = (*fields.common, fields.laser & 1, fields.compass & 1 | fields.laser & 0x3E)
    return Handshake(mask_from_line(as_ct), fields.mode)


def build_handshake(handshake: Handshake) -> bytes:
    """Return the eleven bytes of a handshake.

    Raises
    ------
    WireError
        If the laser mode does not fit in a byte.
    """
    smask = handshake.mask.smask
    try:
        return layouts.build(_LAYOUT, {
            "common": bytes(handshake.mask.line_bytes()[:5]),
            "compass": smask[COMPASS_SLOT],
            "laser": smask[LASER_SLOT] | handshake.mask.position << 1,
            "mode": handshake.laser_mode,
        })
    except ConstructError as error:
        raise WireError(f"a hello cannot carry this: {error}") from None


def apply_handshake(handshake: Handshake, wire_state: WireState) -> None:
    """Set mask and laser mode of the connection to those of the handshake."""
    wire_state.set_mask(handshake.mask)
    wire_state.set_laser_mode(handshake.laser_mode)
