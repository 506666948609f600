"""What a client holds after the replies it has had: the State vector, Laser, position stamps, clock, battery.

    0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steer turret | 38-40 velocities
    41 motors | 42 laser mode | 43 compass | 44 error        (PROTOCOL.md, section 3)

Rules: as the C client does it. A state reply over TCP fills 0..43 and clears 44; the robot's own line never
touches 0, 42, 44; an error puts its code in 44 and leaves the rest; a prediction is held nowhere.

The eleven bare bytes that a N200 sends first when it is reached over TCP: mask and laser mode in force.

    b0 b1 b2 b3 b4 | bit 0 = compass | bit 0 = laser, position-data bits x 2 | laser mode | 3 that nobody reads

Rules: no frame, no checksum; the host adopts both. As on the line, Smask[41] is not sent and reads 1.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from construct import Bytes, ConstructError, Int8ub, Padding, Struct, Terminated

from nclient.errors import WireError
from nclient.protocol import requests
from nclient.protocol.replies import LAST_TCP_SLOT, Reply
from nclient.protocol.types import COMPASS_SLOT, LASER_SLOT, Mask, Stamp, mask_from_line
from nclient.protocol.wire_state import WireState

STATE_SIZE = 45
ERROR_SLOT = 44
_UNSIGNED = 0xFFFFFFFF


def zero_extend(reply: Reply) -> Reply:
    """The reply as a 64-bit C client reads it: each word without its sign, -200 as 4294967096."""
    return replace(
        reply,
        slots={slot: value & _UNSIGNED for slot, value in reply.slots.items()},
        laser=None if reply.laser is None else tuple(value & _UNSIGNED for value in reply.laser),
        stamps={name: Stamp(*[value & _UNSIGNED for value in stamp]) for name, stamp in reply.stamps.items()},
        values=tuple(value & _UNSIGNED for value in reply.values),
    )


class ClientState:
    """The client's memory. `wide`: what a 64-bit C client holds, who sees -200 as 4294967096."""

    def __init__(self, wide: bool = False) -> None:
        self.slots: list[int | None] = [None] * STATE_SIZE
        self.laser: tuple[int, ...] | None = None
        self.stamps: dict[str, Stamp] = {}
        self.clock: int | None = None
        self.volts: tuple[int, int] | None = None
        self._wide = wide

    def apply_reply(self, reply: Reply) -> None:
        """Take in one reply, in the order they came."""
        if self._wide:
            reply = zero_extend(reply)
        if reply.kind == "error":
            self.slots[ERROR_SLOT] = reply.values[0]
        if reply.kind in ("error", "nak", "prediction"):
            return
        if len(reply.slots) == STATE_SIZE:
            self.slots[:] = map(reply.slots.__getitem__, range(STATE_SIZE))
        else:
            for slot, value in reply.slots.items():
                self.slots[slot] = value
        if LAST_TCP_SLOT in reply.slots:
            self.slots[ERROR_SLOT] = 0
        self.stamps.update(reply.stamps)
        self.laser = reply.laser if reply.laser is not None else self.laser
        self.clock = reply.clock if reply.clock is not None else self.clock
        self.volts = reply.volts or self.volts


HANDSHAKE_SIZE = 11
_LAYOUT = Struct("common" / Bytes(5), "compass" / Int8ub, "laser" / Int8ub, "mode" / Int8ub, Padding(3), Terminated)


class Handshake(NamedTuple):
    """What the robot says of itself: the mask its state packets follow, and its laser mode."""

    mask: Mask
    laser_mode: int


def read_handshake(data: bytes) -> Handshake:
    """The hello that these eleven bytes are. Raises WireError for any other number of bytes."""
    try:
        found = requests.parse(_LAYOUT, data)
    except ConstructError:
        raise WireError(f"a hello has {HANDSHAKE_SIZE} bytes, not {len(data)}") from None
    as_ct = (*found.common, found.laser & 1, found.compass & 1 | found.laser & 0x3E)
    return Handshake(mask_from_line(as_ct), found.mode)


def build_handshake(hello: Handshake) -> bytes:
    """The eleven bytes of a hello. Raises WireError when the laser mode is no byte."""
    smask = hello.mask.smask
    try:
        return requests.build(_LAYOUT, {
            "common": bytes(hello.mask.line_bytes()[:5]),
            "compass": smask[COMPASS_SLOT],
            "laser": smask[LASER_SLOT] | hello.mask.position << 1,
            "mode": hello.laser_mode,
        })
    except ConstructError as error:
        raise WireError(f"a hello cannot carry this: {error}") from None


def apply_handshake(hello: Handshake, wire_state: WireState) -> None:
    """What a hello changes for the replies that follow it."""
    wire_state.set_mask(hello.mask)
    wire_state.set_laser_mode(hello.laser_mode)
