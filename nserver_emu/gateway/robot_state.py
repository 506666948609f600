"""The real robot's State as an Nserver sends it: what came over its line, on the terms of each connection.

    0 speed: 10, real time | 1-16 infrared: 15 where it has none | 33 bumpers: clean, at rest 0
    41 motors as the robot says | 42 laser mode of the connection | 43 compass | 44 error: 0

Rules: pure. A state packet of any mask or none makes all 45 slots; a slot that the connection's mask leaves out keeps
the value last sent there. Stamps that a robot does not make read 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from nclient.protocol.mask import BUMPER_SLOT, LASER_SLOT
from nclient.protocol.models import Model
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.state import ERROR_SLOT, STATE_SIZE
from nclient.protocol.terms import LINES
from nserver_emu.gateway.laser_shape import in_shape
from nserver_emu.server.conversation.session import Visit
from nserver_emu.server.stage.state_reply import INFRARED_NOTHING, as_sent
from nserver_emu.simulation.laser import LineFit
from worlds.bodies import BODIES

REAL_TIME: Final = 10
_SPEED_SLOT: Final = 0
_INFRAREDS: Final = range(1, 17)
_AXES: Final = 7
"""The bits of State[41] that say whether an axis moves; those above are a Scout's battery."""


@dataclass(frozen=True, slots=True)
class Link:
    """How a real robot is reached: its model, and whether that is its own line or another Nserver."""

    model: Model
    own_line: bool

    @property
    def masks(self) -> bool:
        """Whether what its packets hold can be chosen: sensors, and stamps."""
        return self.model.sends_mask or not self.own_line

    def clean(self, slots: Mapping[int, int]) -> dict[int, int]:
        """State slots without the bits that bumpers at rest show on the robot's own line."""
        clean = dict(slots)
        if BUMPER_SLOT in clean:
            clean[BUMPER_SLOT] &= ~self.model.bumper_rest
        return clean


def whole_state(reply: Reply, link: Link) -> list[int]:
    """State[0..44] of a state reply, clean."""
    slots = dict.fromkeys(range(STATE_SIZE), 0) | dict.fromkeys(_INFRAREDS, INFRARED_NOTHING)
    slots[_SPEED_SLOT] = REAL_TIME
    slots |= link.clean(reply.slots)
    slots[LASER_SLOT] = slots[ERROR_SLOT] = 0
    return list(slots.values())


def state_for(visit: Visit, reply: Reply, link: Link) -> Reply:
    """The state reply that this connection gets; it counts as sent."""
    slots, laser = whole_state(reply, link), None
    if link.model.has_laser:
        slots[LASER_SLOT] = visit.terms.laser_mode
        laser = shaped(reply.laser, visit.terms.laser_width, link) if visit.terms.mask.has(LASER_SLOT) else None
    return replace(reply, slots=dict(enumerate(as_sent(visit, slots))), laser=laser)


def laser_for(visit: Visit, reply: Reply, link: Link, *, segments: bool) -> Reply:
    """The answer to get_ls or, where `segments`, to get_sg."""
    return replace(reply, laser=shaped(reply.laser, LINES if segments else visit.terms.get_laser_width, link))


def shaped(laser: tuple[int, ...] | None, width: int, link: Link) -> tuple[int, ...] | None:
    """A laser vector with so many words a reading; None where there is none."""
    return None if laser is None else in_shape(laser, width, BODIES[link.model.name], LineFit())


def moving_axes(reply: Reply) -> int:
    """Bits 0 1 2: which axes move, as a state reply says."""
    return reply.slots.get(MOTOR_SLOT, 0) & _AXES
