"""What the two ends of one connection have agreed, and without which no reply can be read: mask and laser shape.

    laser words a reading in a TCP state reply: 4 in line modes 1 and 33, 2 in point modes 51 50 19, else 1;
    after get_sg 4, after get_ls in a line mode 2, until the next conf_ls (the C client's habit; both ends follow it)

Rules: both ends call `note` for every request, in order; nobody else changes it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from nclient.protocol.types import EVERYTHING, NO_MASK_MODELS, Mask, Model

DEFAULT_LASER_MODE = 51
POINT_MODES = frozenset({51, 50, 19})
TCP_LINE_MODES = frozenset({1, 33})
POINTS, LINES, PIXELS = 2, 4, 1


def tcp_laser_width(mode: int) -> int:
    """Words a laser reading in a TCP reply of this mode."""
    if mode in TCP_LINE_MODES:
        return LINES
    return POINTS if mode in POINT_MODES else PIXELS


def line_laser_width(mode: int) -> int:
    """Numbers a laser reading in a state packet on the robot's own line: four in line modes, else one pixel."""
    return LINES if mode & 0x1E == 0 else PIXELS


@dataclass(slots=True)
class WireState:
    """The state of a conversation that shapes its replies.

    `wide`: a 64-bit client over TCP, eight bytes a word. `line`: it is the robot's own line, with shapes of its own.
    """

    model: Model
    mask: Mask
    laser_mode: int = DEFAULT_LASER_MODE
    laser_width: int = POINTS
    wide: bool = False
    line: bool = False

    def copy(self) -> WireState:
        """These terms as they are now."""
        return replace(self)

    def set_mask(self, mask: Mask) -> None:
        """A ct request went over the wire."""
        self.mask = mask

    def set_laser_mode(self, mode: int) -> None:
        """A conf_ls request went over the wire: it sets mode and shape anew."""
        self.laser_mode = mode
        self.laser_width = line_laser_width(mode) if self.line else tcp_laser_width(mode)

    @property
    def get_laser_width(self) -> int:
        """Numbers a reading in the answer to get_ls. Over TCP the mode's, but points in a line mode; else pixels."""
        if self.line:
            return PIXELS
        width = tcp_laser_width(self.laser_mode)
        return POINTS if width == LINES else width


def tcp_wire_state(model: Model) -> WireState:
    """The terms of a fresh TCP connection: everything on until a ct says otherwise."""
    return WireState(model, EVERYTHING)


def serial_wire_state(model: Model) -> WireState:
    """The terms of a fresh line to a robot: N150's and Scout's never change."""
    return WireState(model, EVERYTHING if model.sends_mask else NO_MASK_MODELS, laser_width=PIXELS, line=True)
