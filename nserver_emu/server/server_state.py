"""The simulation behind the protocol: a call from any connection is executed here, and its reply is made.

    ServerState   simulation | clock | graphics | traces | transcript | arms | ownership | emergency stop | permissions

    answer(call) ──> time in lockstep, command timeout, emergency stop ──> handler of the command (handlers/)
                                                                            └─> state_reply(), cached between changes

Handlers change the state; daemon and viewer read it. A snapshot contains it except for what belongs to connections and
operators (ownership, emergency stop, pending pose requests).

In the State vector and the laser vector inches and radians become tenths:

    State   0 speed | 1-16 infrared | 17-32 sonar | 33 bumper | 34-37 x y steering turret | 38-40 velocities
            41 motors | 42 laser mode | 43 compass | 44 error
    laser   count, then per reading 4 words (lines x1 y1 x2 y2), 2 words (points x y, robot's frame) or 1 word (the
            camera's row of each column)

Axes count in tenths of an inch if they roll and tenths of a degree if they turn; the model decides (the second axis of
an N150 steers, that of a Scout is its left wheel). A slot that the sensor mask excludes keeps the value last sent on
that connection; on a robot's own line it is not sent. Excluded sensors are not evaluated, which saves their ray casts.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from nclient.errors import HELD
from nclient.protocol import types
from nclient.protocol.client_state import ERROR_SLOT, RING_PACKET, STATE_SIZE
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import MOTOR_SLOT, Reply
from nclient.protocol.types import Mask, Position, Stamp, WireState, clamp_word, heading_tenths, raw_volts, tenths
from nserver_emu.server import session
from nserver_emu.server.admission import Limits
from nserver_emu.server.estop import EStop
from nserver_emu.server.graphics import MAX_UTTERANCES, Graphics, Traces, Utterance
from nserver_emu.server.session import NOT_AVAILABLE, CachedStateReply, ConnectionContext, DeferredReply, error_reply
from nserver_emu.simulation import segments
from nserver_emu.simulation.axis import Arm
from nserver_emu.simulation.robot import SimulatedRobot, battery_v
from nserver_emu.simulation.segments import PS_PER_S, Pose, to_ps, to_s
from nserver_emu.simulation.sensors import NOTHING, lines, pixels, points
from nserver_emu.simulation.simulation import Simulation
from worlds.world import World

# Limits of the ratio of simulated to real time.
MIN_TIME_FACTOR: Final = 0.1
MAX_TIME_FACTOR: Final = 999.0
# Simulated seconds per request in lockstep.
MAX_LOCKSTEP_S: Final = 10.0
# Processor time of a turn that prepares a reply; the last step may take some tenths of a millisecond longer.
PREPARING_S: Final = 0.0003
_COMPLETE: Final = object()
# State[0] at unlimited speed.
UNLIMITED_SPEED: Final = 9999


@dataclass(slots=True)
class SimulationClock:
    """The relation of simulated to real time; changed by `sim_control`, obeyed by the daemon.

    Field names are keys in recordings.
    """

    # Simulated seconds per real second, MIN_TIME_FACTOR to MAX_TIME_FACTOR; None is unlimited.
    factor: float | None = 1.0
    paused: bool = False
    # In lockstep: simulated seconds per request, and time passes at no other moment. None: no lockstep.
    lockstep_s: float | None = None

    def check(self) -> None:
        """Raise ValueError for values out of range; they may come from a file."""
        ranges = (self.factor, MIN_TIME_FACTOR, MAX_TIME_FACTOR), (self.lockstep_s, 0.0, MAX_LOCKSTEP_S)
        for value, low, high in ranges:
            if value is not None and (isinstance(value, bool) or not low <= value <= high):
                raise ValueError(f"simulation clock: {value} is not within {low:g} to {high:g}")
        if not isinstance(self.paused, bool) or self.lockstep_s == 0.0:
            raise ValueError("simulation clock: paused must be a boolean, and lockstep_s above 0")

    @property
    def is_free_running(self) -> bool:
        """True if time passes without requests."""
        return not self.paused and self.lockstep_s is None

    @property
    def step_per_request_s(self) -> float:
        """Simulated seconds that pass per request."""
        return 0.0 if self.paused or self.lockstep_s is None else self.lockstep_s

    @property
    def speed_tenths(self) -> int:
        """State[0]: the factor x 10, 0 when paused or in lockstep, UNLIMITED_SPEED for no limit."""
        if not self.is_free_running:
            return 0
        return UNLIMITED_SPEED if self.factor is None else round(10 * self.factor)


_LIMITS: Final = Limits()
# Simulated time between polls of deferred replies, a tenth of a second.
POLL_INTERVAL_PS: Final = PS_PER_S // 10


@dataclass(frozen=True, slots=True)
class Allowed:
    """Permissions of clients and the limits that decide replies (admission.py). Field names are keys in recordings."""

    # End the server with quit_server.
    quit: bool = False
    # Change simulated time with sim_control.
    control: bool = False
    obstacles: int = _LIMITS.obstacles
    graphics: int = _LIMITS.graphics
    frame: int = _LIMITS.frame


ALL_AXES: Final = (0, 1, 2)
# The arm, after the axes in the list of a robot's owners. It counts as moving.
ARM: Final = 3


class AxisOwnership:
    """The connection that last commanded each axis, and each arm, by robot: when it closes, they stop.

    Axes that other connections set in motion continue. `on_disconnect` is called by `ServerState.on_disconnect`, and
    that by `TcpConnection.connection_lost`.
    """

    def __init__(self) -> None:
        # Owner of each of the three axes, and of the arm; None without commands.
        self._owners: dict[int, list[ConnectionContext | None]] = {}
        # Robots of a restored simulation that no connection has claimed yet.
        self._unowned: set[int] = set()

    def claim(self, context: ConnectionContext, robot_id: int, axes: Iterable[int]) -> None:
        """Make a connection the owner of these axes, or of the ARM."""
        owners = self._owners.setdefault(robot_id, [None] * (ARM + 1))
        for axis in axes:
            owners[axis] = context

    def release_all(self, robot_ids: Iterable[int]) -> None:
        """Remove all owners: these robots come from a snapshot, and their connections do not exist any more."""
        self._owners.clear()
        self._unowned = set(robot_ids)

    def claim_unowned(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> None:
        """Give the axes that still move after a restore, and the arm, to the first connection to their robot."""
        if robot_id not in self._unowned:
            return
        self._unowned.discard(robot_id)
        owners = self._owners.get(robot_id, [None] * (ARM + 1))
        self.claim(context, robot_id, [axis for axis, owner in _moving(robot, owners) if owner is None])

    def may_feed_watchdog(self, context: ConnectionContext, robot_id: int, robot: SimulatedRobot) -> bool:
        """Return True if a request of this connection restarts the robot's command timeout (conf_tm).

        It does if the connection owns a moving axis or the arm, or if there is no owner.
        """
        # 1. The usual case: no other connection has commanded this robot.
        owners = self._owners.get(robot_id, [])
        if all(owner is None or owner is context for owner in owners):
            return True
        # 2. Otherwise the owners of what moves.
        found = [owner for _, owner in _moving(robot, owners) if owner is not None]
        return not found or any(owner is context for owner in found)

    def has_motion(self, context: ConnectionContext, robots: Mapping[int, SimulatedRobot]) -> bool:
        """Return True if closing this connection would stop an axis, or could stop an arm."""
        return any(owner is context for robot_id, owners in self._owners.items()
                   for _, owner in _moving(robots[robot_id], owners))

    def on_disconnect(self, context: ConnectionContext, robots: Mapping[int, SimulatedRobot]) -> list[int]:
        """Stop the axes that a closed connection owns; return the robots whose arms it owns, to be stopped."""
        arms = []
        for robot_id, owners in self._owners.items():
            for axis in [axis for axis, owner in _moving(robots[robot_id], owners) if owner is context]:
                if axis == ARM:
                    arms.append(robot_id)
                else:
                    robots[robot_id].stop_axis(axis)
            self._owners[robot_id] = [None if owner is context else owner for owner in owners]
        return arms


def _moving(robot: SimulatedRobot,
            owners: Sequence[ConnectionContext | None]) -> Iterator[tuple[int, ConnectionContext | None]]:
    """Yield the moving axes of a robot, and the ARM, with their owners."""
    for axis, (owner, is_moving) in enumerate(zip(owners, (*robot.moving, True), strict=True)):
        if is_moving:
            yield axis, owner


# The State vector.


def axis_values(robot: SimulatedRobot, tenths: tuple[int, ...]) -> tuple[float, float, float]:
    """Return the three values of a command in inches or radians, as the model's axes count."""
    first, second, third = (number / 10 if rolls else types.rad_from_tenths(number)
                            for number, rolls in zip(tenths, robot.model.in_inches, strict=True))
    return first, second, third


