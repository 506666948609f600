"""What a call to an Nserver becomes on a real robot, and its reply from what the robot answers. One table.

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

from collections.abc import Callable
from dataclasses import replace
from typing import Final, NamedTuple

from nclient.protocol.bounds import within_line
from nclient.protocol.commands import BY_NAME, Call, on_line
from nclient.protocol.mask import COMPASS_SLOT
from nclient.protocol.replies import Reply
from nserver_emu.gateway.robot_state import Link, laser_for, state_for
from nserver_emu.server.conversation.session import BAD_VALUES, NOT_AVAILABLE, Visit, error_reply
from nserver_emu.server.handling.ground import done

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
