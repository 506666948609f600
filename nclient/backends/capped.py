"""A backend that lets nothing through that is faster than allowed: vm, mv, sp, and the speed that pr and pa go at.

    axis      translation | steering, turret            a Scout: right wheel | left wheel, which share both limits

Rules: numbers are brought down to the limit, never refused, and their signs stay. A Scout's wheels are slowed together,
so that the curve stays. A relative motion goes at the speed that sp or mv has set: before one, each limited axis of
which that is not sure is told it again, or its limit where nobody has said any; never more than the program asked.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nclient.backends.backend import Backend
from nclient.backends.wrapper import Wrapper
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.units import SCOUT_WHEEL_IN_PER_DEG

_VELOCITY, _RELATIVE, _SPEED, _ABSOLUTE = 1, 2, 5, 6
_NOWHERE = 0
_AXES = 3
_Limits = tuple[float, ...]


class Capped(Wrapper):
    """Limits in inches and degrees a second; infinite where none. Raises as the backend inside."""

    def __init__(
        self, inner: Backend, *, max_speed_in_s: float = float("inf"), max_turn_deg_s: float = float("inf")
    ) -> None:
        super().__init__(inner)
        self._speed, self._turn = 10 * max_speed_in_s, 10 * max_turn_deg_s
        if inner.terms.model.has_turret:
            self._limits: _Limits = (self._speed, self._turn, self._turn)
        else:
            wheel = min(self._speed, self._turn * SCOUT_WHEEL_IN_PER_DEG)
            self._limits = (wheel, wheel, float("inf"))
        self._asked: dict[int, int] = {}
        """The speed of each axis that the program has set, within the limits."""
        self._sure: set[int] = set()
        """The axes whose speed the robot is known to have."""

    def execute(self, call: Call) -> Reply:
        """The answer to the call as it may be."""
        within = self._within(call)
        try:
            if _goes_at_sp(call):
                self._make_sure(_speeds(within))
            return self._say(within)
        except ConnectionLost:
            self._sure.clear()
            raise

    def _say(self, call: Call) -> Reply:
        speeds = _speeds(call)
        try:
            reply = self._inner.execute(call)
        except (ReplyTimeout, ConnectionLost):  # it may have been heard, or not
            self._asked |= speeds
            self._sure -= speeds.keys()
            raise
        self._asked |= speeds
        self._sure |= speeds.keys()
        return reply

    def _make_sure(self, about_to_be_set: Mapping[int, int]) -> None:
        """Tell the speeds of relative motion that the robot may not have; axes without a limit keep theirs."""
        speeds = {
            axis: self._asked.get(axis, int(limit))
            for axis, limit in enumerate(self._limits)
            if limit < float("inf") and axis not in self._sure and axis not in about_to_be_set
        }
        if speeds:
            pairs = [(_SPEED, speeds[axis]) if axis in speeds else (_NOWHERE, 0) for axis in range(_AXES)]
            self._inner.execute(Call("mv", tuple(number for pair in pairs for number in pair)))
            self._sure |= speeds.keys()

    def _within(self, call: Call) -> Call:
        if call.name == "vm" and len(call.args) == _AXES:
            return Call("vm", self._velocities(call.args))
        if call.name == "sp" and len(call.args) == _AXES:
            return Call("sp", tuple(map(_limited, call.args, self._limits)))
        if call.name == "mv" and len(call.args) == 2 * _AXES:
            return Call("mv", self._by_modes(call.args[::2], call.args[1::2]))
        return call

    def _velocities(self, asked: Sequence[int]) -> tuple[int, ...]:
        if self._inner.terms.model.has_turret:
            return tuple(map(_limited, asked, self._limits))
        right, left, rest = asked
        turn = abs(right - left) / 2 / SCOUT_WHEEL_IN_PER_DEG
        share = min(1.0, _share(self._speed, max(abs(right), abs(left))), _share(self._turn, turn))
        return int(right * share), int(left * share), rest

    def _by_modes(self, modes: Sequence[int], values: Sequence[int]) -> tuple[int, ...]:
        """mv: velocities and speeds are limited by axis; a Scout's wheels, where both have a velocity, together."""
        if not self._inner.terms.model.has_turret and tuple(modes[:2]) == (_VELOCITY, _VELOCITY):
            values = self._velocities(values)
        within = []
        for mode, value, limit in zip(modes, values, self._limits, strict=True):
            within += [mode, _limited(value, limit) if mode in (_VELOCITY, _SPEED) else value]
        return tuple(within)


def _goes_at_sp(call: Call) -> bool:
    modes = call.args[::2] if call.name == "mv" else ()
    return call.name in ("pr", "pa") or not {_RELATIVE, _ABSOLUTE}.isdisjoint(modes)


def _speeds(call: Call) -> dict[int, int]:
    """The axes whose speed of relative motion a call sets, and the speed."""
    if call.name == "sp":
        return dict(enumerate(call.args))
    if call.name == "mv":
        pairs = zip(call.args[::2], call.args[1::2], strict=False)
        return {axis: value for axis, (mode, value) in enumerate(pairs) if mode == _SPEED}
    return {}


def _limited(value: int, limit: float) -> int:
    return value if abs(value) <= limit else int(limit if value > 0 else -limit)


def _share(limit: float, value: float) -> float:
    return limit / value if value > limit else 1.0