def axis_tenths(robot: SimulatedRobot, values: tuple[float, float, float]) -> tuple[int, int, int]:
    """Return axis values (inches or radians) in tenths; a value other than zero never becomes zero."""
    (first, second, third), (rolls_1, rolls_2, rolls_3) = values, robot.model.in_inches
    return (away_from_zero((first if rolls_1 else math.degrees(first)) * 10),
            away_from_zero((second if rolls_2 else math.degrees(second)) * 10),
            away_from_zero((third if rolls_3 else math.degrees(third)) * 10))


def away_from_zero(value: float) -> int:
    """Return the nearest integer, for a value other than zero the nearest except zero."""
    rounded = round(value)
    return rounded if rounded or not value else (1 if value > 0 else -1)


def is_on(mode: int) -> bool:
    """Return True if the laser is on in this mode (bit 0)."""
    return bool(mode & 1)


def laser_vector(robot: SimulatedRobot, context: ConnectionContext, width: int) -> tuple[int, ...]:
    """Return the laser vector with `width` words per reading and a connection's settings; (0,) if it is empty."""
    view = robot.scan_laser(context.laser_columns)
    if width not in (types.POINTS, types.LINES):
        rows = pixels(view)
        return (len(rows), *rows)
    found = points(view, robot.model.body)
    if width == types.LINES:
        found = lines(found, context.line_fit)
    # Rounded as `tenths` does, but in an array: a scan has up to 964 numbers.
    values = np.floor(np.abs(found.ravel()) * 10 + 0.5)
    return (len(found), *np.where(found.ravel() < 0.0, -values, values).astype(int).tolist())


