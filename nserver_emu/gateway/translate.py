"""Translation between Nserver's calls and a real robot's: calls to the robot, and replies from its answers.

    call ──> plan: calls for the robot, one after another ──> the last one's answer ──> reply for the connection

    place_robot         dp and da: the robot cannot be moved by hand, only its encoders can be set
    ct                  each connection agrees on its mask with this server; the robot sends all slots
    get_cp              the whole state where the model's line has no such query
    conf_cp             followed by the state, which is an Nserver's reply
    get_robot_conf      the pose of the robot's encoders
    everything else     unchanged

A command without a row here is answered by the simulation. What the robot lacks is ERROR 4, position stamps on a line
without stamps included. Numbers beyond the range of the robot's line are clamped to it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from nclient.protocol.client_state import ERROR_SLOT, STATE_SIZE
from nclient.protocol.codec import clamp_to_serial
from nclient.protocol.commands import BY_NAME, Call, exists_on_serial
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import BUMPER_SLOT, COMPASS_SLOT, LASER_SLOT, Model, tenths
from nclient.protocol.wire_state import LINES, PIXELS, POINTS
from nserver_emu.server.server_state import INFRARED_NOTHING, apply_mask
from nserver_emu.server.session import BAD_VALUES, NOT_AVAILABLE, ConnectionContext, done, error_reply
from nserver_emu.simulation.laser import COLUMNS, PIXEL_IN, LineFit, lines, points
from worlds.geometry import FloatArray
from worlds.robots import BODIES, Body

NO_READINGS: Final = (0,)
"""A laser vector without readings."""
REAL_TIME: Final = 10
"""State[0] of a robot whose time runs at normal speed, in tenths."""
REFRESH: Final = Call("gs")
MAX_TIMEOUT_S: Final = 255
"""The watchdog time-out has one byte on the robot's line."""
_SPEED_SLOT: Final = 0
_INFRARED_SLOTS: Final = range(1, 17)
_POSE_SLOTS: Final = range(34, 38)
_AXES: Final = 7
"""Bits of State[41] that show moving axes; the bits above are a Scout's battery."""
_MAX_MV_MODE: Final = 5
"""Clients refuse modes of mv beyond this one, and so does the gateway."""


@dataclass(frozen=True, slots=True)
class Link:
    """Link to a real robot: its model, and whether it is the robot's own line or another Nserver."""

    model: Model
    own_line: bool

    @property
    def masks(self) -> bool:
        """True if the slots and stamps of its state packets can be selected."""
        return self.model.sends_mask or not self.own_line

    def clean(self, slots: Mapping[int, int]) -> dict[int, int]:
        """Return State slots without the bumper bits that a robot at rest sets on its own line."""
        clean = dict(slots)
        if BUMPER_SLOT in clean:
            clean[BUMPER_SLOT] &= ~self.model.bumper_rest
        return clean


ReplyBuilder = Callable[[ConnectionContext, Reply, Link], Reply]
"""Makes a connection's reply from the robot's answer."""


class TranslatedCall(NamedTuple):
    """The calls to make, and the function that turns the last answer into the connection's reply."""

    calls: tuple[Call, ...]
    build_reply: ReplyBuilder


def stays_here(name: str) -> bool:
    """Return True if the simulation answers this command whichever robot is driven: world, window and server."""
    return name not in _ROWS and name not in LACKING


def plan(call: Call, context: ConnectionContext, link: Link) -> TranslatedCall | int:
    """Translate a connection's call.

    Returns
    -------
    TranslatedCall or int
        The code of an ERROR reply where the robot has no such command or the values are wrong.
    """
    if call.name not in _ROWS:
        return NOT_AVAILABLE
    if call.name == "mv" and any(not 0 <= mode <= _MAX_MV_MODE for mode in call.args[::2]):
        return BAD_VALUES
    if call.name == "ct" and context.wire_state.mask.position and not link.masks:
        return NOT_AVAILABLE
    calls, build_reply = _ROWS[call.name](call, context, link)
    if link.own_line and not all(exists_on_serial(BY_NAME[sent.name], link.model) for sent in calls):
        return NOT_AVAILABLE
    return TranslatedCall(tuple(map(clamp_to_serial, calls)) if link.own_line else calls, build_reply)


