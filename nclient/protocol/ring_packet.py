"""The ring packet: all sonars of a simulated robot, in thousandths of an inch, in a user packet.

State has slots for 16 sonars in whole inches. A ring of a model file may have more, or finer ones; clients that know it
send this special_request, which takes no simulated time. Robots and other servers refuse it.

    request     type 60, one byte: 0 read, 1 restart the ring with the order and interval of its model, and read
    reply       type 60, clock in ms (4 bytes), number of sonars (1 byte), 3 bytes for each reading; low bytes first
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from nclient.errors import WireError

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