# The clock is a 32-bit word of milliseconds: it wraps around after 50 days.
CLOCK_WORD = 0xFFFFFFFF
# State slots of speed, encoder pose and velocities.
SPEED_SLOT: Final = 0
POSE_SLOTS: Final = range(34, 38)
VELOCITY_SLOTS: Final = range(38, 41)
# Slots that no mask excludes.
UNMASKED_SLOTS = (SPEED_SLOT, MOTOR_SLOT, ERROR_SLOT)


def clock_ms(time_s: float, step_s: float = 0.0) -> int:
    """Return a time as a clock of whole milliseconds that advances in steps of `step_s` (0: every millisecond)."""
    shown_s = math.floor(time_s / step_s + 1e-9) * step_s if step_s else time_s
    return math.floor(shown_s * 1000 + 1e-6) & CLOCK_WORD


def robot_clock_ms(robot: SimulatedRobot, time_s: float) -> int:
    """Return the robot's own clock at a simulated time, in steps of 16.4 ms if the noise model has them."""
    return clock_ms(time_s, robot.setup.clock_step_s)


@lru_cache(maxsize=1)  # all requests between two steps have the same time
def volts_raw(time_s: float) -> tuple[int, int]:
    """Return the raw battery bytes of CPU and motors."""
    voltage = battery_v(time_s)
    return raw_volts(voltage, types.CPU_RANGE_V), raw_volts(voltage, types.MOTOR_RANGE_V)


def pose_tenths(robot: SimulatedRobot) -> tuple[int, int, int, int]:
    """Return x, y, steering and turret of the encoders as in State, tenths."""
    return _pose_tenths(robot.encoder)


