"""The state of a server that commands act on: the simulation and everything a server adds to it. No I/O, no wire units.

    ServerState   simulation | clock | graphics | traces | transcript | arms | ownership | emergency stop | permissions

Handlers change it; daemon and viewer read it. A snapshot contains it except for what belongs to connections and
operators (ownership, emergency stop, pending pose requests).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from nclient.protocol.replies import Reply
from nclient.protocol.types import get_model
from nclient.protocol.wire_state import WireState, serial_wire_state
from nserver_emu.server.graphics import Graphics, Traces, layers
from nserver_emu.server.limits import Limits
from nserver_emu.server.ownership import ALL_AXES, AxisOwnership, EStop
from nserver_emu.server.session import CachedStateReply, ConnectionContext, DeferredReply
from nserver_emu.server.state_encoder import StateSnapshot, build_state_reply, clock_ms
from nserver_emu.simulation.arm import Arm
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import PS_PER_S, to_ps, to_s
from nserver_emu.simulation.simulation import Simulation
from worlds.world import World

# Limits of the ratio of simulated to real time.
MIN_TIME_FACTOR: Final = 0.1
MAX_TIME_FACTOR: Final = 999.0
# Simulated seconds per request in lockstep.
MAX_LOCKSTEP_S: Final = 10.0
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


# get_robot_conf: a pose clicked in the viewer.

# x, y, steering and turret in tenths.
ClickedPose = tuple[int, int, int, int]


@dataclass(eq=False, slots=True)
class PoseRequest:
    """A connection that waits for a pose."""

    robot_id: int
    context: ConnectionContext
    pose: ClickedPose | None = None


class PoseRequests:
    """Pending requests for a clicked pose. One click answers all requests for that robot."""

    def __init__(self) -> None:
        # True while a viewer with permission to click is open; without one, requests are answered at once.
        self.open = False
        self._requests: list[PoseRequest] = []

    def add(
        self, robot_id: int, context: ConnectionContext, default: Callable[[], ClickedPose]
    ) -> Callable[[], ClickedPose | None]:
        """Request a pose of a robot.

        Returns
        -------
        Callable
            Poll it until it returns a pose. It returns `default()` as soon as no viewer is open.
        """
        request = PoseRequest(robot_id, context)
        self._requests.append(request)

        def poll() -> ClickedPose | None:
            if request.pose is None and not self.open:
                self._requests = [other for other in self._requests if other is not request]
                request.pose = default()
            return request.pose

        return poll

    def counts(self) -> dict[int, int]:
        """Return the number of pending requests by robot."""
        counts: dict[int, int] = {}
        for request in self._requests:
            counts[request.robot_id] = counts.get(request.robot_id, 0) + 1
        return counts

    def answer(self, robot_id: int, pose: ClickedPose) -> bool:
        """Answer the requests for a robot with a clicked pose; return True if there were any."""
        pending = [request for request in self._requests if request.robot_id == robot_id]
        for request in pending:
            request.pose = pose
        self._requests = [request for request in self._requests if request.pose is None]
        return bool(pending)

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the requests of a closed connection."""
        self._requests = [request for request in self._requests if request.context is not context]


# tk: speech output of robots.

# Older utterances are dropped, so that clients that speak for days do not fill memory.
MAX_UTTERANCES: Final = 1000


class Utterance(NamedTuple):
    """A text spoken by a robot."""

    # Simulated seconds.
    time_s: float
    robot_id: int
    text: str


class SpeechLog:
    """The last texts spoken by robots, oldest first."""

    def __init__(self) -> None:
        self._utterances: deque[Utterance] = deque(maxlen=MAX_UTTERANCES)

    @property
    def utterances(self) -> tuple[Utterance, ...]:
        """All stored texts."""
        return tuple(self._utterances)

    def add(self, utterance: Utterance) -> None:
        """Append a text."""
        self._utterances.append(utterance)


# Replies that need simulated time.


class PolledReply:
    """A deferred reply that is built at the moment it is due, however late its session fetches it."""

    def __init__(self, context: ConnectionContext, poll: DeferredReply) -> None:
        self.context = context
        self.reply: Reply | None = None
        self._poll = poll

    def __call__(self) -> Reply | None:
        """Return the reply if it exists now."""
        if self.reply is None:
            self.reply = self._poll()
        return self.reply


class DeferredReplies:
    """All deferred replies, polled each time simulated time has passed."""

    def __init__(self) -> None:
        self._pending: list[PolledReply] = []

    def __len__(self) -> int:
        return len(self._pending)

    def add(self, context: ConnectionContext, poll: DeferredReply) -> PolledReply:
        """Add the deferred reply of a connection."""
        reply = PolledReply(context, poll)
        self._pending.append(reply)
        return reply

    def poll(self) -> None:
        """Build the replies that are due."""
        self._pending = [reply for reply in self._pending if reply() is None]

    def cancel(self, context: ConnectionContext) -> None:
        """Drop the deferred replies of a connection."""
        self._pending = [reply for reply in self._pending if reply.context is not context]


# The server.

_LIMITS: Final = Limits()
# Simulated time between polls of deferred replies, a tenth of a second.
POLL_INTERVAL_PS: Final = PS_PER_S // 10


