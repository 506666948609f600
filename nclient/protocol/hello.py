"""The eleven bare bytes that a N200 sends first when it is reached over TCP: mask and laser mode in force.

    b0 b1 b2 b3 b4 | bit 0 = compass | bit 0 = laser, position-data bits x 2 | laser mode | 3 that nobody reads

Rules: no frame, no checksum; the host adopts both. As on the line, Smask[41] is not sent and reads 1.
"""

from __future__ import annotations

from typing import NamedTuple

from construct import Bytes, ConstructError, Int8ub, Padding, Struct, Terminated

from nclient.errors import WireError
from nclient.protocol import layouts
from nclient.protocol.mask import COMPASS_SLOT, LASER_SLOT, Mask, mask_from_line
from nclient.protocol.terms import Terms

HELLO_SIZE = 11
_LAYOUT = Struct("common" / Bytes(5), "compass" / Int8ub, "laser" / Int8ub, "mode" / Int8ub, Padding(3), Terminated)


class Hello(NamedTuple):
    """What the robot says of itself: the mask its state packets follow, and its laser mode."""

    mask: Mask
    laser_mode: int


def read_hello(data: bytes) -> Hello:
    """The hello that these eleven bytes are. Raises WireError for any other number of bytes."""
    try:
        found = layouts.parse(_LAYOUT, data)
    except ConstructError:
        raise WireError(f"a hello has {HELLO_SIZE} bytes, not {len(data)}") from None
    as_ct = (*found.common, found.laser & 1, found.compass & 1 | found.laser & 0x3E)
    return Hello(mask_from_line(as_ct), found.mode)


def build_hello(hello: Hello) -> bytes:
    """The eleven bytes of a hello. Raises WireError when the laser mode is no byte."""
    smask = hello.mask.smask
    try:
        return layouts.build(_LAYOUT, {
            "common": bytes(hello.mask.line_bytes()[:5]),
            "compass": smask[COMPASS_SLOT],
            "laser": smask[LASER_SLOT] | hello.mask.position << 1,
            "mode": hello.laser_mode,
        })
    except ConstructError as error:
        raise WireError(f"a hello cannot carry this: {error}") from None


def adopt(hello: Hello, terms: Terms) -> None:
    """What a hello changes for the replies that follow it."""
    terms.note_mask(hello.mask)
    terms.note_laser_mode(hello.laser_mode)