def velocity_tenths(robot: SimulatedRobot) -> tuple[int, int, int]:
    """Return the three velocities in tenths; a moving axis is never 0, one at rest always."""
    return axis_tenths(robot, robot.velocities)


def _pose_tenths(pose: Pose) -> tuple[int, int, int, int]:
    return (clamp_word(tenths(pose.x_in)), clamp_word(tenths(pose.y_in)), heading_tenths(pose.steering_rad),
            heading_tenths(pose.turret_rad))


def stamp_now(robot: SimulatedRobot, time_s: float) -> Stamp:
    """Return a stamp of now: bumpers and laser are read when they are requested."""
    now_ms = robot_clock_ms(robot, time_s)
    return Stamp(*pose_tenths(robot), *velocity_tenths(robot), now_ms, now_ms)


def _stamp(robot: SimulatedRobot, at: segments.Stamp) -> Stamp:
    return Stamp(*_pose_tenths(at.pose), *axis_tenths(robot, at.velocities), robot_clock_ms(robot, at.pose_time_s),
                 robot_clock_ms(robot, at.sensor_time_s))


class StateSensor(NamedTuple):
    """A sensor with slots in State: its snapshot, its stamps and the reply to its get_ command follow from this.

    Attributes
    ----------
    kind
        Of the reply to the get_ command.
    slots
        Its State slots.
    position
        The bit in Smask[0] that selects its stamps.
    absent
        Value of its slots in State where the model has no such sensor.
    values
        Return its readings in wire units, None where the model has none.
    stamps
        Return the stamps of its readings by name.
    """

    kind: str
    slots: range
    position: Position
    absent: int
    values: Callable[[SimulatedRobot], Sequence[int] | None]
    stamps: Callable[[SimulatedRobot, float], dict[str, Stamp]]

    def state_values(self, robot: SimulatedRobot) -> Sequence[int]:
        """Return the values of its slots in State."""
        values = self.values(robot)
        return (self.absent,) * len(self.slots) if values is None else values


def _ring_stamps(robot: SimulatedRobot, keys: Sequence[str], ring: Any) -> dict[str, Stamp]:
    """Return pose and time of the last reading of each sensor of a ring; empty if the robot has none."""
    if ring is None:
        return {}
    # State has slots for 16 sonars, whatever the ring has.
    stamps = {key: _stamp(robot, at) for key, at in zip(keys, ring.stamps, strict=False)}
    return {key: stamps.get(key, types.NO_STAMP) for key in keys}


def _compass_stamps(robot: SimulatedRobot, time_s: float) -> dict[str, Stamp]:
    """Return the pose of now with the time of the last compass reading, up to 0.1 s ago; empty without a compass."""
    if robot.compass is None:
        return {}
    taken_ms = robot_clock_ms(robot, to_s(robot.compass.read_ps))
    return {"compass": stamp_now(robot, time_s)._replace(sensor_time=taken_ms)}


def sonar_words(robot: SimulatedRobot) -> tuple[int, ...]:
    """Return the sonars as State has them: 16 whole inches from 6 to 255, 255 without an echo, 0 of a dead sonar.

    Of a larger ring these are the first 16; the slots that a smaller one leaves have no echo.
    """
    no_echo_in, readings = robot.model.body.ring.no_echo_in, robot.sonar.readings_in[:types.SONAR_SLOTS]
    words = [types.MAX_SONAR_IN if reading == no_echo_in else _sonar_word(reading) for reading in readings]
    return (*words, *[types.MAX_SONAR_IN] * (types.SONAR_SLOTS - len(words)))


def _sonar_word(reading_in: float) -> int:
    word = math.floor(reading_in + 0.5)
    if types.MIN_SONAR_IN <= word <= types.MAX_SONAR_IN:
        return word
    return min(max(word, types.MIN_SONAR_IN), types.MAX_SONAR_IN) if reading_in else 0