# --- Replies ---------------------------------------------------------------------------------------------------------


def whole_state(reply: Reply, link: Link) -> list[int]:
    """Return State[0..44] of a state reply in wire units, as an Nserver sends it.

    Slot 0 is real time, 1-16 are 15 where the robot has no infrareds, 33 has no bits of bumpers at rest, 42 and 44
    are 0 until a connection's own values are filled in.
    """
    slots = dict.fromkeys(range(STATE_SIZE), 0) | dict.fromkeys(_INFRARED_SLOTS, INFRARED_NOTHING)
    slots[_SPEED_SLOT] = REAL_TIME
    slots |= link.clean(reply.slots)
    slots[LASER_SLOT] = slots[ERROR_SLOT] = 0
    return list(slots.values())


def state_for(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Return the state reply for this connection, by its mask and laser mode.

    A slot that the connection's mask leaves out repeats the value last sent there.
    """
    slots, laser = whole_state(reply, link), None
    if link.model.has_laser:
        slots[LASER_SLOT] = context.wire_state.laser_mode
        wire_state = context.wire_state
        laser = shaped(reply.laser, wire_state.laser_width, link) if wire_state.mask.has(LASER_SLOT) else None
    return reply._replace(slots=dict(enumerate(apply_mask(context, slots))), laser=laser)


def laser_for(context: ConnectionContext, reply: Reply, link: Link, *, segments: bool) -> Reply:
    """Return the reply to get_ls or, with `segments`, to get_sg."""
    width = LINES if segments else context.wire_state.get_laser_width
    return reply._replace(laser=shaped(reply.laser, width, link))


def moving_axes(reply: Reply) -> int:
    """Return the moving axes of a state reply: bits 0 translation, 1 steering, 2 turret."""
    return reply.slots.get(MOTOR_SLOT, 0) & _AXES


def shaped(laser: tuple[int, ...] | None, width: int, link: Link) -> tuple[int, ...] | None:
    """Return a laser vector with `width` words per reading; None where there is none."""
    return None if laser is None else convert_laser(laser, width, BODIES[link.model.name], LineFit())


def convert_laser(vector: tuple[int, ...], width: int, body: Body, fit: LineFit) -> tuple[int, ...]:
    """Convert a laser vector to another number of words per reading.

    Words per reading: 4 lines (x1 y1 x2 y2), 2 points (x y), 1 the camera's row of each column. Rows become points
    and points become lines; the other directions are not possible and give no readings.

    Parameters
    ----------
    vector : the count n, then the numbers of n readings, in tenths of an inch or rows.
    width : words per reading of the result.
    body, fit : geometry of the laser, and settings of the line fit.
    """
    count = vector[0]
    source_width = (len(vector) - 1) // count if count else width
    if source_width == width:
        return vector
    if source_width == LINES or width == PIXELS:
        return NO_READINGS
    # 1. To points (k, 2) in inches, robot frame.
    if source_width == PIXELS:
        converted = _points_of_rows(vector[1:], body)
    else:
        converted = np.reshape(vector[1:], (-1, POINTS)) / 10.0
    # 2. To lines (k, 4).
    if width == LINES:
        converted = lines(converted, fit)
    return (len(converted), *[tenths(number) for number in converted.ravel().tolist()])


def _points_of_rows(rows: tuple[int, ...], body: Body) -> FloatArray:
    """Return points (k, 2) in inches in the robot's frame, of the columns with a reading: range is PIXEL_IN / row."""
    columns = np.linspace(0, COLUMNS - 1, len(rows)).round().astype(int)  # readings are spread evenly over the angle
    ranges = np.full(COLUMNS, np.inf)
    has_reading = np.array(rows) > 0
    ranges[columns[has_reading]] = PIXEL_IN / np.array(rows)[has_reading]
    return points(ranges, body)


def _unchanged(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    return reply


def _done(_context: ConnectionContext, _reply: Reply, _link: Link) -> Reply:
    return done()


def _numbers(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to a query that sets slots of State; later state replies repeat them."""
    clean = reply._replace(slots=link.clean(reply.slots))
    context.update_last_sent(clean.slots)
    return clean


def _accelerations(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    """Reply to get_ra, which arrives in the slots of the velocities; without any the robot has no such query."""
    return reply if reply.slots else error_reply(NOT_AVAILABLE)


def _compass(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
    """Reply to get_cp made from a whole state."""
    compass = {COMPASS_SLOT: reply.slots[COMPASS_SLOT]}
    return _numbers(context, Reply("compass", compass, clock=reply.clock), link)


def _pose(_context: ConnectionContext, reply: Reply, _link: Link) -> Reply:
    return Reply("configuration", values=tuple(reply.slots[slot] for slot in _POSE_SLOTS))


# --- Calls -----------------------------------------------------------------------------------------------------------

Row = Callable[[Call, ConnectionContext, Link], TranslatedCall]


def _same_call(build_reply: ReplyBuilder) -> Row:
    return lambda call, _context, _link: TranslatedCall((call,), build_reply)


def _refresh(_call: Call, _context: ConnectionContext, _link: Link) -> TranslatedCall:
    return TranslatedCall((REFRESH,), state_for)


def _get_cp(call: Call, _context: ConnectionContext, link: Link) -> TranslatedCall:
    return TranslatedCall((call,), _numbers) if link.masks else TranslatedCall((REFRESH,), _compass)


def _conf_cp(call: Call, context: ConnectionContext, _link: Link) -> TranslatedCall:
    on_its_line = context.wire_state.line
    return TranslatedCall((call,), _unchanged) if on_its_line else TranslatedCall((call, REFRESH), state_for)


def _tk(call: Call, context: ConnectionContext, _link: Link) -> TranslatedCall:
    on_its_line = context.wire_state.line
    return TranslatedCall((call, REFRESH), state_for) if on_its_line else TranslatedCall((call,), _done)


def _place(call: Call, _context: ConnectionContext, _link: Link) -> TranslatedCall:
    x, y, steering, turret = call.args
    return TranslatedCall((Call("dp", (x, y)), Call("da", (steering, turret))), _done)


def _get_robot_conf(_call: Call, _context: ConnectionContext, _link: Link) -> TranslatedCall:
    return TranslatedCall((Call("get_rc"),), _pose)


def _conf_tm(call: Call, _context: ConnectionContext, _link: Link) -> TranslatedCall:
    return TranslatedCall((Call("conf_tm", (min(max(call.args[0], 0), MAX_TIMEOUT_S),)),), state_for)


def _laser(*, segments: bool) -> Row:
    def build_reply(context: ConnectionContext, reply: Reply, link: Link) -> Reply:
        return laser_for(context, reply, link, segments=segments)

    return _same_call(build_reply)


_ROWS: dict[str, Row] = {
    **dict.fromkeys(("gs", "ct", "ws"), _refresh),
    **dict.fromkeys(("vm", "sp", "ac", "pr", "pa", "mv", "st", "lp", "zr", "dp", "da"), _same_call(state_for)),
    **dict.fromkeys(("conf_ir", "conf_sn", "conf_ls", "conf_sg", "conf_ser"), _same_call(state_for)),
    **dict.fromkeys(("get_ir", "get_sn", "get_rc", "get_rv", "get_bp"), _same_call(_numbers)),
    "get_ra": _same_call(_accelerations),
    "get_cp": _get_cp,
    "get_ls": _laser(segments=False),
    "get_sg": _laser(segments=True),
    "conf_cp": _conf_cp,
    "conf_tm": _conf_tm,
    "tk": _tk,
    "place_robot": _place,
    "get_robot_conf": _get_robot_conf,
    **dict.fromkeys(("special_request", "arm_zr", "arm_ws", "arm_mv"), _same_call(_unchanged)),
}
"""All commands that are sent to the robot."""

LACKING: Final = frozenset({"sim_truth", "sim_control"})
"""Commands that no real robot can answer: its true pose, and control of time."""
