"""A backend that stops a robot whose bumper begins to touch while it moves, and says so: BumperHit.

Rules: st goes out at once, before anything is raised. Only a bumper that did not touch before counts, so that a robot
that was stopped at a wall can be driven away from it. A robot that was told to move moves until a state shows it still.
A ws, which is silent until the robot stands, is asked in pieces of a second, so that a hit is seen during it.
"""

from __future__ import annotations

import contextlib

from nclient.backends.backend import Backend
from nclient.backends.pieces import in_pieces, is_wait
from nclient.backends.wrapper import Wrapper
from nclient.errors import BumperHit, NomadError
from nclient.protocol.commands import Call
from nclient.protocol.mask import BUMPER_SLOT
from nclient.protocol.replies import MOTOR_SLOT, Reply

POLL_S = 0.2
"""How often a robot is to be asked that nobody asks, so that a hit is seen."""
_MOTIONS = frozenset({"vm", "pr", "pa", "mv", "zr"})
_ATTEMPTS = 3
_PIECE_S = 1
"""The shortest wait that ws can say."""


class BumperStop(Wrapper):
    """Watches the bumpers in every answer that has them."""

    def __init__(self, inner: Backend) -> None:
        super().__init__(inner)
        model = inner.terms.model
        self._rest = model.bumper_rest
        self._motors = 7 if model.has_turret else 3
        self._touching = self._bits(inner.greeting) if inner.greeting else 0
        self._moving = False

    def execute(self, call: Call) -> Reply:
        """The answer. Raises BumperHit, after st, where a bumper has begun to touch."""
        return in_pieces(call, _PIECE_S, self._watched) if is_wait(call) else self._watched(call)

    def _watched(self, call: Call) -> Reply:
        self._moving |= call.name in _MOTIONS
        reply = self._inner.execute(call)
        moved, touched = self._moving, self._touching
        self._touching = self._bits(reply)
        if MOTOR_SLOT in reply.slots:
            self._moving = bool(reply.slots[MOTOR_SLOT] & self._motors)
        began = self._touching & ~touched
        if began and (moved or self._moving):
            self._stop()
            raise BumperHit(call.name, tuple(number for number in range(began.bit_length()) if began >> number & 1))
        return reply

    def _bits(self, reply: Reply) -> int:
        return reply.slots[BUMPER_SLOT] & ~self._rest if BUMPER_SLOT in reply.slots else self._touching

    def _stop(self) -> None:
        """st until it is answered; where it is not, the robot's own time-out is left."""
        for _ in range(_ATTEMPTS):
            with contextlib.suppress(NomadError):
                self._inner.execute(Call("st"))
                self._moving = False
                return