INFRARED: Final = StateSensor(
    "infrared", range(1, 17), Position.INFRARED, NOTHING,
    lambda robot: None if robot.infrared is None else robot.infrared.readings,
    lambda robot, _: _ring_stamps(robot, types.INFRARED_KEYS, robot.infrared),
)  # fmt: skip
SONAR: Final = StateSensor(
    "sonar", range(17, 33), Position.SONAR, 0, sonar_words,
    lambda robot, _: _ring_stamps(robot, types.SONAR_KEYS, robot.sonar),
)  # fmt: skip
BUMPER: Final = StateSensor(
    "bumper", range(types.BUMPER_SLOT, types.BUMPER_SLOT + 1), Position.BUMPER, 0, lambda robot: (robot.bumpers,),
    lambda robot, time_s: {"bumper": stamp_now(robot, time_s)},
)  # fmt: skip
COMPASS: Final = StateSensor(
    "compass", range(types.COMPASS_SLOT, types.COMPASS_SLOT + 1), Position.COMPASS, 0,
    lambda robot: None if robot.compass is None else (heading_tenths(robot.compass.direction_rad),), _compass_stamps,
)  # fmt: skip
STATE_SENSORS: Final = (INFRARED, SONAR, BUMPER, COMPASS)

# A part of State that a mask can exclude: first slot, end slot, values.
_Part = tuple[int, int, Callable[[SimulatedRobot], Sequence[int]]]
_PARTS: Final[tuple[_Part, ...]] = (
    *((sensor.slots.start, sensor.slots.stop, sensor.state_values) for sensor in STATE_SENSORS),
    (POSE_SLOTS.start, POSE_SLOTS.stop, pose_tenths),
    (VELOCITY_SLOTS.start, VELOCITY_SLOTS.stop, velocity_tenths),
)


class StateSnapshot:
    """The State vector of a robot at one moment, shared by all connections.

    Each part is computed when the first connection needs it, and once. `speed` is State[0].
    """

    def __init__(self, robot: SimulatedRobot, speed: int, time_ps: int = 0) -> None:
        self.time_ps = time_ps
        self._robot = robot
        moving = robot.moving
        self._slots = [0] * STATE_SIZE
        self._slots[SPEED_SLOT], self._slots[MOTOR_SLOT] = speed, moving[0] | moving[1] << 1 | moving[2] << 2
        self._missing: Sequence[_Part] = _PARTS

    def slots(self, mask: Mask = types.EVERYTHING) -> list[int]:
        """Return State[0..44], valid in the slots that the mask includes; callers must not change the list."""
        missing = []
        for part in self._missing:
            first, end, values = part
            if mask.whole or any(mask.smask[first:end]):
                self._slots[first:end] = values(self._robot)
            else:
                missing.append(part)
        self._missing = missing
        return self._slots


def state_slots(robot: SimulatedRobot, speed: int) -> list[int]:
    """Return State[0..44] of now with all sensors."""
    return StateSnapshot(robot, speed).slots()


def build_state_reply(robot: SimulatedRobot, context: ConnectionContext, snapshot: StateSnapshot) -> Reply:
    """Return the state reply to a connection, from a snapshot of now."""
    # 1. State and laser in the form that the connection has chosen.
    mask, time_s = context.wire_state.mask, to_s(snapshot.time_ps)
    slots, laser = add_laser(robot, context, snapshot.slots(mask), wanted=mask.has(types.LASER_SLOT))
    # 2. Excluded slots keep the value last sent.
    slots = apply_mask(context, slots)
    # 3. Positions and times of the readings, if requested.
    stamps: dict[str, Stamp] = {}
    if mask.position:
        for sensor in STATE_SENSORS:
            if mask.position & sensor.position:
                stamps |= sensor.stamps(robot, time_s)
        if mask.position & Position.LASER and robot.model.has_light_sensors:
            stamps["laser"] = stamp_now(robot, time_s)
    return Reply("state", dict(enumerate(slots)), laser, stamps, robot_clock_ms(robot, time_s), volts_raw(time_s))


