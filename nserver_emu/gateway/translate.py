"""A laser vector in another shape than the robot sent: a connection reads one shape, the robot's laser gives another.

    words a reading     4 lines x1 y1 x2 y2 | 2 points x y | 1 the camera's row of each column
    rows -> points -> lines       and no way back: what cannot be made is (0,), no reading

Rules: pure. Rows become points by the geometry of simulation/laser.py, evenly spread over its angle.

The real robot's State as an Nserver sends it: what came over its line, on the terms of each connection.

    0 speed: 10, real time | 1-16 infrared: 15 where it has none | 33 bumpers: clean, at rest 0
    41 motors as the robot says | 42 laser mode of the connection | 43 compass | 44 error: 0

Rules: pure. A state packet of any mask or none makes all 45 slots; a slot that the connection's mask leaves out keeps
the value last sent there. Stamps that a robot does not make read 0.

What a call to an Nserver becomes on a real robot, and its reply from what the robot answers. One table.

    call ──> plan: calls to the robot, one after another ──> the last one's reply ──> reply of the connection

    place_robot         dp and da: a robot cannot be put anywhere, but told where it is
    ct                  what the packets hold is agreed with each connection here; the robot sends all it can
    get_cp              the state where the line of that model has no such question
    conf_cp             the state after it, which is what an Nserver answers
    get_robot_conf      where the robot's encoders are
    everything else     itself

Rules: pure. A command that has no row here stays with the simulation; what the robot lacks is ERROR 4: position stamps
on a line that has none as well. Numbers that the robot's own line cannot carry are brought to the nearest it can.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from nclient.protocol.client_state import ERROR_SLOT, STATE_SIZE
from nclient.protocol.codec import within_line
from nclient.protocol.commands import BY_NAME, Call, on_line
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, LASER_SLOT, Model, tenths
from nclient.protocol.wire_state import LINES, PIXELS, POINTS
from nserver_emu.server.handlers.world import done
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, Visit, error_reply
from nserver_emu.server.state_encoder import INFRARED_NOTHING, as_sent
from nserver_emu.simulation.laser import COLUMNS, PIXEL_IN, LineFit, lines, points
from worlds.bodies import BODIES, Body
from worlds.geometry import FloatArray

NOTHING = (0,)


def in_shape(vector: tuple[int, ...], width: int, body: Body, fit: LineFit) -> tuple[int, ...]:
    """The laser vector (n, numbers of n readings), 1/10 inch or rows, with `width` words a reading."""
    count = vector[0]
    given = (len(vector) - 1) // count if count else width
    if given == width:
        return vector
    if given == LINES or width == PIXELS:
        return NOTHING
    found = _points_of_rows(vector[1:], body) if given == PIXELS else np.reshape(vector[1:], (-1, POINTS)) / 10.0
    if width == LINES:
        found = lines(found, fit)
    return (len(found), *[tenths(number) for number in found.ravel().tolist()])


def _points_of_rows(rows: tuple[int, ...], body: Body) -> FloatArray:
    """Points (k, 2) in the robot's frame, of the columns that see something: range is PIXEL_IN / row."""
    at = np.linspace(0, COLUMNS - 1, len(rows)).round().astype(int)
    seen = np.full(COLUMNS, np.inf)
    lit = np.array(rows) > 0
    seen[at[lit]] = PIXEL_IN / np.array(rows)[lit]
    return points(seen, body)


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


Shaping = Callable[[Visit, Reply, Link], Reply]
REFRESH: Final = Call("gs")
HIGHEST_TIMEOUT_S: Final = 255
_POSE: Final = range(34, 38)
_MV_HIGHEST: Final = 5
"""Modes of mv beyond it are refused by clients, and here."""


class Plan(NamedTuple):
    """The calls to make, and what the last one's reply becomes."""

    calls: tuple[Call, ...]
    shape: Shaping


def stays_here(name: str) -> bool:
    """Whether the command is about the world, the window or the server: the simulation's, whatever robot is driven."""
    return name not in _ROWS and name not in LACKING


