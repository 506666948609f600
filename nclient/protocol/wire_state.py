"""State shared by both ends of a connection that determines the layout of replies: mask, laser mode, word size.

    laser words per reading in a TCP state reply: 4 in line modes 1 and 33, 2 in point modes 51, 50 and 19, else 1;
    4 after get_sg, 2 after get_ls in a line mode, until the next conf_ls (as the C client reads them)

Both ends call `codec.update_from_request` for every request, in order; nothing else changes this state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from nclient.protocol.types import EVERYTHING, NO_MASK_MODELS, Mask, Model

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