def apply_mask(context: ConnectionContext, slots: list[int]) -> list[int]:
    """Return State[0..44] as sent to a connection, and record it as last sent."""
    mask, last_sent = context.wire_state.mask, context.last_sent
    if context.is_held:
        slots = [*slots[:ERROR_SLOT], HELD]
    if not mask.whole and not context.wire_state.line:
        slots = [value if slot in UNMASKED_SLOTS or mask.has(slot) else last_sent[slot]
                 for slot, value in enumerate(slots)]
    context.last_sent = slots
    return slots


def add_laser(robot: SimulatedRobot, context: ConnectionContext, slots: list[int], *,
              wanted: bool = True) -> tuple[list[int], tuple[int, ...] | None]:
    """Return the slots with the laser mode of a connection, and its laser vector (None if off or excluded)."""
    if not robot.model.has_light_sensors:
        return slots, None
    wire_state = context.wire_state
    with_mode = [*slots[:types.LASER_SLOT], wire_state.laser_mode, *slots[types.LASER_SLOT + 1 :]]
    is_scanned = wanted and is_on(wire_state.laser_mode)
    return with_mode, laser_vector(robot, context, wire_state.laser_width) if is_scanned else None


# The server.

# A function(server, context, arguments) with the name of a command. None stands for the state, the usual reply.
Handler = Callable[["ServerState", ConnectionContext, tuple[Any, ...]], "Reply | DeferredReply | None"]

# Work that may be done before the handler of a command runs, in steps and without effect on any reply.
Preparation = Callable[["ServerState", ConnectionContext, tuple[Any, ...]], Iterator[None]]

# Commands that do not change the robot.
QUERIES: Final = frozenset({"gs", "ct", "sim_truth", "held_by", *(name for name in BY_NAME if name.startswith("get_"))})
# Queries whose replies contain State slots.
STATE_QUERIES: Final = frozenset({"get_ir", "get_sn", "get_rc", "get_rv", "get_cp", "get_bp"})
# Commands that take no time in lockstep and do not restart the command timeout: observers must not keep a robot moving.
TIMELESS: Final = frozenset(
    {"connect_robot", "create_robot", "disconnect_robot", "sim_truth", "sim_control", "held_by"}
)


def is_ring_packet(call: Call) -> bool:
    """Return True for the user packet that reads the sonars of a ring, which takes no simulated time."""
    return call.name == "special_request" and call.args[:1] == (RING_PACKET,)