def plan(call: Call, visit: Visit, link: Link) -> Plan | int:
    """What to say to the robot for a call of this connection; the code of an ERROR where it has no such thing."""
    if call.name not in _ROWS:
        return NOT_AVAILABLE
    if call.name == "mv" and any(not 0 <= mode <= _MV_HIGHEST for mode in call.args[::2]):
        return BAD_VALUES
    if call.name == "ct" and visit.terms.mask.position and not link.masks:
        return NOT_AVAILABLE
    calls, shape = _ROWS[call.name](call, visit, link)
    if link.own_line and not all(on_line(BY_NAME[said.name], link.model) for said in calls):
        return NOT_AVAILABLE
    return Plan(tuple(map(within_line, calls)) if link.own_line else calls, shape)


Row = Callable[[Call, Visit, Link], Plan]


def _state(visit: Visit, reply: Reply, link: Link) -> Reply:
    return state_for(visit, reply, link)


def _as_it_is(_visit: Visit, reply: Reply, _link: Link) -> Reply:
    return reply


def _done(_visit: Visit, _reply: Reply, _link: Link) -> Reply:
    return done()


def _numbers(visit: Visit, reply: Reply, link: Link) -> Reply:
    """A question that puts State's own numbers."""
    clean = replace(reply, slots=link.clean(reply.slots))
    visit.keep(clean.slots)
    return clean


def _accelerations(_visit: Visit, reply: Reply, _link: Link) -> Reply:
    """They stand in the places of the velocities, and are none."""
    return reply if reply.slots else error_reply(NOT_AVAILABLE)


def _compass(visit: Visit, reply: Reply, link: Link) -> Reply:
    """The compass out of a whole state."""
    compass = {COMPASS_SLOT: reply.slots[COMPASS_SLOT]}
    return _numbers(visit, Reply("compass", compass, clock=reply.clock), link)


def _pose(_visit: Visit, reply: Reply, _link: Link) -> Reply:
    return Reply("configuration", values=tuple(reply.slots[slot] for slot in _POSE))


def _itself(shape: Shaping) -> Row:
    return lambda call, _visit, _link: Plan((call,), shape)


def _refresh(_call: Call, _visit: Visit, _link: Link) -> Plan:
    return Plan((REFRESH,), _state)


def _get_cp(call: Call, _visit: Visit, link: Link) -> Plan:
    return Plan((call,), _numbers) if link.masks else Plan((REFRESH,), _compass)


def _conf_cp(call: Call, visit: Visit, _link: Link) -> Plan:
    return Plan((call,), _as_it_is) if visit.terms.line else Plan((call, REFRESH), _state)


def _tk(call: Call, visit: Visit, _link: Link) -> Plan:
    return Plan((call, REFRESH), _state) if visit.terms.line else Plan((call,), _done)


def _place(call: Call, _visit: Visit, _link: Link) -> Plan:
    x, y, steering, turret = call.args
    return Plan((Call("dp", (x, y)), Call("da", (steering, turret))), _done)


def _get_robot_conf(_call: Call, _visit: Visit, _link: Link) -> Plan:
    return Plan((Call("get_rc"),), _pose)


def _conf_tm(call: Call, _visit: Visit, _link: Link) -> Plan:
    return Plan((Call("conf_tm", (min(max(call.args[0], 0), HIGHEST_TIMEOUT_S),)),), _state)


def _laser(*, segments: bool) -> Row:
    def shape(visit: Visit, reply: Reply, link: Link) -> Reply:
        return laser_for(visit, reply, link, segments=segments)

    return _itself(shape)


_ROWS: dict[str, Row] = {
    **dict.fromkeys(("gs", "ct", "ws"), _refresh),
    **dict.fromkeys(("vm", "sp", "ac", "pr", "pa", "mv", "st", "lp", "zr", "dp", "da"), _itself(_state)),
    **dict.fromkeys(("conf_ir", "conf_sn", "conf_ls", "conf_sg", "conf_ser"), _itself(_state)),
    **dict.fromkeys(("get_ir", "get_sn", "get_rc", "get_rv", "get_bp"), _itself(_numbers)),
    "get_ra": _itself(_accelerations),
    "get_cp": _get_cp,
    "get_ls": _laser(segments=False),
    "get_sg": _laser(segments=True),
    "conf_cp": _conf_cp,
    "conf_tm": _conf_tm,
    "tk": _tk,
    "place_robot": _place,
    "get_robot_conf": _get_robot_conf,
    **dict.fromkeys(("special_request", "arm_zr", "arm_ws", "arm_mv"), _itself(_as_it_is)),
}
"""Every command that goes to the robot."""

LACKING: Final = frozenset({"sim_truth", "sim_control"})
"""What no real robot has: nobody knows where it is but itself, and nobody stops its time."""