@dataclass(frozen=True, slots=True)
class Allowed:
    """Permissions of clients and the limits that decide replies (limits.py). Field names are keys in recordings."""

    # End the server with quit_server.
    quit: bool = False
    # Change simulated time with sim_control.
    control: bool = False
    obstacles: int = _LIMITS.obstacles
    graphics: int = _LIMITS.graphics
    frame: int = _LIMITS.frame


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

    def __init__(
        self,
        simulation: Simulation,
        *,
        port: int = 1,
        clock: SimulationClock | None = None,
        allowed: Allowed | None = None,
    ) -> None:
        self.simulation = simulation
        self.port = port
        self.clock = clock or SimulationClock()
        self.allowed = allowed or Allowed()
        # True after a client ended the server.
        self.quitting = False
        self.graphics = Graphics()
        self.traces = Traces()
        self.traces.update(simulation)
        self.transcript = SpeechLog()
        # Arms that were used, by robot.
        self.arms: dict[int, Arm] = {}
        self.axis_ownership = AxisOwnership()
        self.estop = EStop()
        # Worlds that were exported, by their text, so that they can be restored exactly (runtime_settings.py).
        self.exported_worlds: dict[str, World] = {}
        self.pose_requests = PoseRequests()
        # Mask and laser mode of robots' own lines.
        self._serial_wire_states: dict[int, WireState] = {}
        # The last state snapshot of each robot and its time.
        self._snapshots: dict[int, tuple[float, StateSnapshot]] = {}
        self._deferred = DeferredReplies()

    # Time.

    def pass_time(self, seconds: float) -> None:
        """Advance simulated time; deferred replies are built as of the moment they are due."""
        left_ps = to_ps(seconds)
        while left_ps:
            step_ps = min(left_ps, POLL_INTERVAL_PS)
            self.simulation.step(to_s(step_ps))
            self.traces.update(self.simulation)
            for robot_id in self.arms:
                self._advance_arm(robot_id)
            self._deferred.poll()
            left_ps -= step_ps

    @property
    def clock_ms(self) -> int:
        """Simulated milliseconds since the start."""
        return clock_ms(self.simulation.time_s)

    # Deferred replies.

    def defer(self, context: ConnectionContext, poll: DeferredReply) -> DeferredReply:
        """Register a deferred reply; returns one that is built at the moment it is due."""
        return self._deferred.add(context, poll)

    def cancel_deferred(self, context: ConnectionContext) -> None:
        """Drop the deferred replies of a connection."""
        self._deferred.cancel(context)

    # Connections.

    def robot_of(self, context: ConnectionContext) -> SimulatedRobot:
        """Return the robot that a connection is connected to."""
        assert context.robot_id is not None
        return self.simulation.robots[context.robot_id]

    def claim_axes(self, context: ConnectionContext, axes: Iterable[int] = ALL_AXES) -> SimulatedRobot:
        """Make a connection the owner of axes of its robot, and return the robot."""
        assert context.robot_id is not None
        self.axis_ownership.claim(context, context.robot_id, axes)
        return self.robot_of(context)

    def feed_watchdog(self, context: ConnectionContext) -> None:
        """Restart the command timeout (conf_tm) of a connection's robot, unless only other connections move it."""
        assert context.robot_id is not None
        robot = self.robot_of(context)
        if self.axis_ownership.may_feed_watchdog(context, context.robot_id, robot):
            robot.feed()

    def on_disconnect(self, context: ConnectionContext) -> None:
        """Stop what a closed connection set in motion, and drop its pending requests."""
        self.invalidate_state_cache()
        self._deferred.cancel(context)
        self.pose_requests.cancel(context)
        self.axis_ownership.on_disconnect(context, self.simulation.robots)
        for robot_id in self.axis_ownership.release_arms(context):
            self.stop_arm(robot_id)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot and ignore motion commands until it is released. Raise KeyError if there is no such robot."""
        self.simulation.robots[robot_id].stop()
        self.stop_arm(robot_id)
        self.invalidate_state_cache()
        self.estop.engage(robot_id, by)

    def serial_wire_state(self, robot_id: int) -> WireState:
        """Return mask and laser mode in force on a robot's own lines.

        They belong to the robot and outlive connections; after a restore they are as at power-on.
        """
        if robot_id not in self._serial_wire_states:
            model = get_model(self.simulation.robots[robot_id].model.family)
            self._serial_wire_states[robot_id] = serial_wire_state(model)
        return self._serial_wire_states[robot_id]

    # Arms.

    def arm_of(self, context: ConnectionContext) -> Arm:
        """Return the arm of a connection's robot as of now."""
        assert context.robot_id is not None
        self.arms.setdefault(context.robot_id, Arm())
        return self._advance_arm(context.robot_id)

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

        Between two steps a robot changes by commands only, so all connections share one snapshot of it; on a serial
        line, where nothing else enters the packet, they share the reply.
        """
        assert context.robot_id is not None
        robot, now_s = self.simulation.robots[context.robot_id], self.simulation.time_s
        taken_s, snapshot = self._snapshots.get(context.robot_id, (None, None))
        if snapshot is None or taken_s != now_s:
            snapshot = StateSnapshot(robot, self.clock.speed_tenths)
            self._snapshots[context.robot_id] = (now_s, snapshot)
        if not context.wire_state.line:
            return build_state_reply(robot, context, now_s, snapshot)
        cached, mask, mode = context.cached_state, context.wire_state.mask, context.wire_state.laser_mode
        if cached is None or cached.snapshot is not snapshot or cached.mask is not mask or cached.laser_mode != mode:
            reply = build_state_reply(robot, context, now_s, snapshot)
            cached = context.cached_state = CachedStateReply(snapshot, mask, mode, reply)
        return cached.reply

    def invalidate_state_cache(self) -> None:
        """Discard all state snapshots after a change that is not due to time."""
        self._snapshots.clear()

    def layers(self, robot_id: int) -> dict[str, Any]:
        """Return what a robot's window shows as plain data (layers.py). Raise KeyError if there is no such robot."""
        return layers(robot_id, self.simulation.robots[robot_id], self.traces, self.graphics)