class ServerState:
    """A simulation and everything that a server adds to it.

    Parameters
    ----------
    simulation
        The simulated robots and their world.
    port
        The port in the reply to CONNECT.
    clock, allowed
        Speed of simulated time, and permissions of clients; None for the defaults.
    """

    # Handlers, and work before them, by name of the command (handlers/table.py).
    handlers: Mapping[str, Handler] = {}
    preparations: Mapping[str, Preparation] = {}

    def __init__(self, simulation: Simulation, *, port: int = 1, clock: SimulationClock | None = None,
                 allowed: Allowed | None = None) -> None:
        self.simulation = simulation
        self.port = port
        self.clock = clock or SimulationClock()
        self.allowed = allowed or Allowed()
        # True after a client ended the server.
        self.quitting = False
        self.graphics = Graphics()
        self.traces = Traces()
        self.traces.update(simulation.time_s, simulation.robots)
        # The last texts spoken by robots, oldest first.
        self.transcript: deque[Utterance] = deque(maxlen=MAX_UTTERANCES)
        # Arms that were used, by robot.
        self.arms: dict[int, Arm] = {}
        self.axis_ownership = AxisOwnership()
        self.estop = EStop()
        # Worlds that were exported, by their text, so that they can be restored exactly (runtime_settings.py).
        self.exported_worlds: dict[str, World] = {}
        self.pose_requests = session.PoseRequests()
        # Mask and laser mode of robots' own lines.
        self._serial_wire_states: dict[int, WireState] = {}
        # The last state snapshot of each robot.
        self._snapshots: dict[int, StateSnapshot] = {}
        self.deferred = session.DeferredReplies()

    # Calls.

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        """Execute a call and return its reply, ERROR 4 if there is no handler."""
        name = call.name
        if name not in TIMELESS and not is_ring_packet(call):
            # 1. In lockstep, time advances before the call, so that the reply shows the result.
            if self.clock.lockstep_s is not None:
                self.pass_time(self.clock.step_per_request_s)
            # 2. The command timeout of the robot restarts.
            if context.robot_id is not None:
                self.feed_watchdog(context)
        # 3. A command may change the robot, and any but gs what this connection is sent.
        if name != "gs":
            context.cached_state = None
            if name not in QUERIES:
                self.invalidate_state_cache()
        # 4. Under emergency stop, motions become st or are not executed, and the client is informed. A ring is read,
        #    but in recordings made before there was ERROR 7.
        holds = self.estop.holds
        hold = holds.get(context.robot_id) if holds and context.robot_id is not None else None
        if hold is not None and (hold.is_silent or not is_ring_packet(call)):
            answer = self.estop.execute(call, context, self._execute)
        else:
            context.is_held = False
            answer = self._execute(call, context)
        # 5. These replies contain State slots: they count as sent for slots that the mask excludes.
        if not isinstance(answer, Reply):
            return self.deferred.add(context, self.estop.until_held(answer, call, context))
        if name in STATE_QUERIES:
            context.update_last_sent(answer.slots)
        return answer

    def _execute(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        handler = self.handlers.get(call.name)
        if handler is None:
            return error_reply(NOT_AVAILABLE)
        answer = handler(self, context, call.args)
        return self.state_reply(context) if answer is None else answer

    # Time.

    def pass_time(self, seconds: float) -> None:
        """Advance simulated time; deferred replies are built as of the moment they are due."""
        left_ps = to_ps(seconds)
        while left_ps:
            step_ps = min(left_ps, POLL_INTERVAL_PS)
            self.simulation.step(to_s(step_ps))
            self.traces.update(self.simulation.time_s, self.simulation.robots)
            for robot_id in self.arms:
                self._advance_arm(robot_id)
            self.deferred.poll()
            left_ps -= step_ps

    @property
    def clock_ms(self) -> int:
        """Simulated milliseconds since the start."""
        return clock_ms(self.simulation.time_s)

    # Connections.

    def robot_of(self, context: ConnectionContext) -> SimulatedRobot:
        """Return the robot that a connection is connected to."""
        return self.simulation.robots[context.robot]

    def claim_axes(self, context: ConnectionContext, axes: Iterable[int] = ALL_AXES) -> SimulatedRobot:
        """Make a connection the owner of axes of its robot, and return the robot."""
        self.axis_ownership.claim(context, context.robot, axes)
        return self.robot_of(context)

    def prepare_reply(self, context: ConnectionContext, call: Call | None = None) -> bool:
        """Do part of what the next reply to a connection may need; return True if nothing was left to do.

        It changes no reply, whenever it is done. A ping of the measured sonars takes a millisecond, and all sixteen
        several. The reply itself follows in the next turn.

        Parameters
        ----------
        call
            The request, if its command has a preparation of its own.
        """
        if context.robot_id is None:
            return True
        # 1. The usual cases: nothing. A connection that polls has read all sensors of now.
        cached, snapshot = context.cached_state, self._snapshots.get(context.robot_id)
        is_of_now = snapshot is not None and snapshot.time_ps == self.simulation.time_ps
        if call is None and is_of_now and cached is not None and cached.is_for(snapshot, context.wire_state):
            return True
        end_s, steps = time.thread_time() + PREPARING_S, self._preparation_steps(context, call)
        if next(steps, _COMPLETE) is _COMPLETE:
            return True
        # 2. More steps in the same turn, unless the first used it up: a ping among a thousand obstacles takes 1 ms.
        while time.thread_time() < end_s and next(steps, _COMPLETE) is not _COMPLETE:
            pass
        return False

    def _preparation_steps(self, context: ConnectionContext, call: Call | None) -> Iterator[None]:
        if call is not None:
            # No `yield from`: it would close the steps with this generator, and they go on in the next turn.
            for _ in self.preparations[call.name](self, context, call.args):
                yield
            return
        mask, robot = context.wire_state.mask, self.robot_of(context)
        if mask.whole or any(map(mask.has, SONAR.slots)):
            while not robot.sonar.compute_some():
                yield
        if robot.infrared is not None and (mask.whole or any(map(mask.has, INFRARED.slots))):
            while not robot.infrared.compute_some():
                yield

    def feed_watchdog(self, context: ConnectionContext) -> None:
        """Restart the command timeout (conf_tm) of a connection's robot, unless only other connections move it."""
        robot = self.robot_of(context)
        if self.axis_ownership.may_feed_watchdog(context, context.robot, robot):
            robot.feed()

    def on_disconnect(self, context: ConnectionContext) -> None:
        """Stop what a closed connection set in motion, and drop its pending requests."""
        self.invalidate_state_cache()
        self.deferred.cancel(context)
        self.pose_requests.cancel(context)
        for robot_id in self.axis_ownership.on_disconnect(context, self.simulation.robots):
            self.stop_arm(robot_id)

    def hold(self, robot_id: int, by: str, *, is_silent: bool = False) -> None:
        """Stop a robot and ignore motion commands until it is released. Raise KeyError if there is no such robot.

        `is_silent`: clients are not informed, as in recordings of earlier versions.
        """
        self.simulation.robots[robot_id].stop()
        self.stop_arm(robot_id)
        self.invalidate_state_cache()
        self.estop.engage(robot_id, by, is_silent=is_silent)

    def release(self, robot_id: int) -> None:
        """Allow motions of a robot again, held or not."""
        self.estop.release(robot_id)
        self.invalidate_state_cache()

    def serial_wire_state(self, robot_id: int) -> WireState:
        """Return mask and laser mode in force on a robot's own lines.

        They belong to the robot and outlive connections; after a restore they are as at power-on.
        """
        if robot_id not in self._serial_wire_states:
            model = types.get_model(self.simulation.robots[robot_id].model.family)
            self._serial_wire_states[robot_id] = types.serial_wire_state(model)
        return self._serial_wire_states[robot_id]

    # Arms.

    def arm_of(self, context: ConnectionContext) -> Arm:
        """Return the arm of a connection's robot as of now."""
        self.arms.setdefault(context.robot, Arm())
        return self._advance_arm(context.robot)

    def stop_arm(self, robot_id: int) -> None:
        """Stop the arm of a robot if it was ever used."""
        if robot_id in self.arms:
            self._advance_arm(robot_id).stop()

    def _advance_arm(self, robot_id: int) -> Arm:
        """Advance an arm to now; a command timeout of its robot has stopped it at that time."""
        arm, timed_out_s = self.arms[robot_id], self.simulation.robots[robot_id].timed_out_s
        if timed_out_s is not None and arm.time_s < timed_out_s:
            arm.advance_to(timed_out_s)
            arm.stop()
        arm.advance_to(self.simulation.time_s)
        return arm

    # Readings.

    def state_reply(self, context: ConnectionContext) -> Reply:
        """Return the state reply, with which most commands answer.

        Between two steps a robot changes by commands only: all connections share one snapshot of it, and a connection
        that polls gets the same reply again, which its session has encoded already.
        """
        robot, wire_state = self.robot_of(context), context.wire_state
        snapshot = self._snapshots.get(context.robot)
        if snapshot is None or snapshot.time_ps != self.simulation.time_ps:
            snapshot = StateSnapshot(robot, self.clock.speed_tenths, self.simulation.time_ps)
            self._snapshots[context.robot] = snapshot
        cached = context.cached_state
        # A robot's own lines share mask and laser mode, so another connection may change them.
        if cached is None or not cached.is_for(snapshot, wire_state):
            reply = build_state_reply(robot, context, snapshot)
            cached = CachedStateReply(snapshot, wire_state.mask, wire_state.laser_mode, reply)
            context.cached_state = cached
        return cached.reply

    def invalidate_state_cache(self) -> None:
        """Discard all state snapshots after a change that is not due to time."""
        self._snapshots.clear()
