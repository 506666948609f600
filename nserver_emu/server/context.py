"""How simulated time goes along with real time: a value that the daemon follows and `sim_control` changes. No clock.

    real time        factor x the real seconds that passed; factor None: as fast as it can
    paused           time stands until `resume`, but for single steps
    lockstep         time moves by `lockstep_s` when a client asks something, and at no other moment

get_robot_conf: who waits for a pose to be clicked in the window of a robot, and the pose once it is. Pure.

Rules: one click answers all who wait at that robot then. While no page is open that may click, nobody waits: they
are told where the robot is. Who asked and is gone is forgotten.

What the robots were told to say: a talking robot's last words, kept to be read out. Pure.

Answers that only time can bring: who waits for what, asked each time some time has passed.

Rules: an answer is made at the moment it is there, however long its session takes to fetch it; a promise is asked no
more once it is kept, or once whoever waits has gone. No time passes here.

What the commands act upon: the simulation with all that a server adds to it. No wire units, no command by name.

    Stage    simulation | pace | graphics | traces | transcript | arms | who drives which robot | what the setup allows

Rules: handlers change it, the daemon and the viewer read it. Connections come and go; everything else is what a
snapshot keeps, but for what people at a window do: waiting clicks, holds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from nclient.protocol.replies import Reply
from nclient.protocol.types import get_model
from nclient.protocol.wire_state import WireState, serial_wire_state
from nserver_emu.server.graphics import Graphics, Traces
from nserver_emu.server.layers import layers
from nserver_emu.server.limits import Limits
from nserver_emu.server.ownership import ALL_AXES, AxisOwnership, EStop
from nserver_emu.server.session import CachedStateReply, ConnectionContext, DeferredReply
from nserver_emu.server.state_encoder import StateSnapshot, clock_ms, state_reply
from nserver_emu.simulation.arm import Arm
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.segments import PS_PER_S, to_ps, to_s
from nserver_emu.simulation.simulation import Simulation
from worlds.world import World

SLOWEST: Final = 0.1
FASTEST: Final = 999.0
MAX_LOCKSTEP_S: Final = 10.0
"""The longest step in lockstep, simulated seconds."""
AS_FAST_AS_IT_CAN: Final = 9999
"""What State[0] shows where the simulated time runs as fast as it can."""


@dataclass(slots=True)
class SimulationClock:
    """See the head of this file; `factor` within SLOWEST..FASTEST, `lockstep_s` None or above 0."""

    factor: float | None = 1.0
    paused: bool = False
    lockstep_s: float | None = None

    def check(self) -> None:
        """Raises ValueError where this is no pace: a value that came from outside may be anything."""
        steps = (self.factor, SLOWEST, FASTEST), (self.lockstep_s, 0.0, MAX_LOCKSTEP_S)
        for value, low, high in steps:
            if value is not None and (isinstance(value, bool) or not low <= value <= high):
                raise ValueError(f"a pace of {value}")
        if not isinstance(self.paused, bool) or self.lockstep_s == 0.0:
            raise ValueError("a pace that neither passes nor stands")

    @property
    def is_free_running(self) -> bool:
        """Whether time passes by itself."""
        return not self.paused and self.lockstep_s is None

    @property
    def asked_s(self) -> float:
        """Simulated seconds that pass because a client asks something."""
        return 0.0 if self.paused or self.lockstep_s is None else self.lockstep_s

    @property
    def speed_tenths(self) -> int:
        """State[0]: the factor x 10, 0 when paused or in lockstep, 9999 for as fast as it can."""
        if not self.is_free_running:
            return 0
        return AS_FAST_AS_IT_CAN if self.factor is None else round(10 * self.factor)


ClickedPose = tuple[int, int, int, int]
"""x, y, steering and turret in tenths."""


@dataclass(eq=False, slots=True)
class PoseRequest:
    """One who waits."""

    robot_id: int
    context: ConnectionContext
    pose: ClickedPose | None = None


class PoseRequests:
    """See the head of this file. `open`: whether a page is there to click at."""

    def __init__(self) -> None:
        self.open = False
        self._wishes: list[PoseRequest] = []

    def ask(
        self, robot_id: int, context: ConnectionContext, otherwise: Callable[[], ClickedPose]
    ) -> Callable[[], ClickedPose | None]:
        """Wait for a pose of this robot: what to ask again until it gives one. `otherwise`: without a page."""
        wish = PoseRequest(robot_id, context)
        self._wishes.append(wish)

        def clicked() -> ClickedPose | None:
            if wish.pose is None and not self.open:
                self._wishes = [other for other in self._wishes if other is not wish]
                wish.pose = otherwise()
            return wish.pose

        return clicked

    def asked(self) -> dict[int, int]:
        """How many wait, at each robot where somebody does."""
        counts: dict[int, int] = {}
        for wish in self._wishes:
            counts[wish.robot_id] = counts.get(wish.robot_id, 0) + 1
        return counts

    def answer(self, robot_id: int, pose: ClickedPose) -> bool:
        """A pose was clicked; whether anybody waited for it."""
        waiting = [wish for wish in self._wishes if wish.robot_id == robot_id]
        for wish in waiting:
            wish.pose = pose
        self._wishes = [wish for wish in self._wishes if wish.pose is None]
        return bool(waiting)

    def forget(self, context: ConnectionContext) -> None:
        """This connection is gone."""
        self._wishes = [wish for wish in self._wishes if wish.context is not context]


KEPT: Final = 1000
"""Utterances kept; older ones are forgotten, so that a robot that chatters for days fills no memory."""


class Utterance(NamedTuple):
    """Who said what, and at which simulated second."""

    time_s: float
    robot_id: int
    text: str


class Transcript:
    """Utterances in their order, the latest last."""

    def __init__(self) -> None:
        self._said: deque[Utterance] = deque(maxlen=KEPT)

    @property
    def said(self) -> tuple[Utterance, ...]:
        """All that is kept."""
        return tuple(self._said)

    def add(self, utterance: Utterance) -> None:
        """Note what was said now."""
        self._said.append(utterance)


class PolledReply:
    """A Later that holds on to its reply."""

    def __init__(self, context: ConnectionContext, later: DeferredReply) -> None:
        self.context = context
        self.reply: Reply | None = None
        self._later = later

    def __call__(self) -> Reply | None:
        """The reply, if it is there by now."""
        if self.reply is None:
            self.reply = self._later()
        return self.reply


class DeferredReplies:
    """All that is yet to be kept."""

    def __init__(self) -> None:
        self._open: list[PolledReply] = []

    def __len__(self) -> int:
        return len(self._open)

    def make(self, context: ConnectionContext, later: DeferredReply) -> PolledReply:
        """Note that this connection waits for this answer."""
        promise = PolledReply(context, later)
        self._open.append(promise)
        return promise

    def ask(self) -> None:
        """Time has passed: keep those that can be kept."""
        self._open = [promise for promise in self._open if promise() is None]

    def drop(self, context: ConnectionContext) -> None:
        """This connection no longer waits."""
        self._open = [promise for promise in self._open if promise.context is not context]


_LIMITS: Final = Limits()
PIECE_PS: Final = PS_PER_S // 10
"""The longest time that passes before those who wait for it are asked, a tenth of a second."""


@dataclass(frozen=True, slots=True)
class Allowed:
    """What clients may do beyond driving robots: end the server (`quit`), change the time (`control`); and the limits
    that decide answers (limits.py)."""

    quit: bool = False
    control: bool = False
    obstacles: int = _LIMITS.obstacles
    graphics: int = _LIMITS.graphics
    frame: int = _LIMITS.frame


class ServerState:
    """See the head of this file. `port` is what CONNECT answers; `quitting` is set once a client ended the server."""

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
        self.quitting = False
        self.graphics = Graphics()
        self.traces = Traces()
        self.traces.note(simulation)
        self.transcript = Transcript()
        self.arms: dict[int, Arm] = {}
        self.axis_ownership = AxisOwnership()
        self.estop = EStop()
        self.shown: dict[str, World] = {}
        """Worlds whose text was told to somebody, who may want to have them back (switches.py)."""
        self._serial_wire_states: dict[int, WireState] = {}
        self.pose_requests = PoseRequests()
        self._looked: dict[int, tuple[float, StateSnapshot]] = {}
        self._promises = DeferredReplies()

    def on_disconnect(self, context: ConnectionContext) -> None:
        """A connection is gone: what moves by its commands stops."""
        self.invalidate_state_cache()
        self._promises.drop(context)
        self.pose_requests.forget(context)
        self.axis_ownership.on_disconnect(context, self.simulation.robots)
        for robot_id in self.axis_ownership.release_arms(context):
            self.stop_arm(robot_id)

    def hold(self, robot_id: int, by: str) -> None:
        """Stop a robot, and let nobody move it until it is released (holds.py). Raises KeyError for no robot."""
        self.simulation.robots[robot_id].stop()
        self.stop_arm(robot_id)
        self.invalidate_state_cache()
        self.estop.put(robot_id, by)

    def pass_time(self, seconds: float) -> None:
        """Let simulated time pass, for whatever reason; who waits for it is answered as of the moment it is due."""
        left_ps = to_ps(seconds)
        while left_ps:
            piece_ps = min(left_ps, PIECE_PS)
            self.simulation.step(to_s(piece_ps))
            self.traces.note(self.simulation)
            for robot_id in self.arms:
                self._arm(robot_id)
            self._promises.ask()
            left_ps -= piece_ps

    def promise(self, context: ConnectionContext, later: DeferredReply) -> DeferredReply:
        """The same answer, made at the moment it is there even if nobody asks for it then."""
        return self._promises.make(context, later)

    def cancel_deferred(self, context: ConnectionContext) -> None:
        """This connection is told no more of what it waited for."""
        self._promises.drop(context)

    def invalidate_state_cache(self) -> None:
        """Something changed other than by time: no look at a robot is still good."""
        self._looked.clear()

    def robot_of(self, context: ConnectionContext) -> SimulatedRobot:
        """The robot that this connection talks to."""
        assert context.robot_id is not None
        return self.simulation.robots[context.robot_id]

    def feed(self, context: ConnectionContext) -> None:
        """A connection asks something, or waits: the time-out of its robot begins anew, unless only others drive it."""
        assert context.robot_id is not None
        robot = self.robot_of(context)
        if self.axis_ownership.may_feed_watchdog(context, context.robot_id, robot):
            robot.feed()

    def drive(self, context: ConnectionContext, axes: Iterable[int] = ALL_AXES) -> SimulatedRobot:
        """The robot, these axes of it from now on obeying this connection."""
        assert context.robot_id is not None
        self.axis_ownership.take(context, context.robot_id, axes)
        return self.robot_of(context)

    def serial_wire_state(self, robot_id: int) -> WireState:
        """Mask and laser mode in force on a robot's own lines: the robot's, whoever asks by which of them, and after
        he has left. As at power-on in a simulation that is restored."""
        if robot_id not in self._serial_wire_states:
            family = self.simulation.robots[robot_id].model.family
            self._serial_wire_states[robot_id] = serial_wire_state(get_model(family))
        return self._serial_wire_states[robot_id]

    def arm_of(self, context: ConnectionContext) -> Arm:
        """The arm of the connection's robot, as it is now."""
        assert context.robot_id is not None
        self.arms.setdefault(context.robot_id, Arm())
        return self._arm(context.robot_id)

    def stop_arm(self, robot_id: int) -> None:
        """An arm stops, where that robot has one that was ever moved."""
        if robot_id in self.arms:
            self._arm(robot_id).stop()

    def _arm(self, robot_id: int) -> Arm:
        """An arm as it is now; the robot's time-out has stopped it when it struck."""
        arm, struck_s = self.arms[robot_id], self.simulation.robots[robot_id].timed_out_s
        if struck_s is not None and arm.time_s < struck_s:
            arm.advance_to(struck_s)
            arm.stop()
        arm.advance_to(self.simulation.time_s)
        return arm

    def state(self, context: ConnectionContext) -> Reply:
        """The state reply that most commands answer with.

        Between two steps a robot changes by commands only, so many who ask cost one look at it; on a line they get
        the same reply.
        """
        assert context.robot_id is not None
        robot, now_s = self.simulation.robots[context.robot_id], self.simulation.time_s
        looked_s, look = self._looked.get(context.robot_id, (None, None))
        if look is None or looked_s != now_s:
            look = StateSnapshot(robot, self.clock.speed_tenths)
            self._looked[context.robot_id] = (now_s, look)
        if not context.wire_state.line:
            return state_reply(robot, context, now_s, look)
        told, mask, mode = context.told, context.wire_state.mask, context.wire_state.laser_mode
        if told is None or told.look is not look or told.mask is not mask or told.laser_mode != mode:
            told = context.told = CachedStateReply(look, mask, mode, state_reply(robot, context, now_s, look))
        return told.reply

    def layers(self, robot_id: int) -> dict[str, Any]:
        """What the window of a robot shows now, as plain data (layers.py). Raises KeyError for no robot."""
        return layers(robot_id, self.simulation.robots[robot_id], self.traces, self.graphics)

    @property
    def clock_ms(self) -> int:
        """Simulated milliseconds since the start."""
        return clock_ms(self.simulation.time_s)
