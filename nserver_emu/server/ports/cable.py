"""What lies between a port and the session behind it, without I/O: bytes go in at once and come out when it is time.

    to_robot(bytes, now), to_host(bytes, now) ──> arrived(now): what has come through to either side, in order
    PacedCable    a serial cable at a baud rate: 8N1, ten bits a byte, each way by itself

Rules: the clock is handed in. What a late look at the clock took from the host is given back to it: a request that
follows at once counts from the moment the answer was due, so that the rate holds however coarse alarms are.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final, NamedTuple, Protocol

BITS_A_BYTE: Final = 10
PIECE: Final = 64
"""Bytes that come out of a wire together; a longer answer comes piece by piece."""
MOST_ON_A_WIRE: Final = 16_384
"""Bytes on their way; a cable that holds more takes no more in, and loses what is put in all the same."""
MOST_GIVEN_BACK_S: Final = 0.02
"""Of a longer lateness the rest is lost to the host."""


class Arrival(NamedTuple):
    """Bytes that came through, when they did, and to which end; and whether the connection ends with them."""

    at_s: float
    data: bytes
    to_robot: bool
    hang_up: bool = False


class Cable(Protocol):
    """See the head of this file."""

    @property
    def due_s(self) -> float | None:
        """When something will have come through; None: nothing is on its way."""
        ...

    @property
    def full(self) -> bool:
        """Whether no more should be read from the host."""
        ...

    def to_robot(self, data: bytes, now_s: float) -> None:
        """The host sends these."""
        ...

    def to_host(self, data: bytes, now_s: float) -> None:
        """The robot sends these."""
        ...

    def arrived(self, now_s: float) -> Arrival | None:
        """What has come through next by now; None: nothing more."""
        ...


class Wire:
    """One direction of a serial cable."""

    def __init__(self, baud: int) -> None:
        self._byte_s = BITS_A_BYTE / baud
        self._free_s = -math.inf
        self._pieces: deque[tuple[float, bytes]] = deque()
        self.size = 0

    def put(self, data: bytes, now_s: float) -> None:
        """Send these behind what is on its way."""
        self._free_s = max(self._free_s, now_s)
        for start in range(0, len(data), PIECE):
            piece = data[start : start + PIECE]
            self._free_s += len(piece) * self._byte_s
            self._pieces.append((self._free_s, piece))
            self.size += len(piece)

    @property
    def due_s(self) -> float:
        """When the next piece will be through; infinity where none is on its way."""
        return self._pieces[0][0] if self._pieces else math.inf

    def take(self) -> tuple[float, bytes]:
        """The next piece, and when it is through."""
        at_s, piece = self._pieces.popleft()
        self.size -= len(piece)
        return at_s, piece


class PacedCable:
    """A serial cable at so many bits a second. `lost`: bytes to a host that asks more than the wire can carry."""

    def __init__(self, baud: int) -> None:
        self._in, self._out = Wire(baud), Wire(baud)
        self._late_s = 0.0
        self._answered_s = -math.inf
        self.lost = 0

    @property
    def due_s(self) -> float | None:
        due_s = min(self._in.due_s, self._out.due_s)
        return None if due_s == math.inf else due_s

    @property
    def full(self) -> bool:
        return self._in.size >= MOST_ON_A_WIRE

    def to_robot(self, data: bytes, now_s: float) -> None:
        at_once = now_s - self._answered_s < MOST_GIVEN_BACK_S
        self._in.put(data, now_s - self._late_s if at_once else now_s)
        self._late_s = 0.0

    def to_host(self, data: bytes, now_s: float) -> None:
        if self._out.size >= MOST_ON_A_WIRE:
            self.lost += len(data)
            return
        self._out.put(data, now_s)

    def arrived(self, now_s: float) -> Arrival | None:
        inward = self._in.due_s <= self._out.due_s
        wire = self._in if inward else self._out
        if wire.due_s > now_s:
            return None
        at_s, data = wire.take()
        if not inward:
            self._late_s, self._answered_s = min(now_s - at_s, MOST_GIVEN_BACK_S), now_s
        return Arrival(at_s, data, inward)
