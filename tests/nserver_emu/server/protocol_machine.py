"""A state machine over the raw protocol: three clients, two robots, faults and the gateway, in simulated time.

Bytes go through the daemon's own connections, over transports in this process; the event loop's clock is moved by hand,
so that nothing sleeps. What must hold after every step is computed here from what was executed, not from the server:

    owner gone     an axis stands still once the connection that commanded it last is closed
    time-out       nothing moves when those who drive have been silent for longer than conf_tm
    replies        each connection gets the replies to its own requests, in order, with its own robot's state
    motion         encoders and motor bits agree with the motion; no axis is faster than it can be
    bumpers        set exactly in contact, by the distance to walls and robots
    hold           a robot under emergency stop does not move
"""

from __future__ import annotations

import argparse
import asyncio
import functools
import itertools
import json
import logging
import selectors
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from math import hypot, isclose
from typing import Any, ClassVar

from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from nclient.faults.plan import Delay, HangUp, Plan, Rule, When
from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import BY_NAME, ERROR_TYPE, REPLY_TYPES, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, Mask, get_model, tcp_wire_state
from nserver_emu.control.commands import answer_line
from nserver_emu.gateway.gateway import Gateway, RealRobotProxy
from nserver_emu.server.connection import TcpConnection
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.estop import MOTIONS, moves
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import FaultController
from nserver_emu.server.server_state import TIMELESS, Allowed, StateSnapshot, state_slots
from nserver_emu.server.session import NOT_CONNECTED, REFUSED, CommandHandler, ConnectionContext, DeferredReply
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.robot import SimulatedRobot
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.gateway.harness import EmulatedLine
from worlds.io import parse_world
from worlds.world import StartPose

WORLD = parse_world(
    """
    [[room]]
    corners_in = [[0, 0], [240, 0], [240, 150], [0, 150]]
    [[obstacle]]
    corners_in = [[100, 90], [130, 90], [130, 120]]
    """,
    "machine.toml",
    "machine",
)
# Far enough apart that neither robot touches anything at its start, near enough that both meet within some steps.
STARTS = {1: StartPose(40.0, 40.0), 2: StartPose(120.0, 40.0)}
STEP_S = 0.05
PORT = 7019
# Contacts are located to this; exactly there both answers are right.
TOUCH_IN, UNSURE_IN = 1e-3, 1e-4

AXES = (0, 1, 2)
# The mask of a state that has velocities, and the motor bits, which none excludes.
MOTION = Mask((*[0] * 38, 1, 1, 1, *[0] * 3))
RESETTING = frozenset({"zr", "dp", "da", "place_robot"})
"""Commands after which counts or coordinates of the encoders begin anew."""

# Tenths per second: beyond the top speed of translation, 20 in/s, so that clamping is tested.
velocity = st.integers(-300, 300)
distance = st.integers(-900, 900)
flag = st.integers(0, 1)
far, high = st.integers(0, 2400), st.integers(0, 1500)


def corners(x: int, y: int, size: int) -> tuple[int, ...]:
    return (3, x, y, x + size, y, x, y + size)


obstacle = st.builds(corners, far, high, st.integers(50, 400))
CALLS: dict[str, st.SearchStrategy[tuple[int, ...]]] = {
    # Durations are short (ws at most 3 s, conf_tm at most 2 s), so that waits and timeouts end within a few steps.
    "vm": st.tuples(velocity, velocity, velocity),
    "pr": st.tuples(distance, distance, distance),
    "pa": st.tuples(distance, distance, distance),
    "mv": st.tuples(st.integers(0, 5), velocity, st.integers(0, 5), velocity, st.integers(0, 5), velocity),
    "sp": st.tuples(st.integers(10, 250), st.integers(10, 500), st.integers(10, 500)),
    "ws": st.tuples(flag, flag, flag, st.integers(0, 3)),
    "conf_tm": st.tuples(st.integers(0, 2)),
    "dp": st.tuples(distance, distance),
    "da": st.tuples(st.integers(0, 3599), st.integers(0, 3599)),
    "place_robot": st.tuples(far, high, st.integers(0, 3599), st.integers(0, 3599)),
    "add_obstacle": obstacle,
    "delete_obstacle": obstacle,
    "draw_line": st.tuples(far, high, far, high, flag),
} | {
    name: st.just(())
    for name in ("st", "gs", "lp", "zr", "get_rc", "get_rv", "get_bp", "get_sn", "get_rpx", "sim_truth", "new_world",
                 "real_robot", "simulated_robot", "quit_server", "get_robot_conf")
}  # fmt: skip


def calls(*names: str) -> st.SearchStrategy[Call]:
    """Return a strategy of calls of these names, each as often."""
    return st.one_of([st.builds(Call, st.just(name), CALLS[name]) for name in names])


motion = calls("vm", "vm", "pr", "pa", "mv", "st")
look = calls("gs", "gs", "get_rc", "get_bp", "get_sn", "ws")
anything = calls(*CALLS)
client = st.integers(0, 2)
PLANS = {
    # One plan that delays replies and one that closes connections in mid-reply.
    "none": Plan(),
    "late": Plan((Rule("late", (Delay(0.3),), commands=("gs", "vm")),)),
    "hang up": Plan((Rule("gone", (HangUp(3),), When(every=4), commands=("get_rc", "gs")),)),
}


class NoFiles(selectors.SelectSelector):
    """Watch nothing: all bytes come from this process, and a turn needs no system call."""

    def select(self, _timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        return []


class ManualLoop(asyncio.SelectorEventLoop):
    """An event loop whose clock stands still until it is moved."""

    now_s = 1000.0

    def __init__(self) -> None:
        super().__init__(NoFiles())

    def time(self) -> float:
        return self.now_s

    def turns(self, count: int) -> None:
        """Run so many turns."""
        for _ in range(count):
            # `stop` is queued behind the callbacks that are ready now, so `run_forever` runs exactly these, one turn.
            self.call_soon(self.stop)
            self.run_forever()


def distance_to_segment(x: float, y: float, x1: float, y1: float, x2: float, y2: float) -> float:
    """Return the distance of a point to a segment, by the foot of the perpendicular."""
    along_x, along_y = x2 - x1, y2 - y1
    squared = along_x * along_x + along_y * along_y
    fraction = min(max(((x - x1) * along_x + (y - y1) * along_y) / squared, 0.0), 1.0) if squared else 0.0
    return hypot(x - x1 - fraction * along_x, y - y1 - fraction * along_y)


class Socket:
    """Takes options."""

    def setsockopt(self, *_: object) -> None:
        """Do nothing."""


class Peer(asyncio.Transport):
    """A client's connection: the transport of the server's end, and what the client has sent and received."""

    def __init__(self, loop: ManualLoop, daemon: Daemon, host: str, port: int) -> None:
        super().__init__({"peername": (host, port), "socket": Socket()})
        self._loop = loop
        self._waiting = b""
        self._reads = True
        self.host = host
        self.closing = self.closed = False
        self.received = bytearray()
        self.sent: deque[str] = deque()
        self.wire_state = tcp_wire_state(N150)
        self.framer = TcpFramer(reply_bounds, wide=False)
        self.connection = TcpConnection(daemon)
        self.connection.connection_made(self)

    # The server's end.

    def write(self, data: bytes | bytearray | memoryview[Any]) -> None:
        if not self.closing:
            self.received += data

    def set_write_buffer_limits(self, high: int | None = None, low: int | None = None) -> None:
        pass

    def is_closing(self) -> bool:
        return self.closing

    def pause_reading(self) -> None:
        self._reads = False

    def resume_reading(self) -> None:
        self._reads = True
        if self._waiting:
            self._loop.call_soon(self._deliver)

    def close(self) -> None:
        # As in asyncio, `connection_lost` is called in a later turn, not inside `close`.
        if not self.closing:
            self.closing = True
            self._loop.call_soon(self._lose)

    abort = close

    def _lose(self) -> None:
        self.closed = True
        self.connection.connection_lost(None)

    def _deliver(self) -> None:
        if self._reads and not self.closing and self._waiting:
            # At most 4096 bytes a turn, the size of the connection's receive buffer; the rest follows in later turns.
            data, self._waiting = self._waiting[:4096], self._waiting[4096:]
            self.connection.get_buffer(-1)[: len(data)] = data
            self.connection.buffer_updated(len(data))
            self._loop.call_soon(self._deliver)

    # The client's end.

    @property
    def context(self) -> ConnectionContext:
        return self.connection.session.context

    def send(self, made: Call) -> None:
        self.sent.append(made.name)
        # The client's own view of mask and laser mode, from which it derives the layout of replies.
        codec.update_from_request(made, self.wire_state)
        self.send_bytes(codec.encode_tcp_request(made))

    def send_bytes(self, data: bytes) -> None:
        self._waiting += data
        self._loop.call_soon(self._deliver)


class Witness:
    """Between the connections and their handler: notes what is executed, and with which result."""

    def __init__(self, handler: CommandHandler, machine: ProtocolMachine) -> None:
        self._handler, self._machine = handler, machine

    def answer(self, made: Call, context: ConnectionContext) -> Reply | DeferredReply:
        # The model is updated before and after the handler, so that both see the state of the simulation at that
        # time.
        self._machine.before_call(made, context)
        reply = self._handler.answer(made, context)
        self._machine.after_call(made, context, reply)
        if isinstance(reply, Reply):
            return reply

        # A deferred reply is polled until it exists. Each poll counts as activity: a client that waits cannot send.
        def poll() -> Reply | None:
            self._machine.note_alive(context)
            return reply()

        return poll

    def on_disconnect(self, context: ConnectionContext) -> None:
        self._machine.gone.add(context)
        self._handler.on_disconnect(context)

    def hold(self, robot_id: int, by: str) -> None:
        self._handler.hold(robot_id, by)


class Watched:
    """A robot, who drives it, and its last observation."""

    def __init__(self, simulation: Simulation, number: int) -> None:
        self.simulation, self.number = simulation, number
        self.owners: list[ConnectionContext | None] = [None, None, None]
        self.timeout_s = 0.0
        self.fed_s = 0.0
        # True if a command came since the last observation, or one that begins counts anew; True until the latter.
        self.commanded = self.reset = False
        self.has_true_encoders = True
        self.observe()

    @property
    def robot(self) -> SimulatedRobot:
        return self.simulation.robots[self.number]

    def drivers(self) -> set[ConnectionContext]:
        """Return the connections whose axes move."""
        owners = zip(self.owners, self.robot.moving, strict=True)
        return {owner for owner, is_moving in owners if is_moving and owner is not None}

    def observe(self) -> None:
        """Remember what there is now."""
        robot = self.robot
        self.time_s, self.counts, self.velocities, self.moved = (
            self.simulation.time_s, robot.counts, robot.velocities, robot.moving,
        )  # fmt: skip
        self.actual = robot.actual
        # A search for zero begins the counts anew when it ends.
        self.commanded = self.reset = robot.zeroing


class ProtocolMachine(RuleBasedStateMachine):
    """Rules are what clients and the operator do; `gateway` puts a real robot behind robot 1."""

    steps: ClassVar[int] = 0
    """Steps of all machines."""

    @initialize(gateway=st.booleans(), model=st.sampled_from(["n150", "n200", "scout"]))
    def begin(self, gateway: bool, model: str) -> None:
        # 1. Simulation and daemon on a loop that stands still.
        self.loop = ManualLoop()
        self.gone: set[ConnectionContext] = set()
        self.states: dict[ConnectionContext, deque[list[int] | None]] = {}
        simulation = Simulation(WORLD)
        simulation.add_robot(1, STARTS[1], MODELS["n150" if gateway else model])
        simulation.add_robot(2, STARTS[2], MODELS["n150"])
        self.emulator = Emulator(simulation, port=PORT, allowed=Allowed(control=True))
        self.emulator.clock.lockstep_s = STEP_S
        self.watched = {number: Watched(simulation, number) for number in simulation.robots}
        # 2. The gateway: a second simulation behind a line stands for the real robot.
        handler: CommandHandler = self.emulator
        self.proxy: RealRobotProxy | None = None
        if gateway:
            real = Simulation(WORLD)
            real.add_robot(1, STARTS[1], MODELS["n150"])
            line = EmulatedLine(Emulator(real), get_model("n150"), STEP_S)
            self.proxy = RealRobotProxy(lambda: line, self.loop.time)
            self.gateway = Gateway(self.emulator, {1: self.proxy})
            handler, self.watched[1] = self.gateway, Watched(real, 1)
        # 3. The daemon, created while the loop runs.
        self.daemon = self.call_in_loop(
            lambda: Daemon(self.emulator, None, Witness(handler, self), FaultController(self.loop.time))
        )
        self.has_had_faults = False
        self.peers: list[Peer | None] = [None, None, None]
        self.others: list[Peer] = []
        self.ports = 40_000
        self.pump()

    def call_in_loop(self, function: Callable[[], Any]) -> Any:
        """Call a function while the loop runs, and return its result."""
        found: list[Any] = []
        self.loop.call_soon(lambda: found.append(function()))
        self.loop.turns(1)
        return found[0]

    # Rules: clients

    @rule(number=client, robot=st.sampled_from([1, 2, 1, 2, 3]))
    def connect(self, number: int, robot: int) -> None:
        peer = self.peers[number]
        if peer is None:
            peer = self.peers[number] = self.open_peer(number)
        # The second argument is the client's process id; any number but 0 is valid.
        peer.send(Call("connect_robot", (robot, 100 + number)))
        self.pump()

    @rule(number=client, made=motion)
    def drive(self, number: int, made: Call) -> None:
        self.peer_of(number).send(made)
        self.pump()

    @rule(number=client, made=look)
    def watch(self, number: int, made: Call) -> None:
        self.peer_of(number).send(made)
        self.pump()

    @rule(number=client, made=anything)
    def request(self, number: int, made: Call) -> None:
        self.peer_of(number).send(made)
        self.pump()

    @rule(number=client, made=st.lists(motion | look | anything, min_size=2, max_size=5))
    def pipeline(self, number: int, made: list[Call]) -> None:
        peer = self.peer_of(number)
        for each in made:
            peer.send(each)
        self.pump()

    @rule(number=client, how=st.sampled_from(["close", "disconnect", "in mid-request"]), made=motion)
    def leave(self, number: int, how: str, made: Call) -> None:
        peer = self.peer_of(number)
        peer.send(made)
        self.pump()
        if how == "disconnect":
            peer.send_bytes(codec.encode_tcp_request(Call("disconnect_robot", (1, 100))))
        else:
            # Without DISCONNECT, optionally with the last three bytes of a request missing.
            if how == "in mid-request":
                peer.send_bytes(codec.encode_tcp_request(made)[:-3])
                self.loop.turns(2)
            peer.close()
        self.pump()

    @rule(data=st.binary(min_size=4, max_size=40))
    def send_nonsense(self, data: bytes) -> None:
        # Over a connection of its own, from an address of its own: no client continues it.
        peer = self.open_peer(7)
        peer.send_bytes(data)
        self.pump()
        peer.close()
        self.pump()

    @rule(number=client, made=st.sampled_from([Call("gs"), Call("st"), Call("vm", (50, 0, 0))]), closes=st.booleans())
    def continue_over_second_connection(self, number: int, made: Call, closes: bool) -> None:
        # Closed connections of the address are forgotten first, so that there is one to continue.
        first = self.peer_of(number)
        self.pass_time(0.3)
        if not first.closed and not any(peer.host == first.host for peer in self.others):
            second = self.open_peer(number)
            self.others.append(second)
            # The first may have a CONNECT to another robot waiting behind `ws`, which is executed before or after this,
            # or a DISCONNECT waiting for the real robot, after which there is no robot to continue with.
            before = first.context.robot_id
            second.send(made)
            self.pump()
            allowed = (before, first.context.robot_id, None) if first.closed else (before, first.context.robot_id)
            assert second.closed or self.has_had_faults or second.context.robot_id in allowed
        for peer in self.others if closes else ():
            peer.close()
        self.pump()

    @rule(number=client, seconds=st.sampled_from([0.0, 0.4]))
    def stop_reading(self, number: int, seconds: float) -> None:
        peer = self.peer_of(number)
        # `pause_writing` is what asyncio calls when the client leaves too many replies unread.
        self.call_in_loop(peer.connection.pause_writing)
        peer.send(Call("gs"))
        self.pass_time(seconds)
        if not peer.closed:
            self.call_in_loop(peer.connection.resume_writing)
        self.pump()

    # Rules: time, faults, the operator

    @rule(dt_s=st.sampled_from([0.01, 0.1, 0.35, 1.0]))
    def pass_time(self, dt_s: float) -> None:
        """Real time passes: late bytes arrive, and waiting clients get their steps."""
        self.loop.now_s += dt_s
        self.pump(clock=True)

    @rule(dt_s=st.sampled_from([0.01, 0.5, 2.5]))
    def step(self, dt_s: float) -> None:
        self.control("step", dt_s)
        self.pump()

    @rule(seconds=st.sampled_from([0.0, 0.5]), made=motion, number=client)
    def pause(self, seconds: float, made: Call, number: int) -> None:
        # A motion that arrives while time stands still starts with the next step.
        self.control("pause")
        self.peer_of(number).send(made)
        self.pump()
        self.control("step", seconds)
        self.control("resume")
        self.pump()

    @rule(number=client, observer=client, robot=st.sampled_from([1, 2]), made=motion)
    def fall_silent(self, number: int, observer: int, robot: int, made: Call) -> None:
        """Drive with a time-out, then send nothing, while another client looks on."""
        for each in (number, observer):
            self.connect(each, robot)
        self.peer_of(number).send(Call("conf_tm", (1,)))
        self.peer_of(number).send(made)
        self.pump()
        # Six steps of 0.25 s, longer than the timeout of 1 s; the queries of the observer must not restart it.
        for _ in range(6):
            self.control("step", 0.25)
            self.peer_of(observer).send(Call("gs"))
            self.pump()
            self.silent_drivers_are_stopped()

    @rule(number=st.sampled_from([1, 2, None]), made=st.lists(motion, max_size=3), by=client, released=st.booleans())
    def hold(self, number: int | None, made: list[Call], by: int, released: bool) -> None:
        self.control("stop", number)
        self.pipeline(by, made)
        self.held_robots_stand()
        if released:
            self.control("release")
            self.pump()

    @rule(corners_in=st.tuples(st.integers(0, 200), st.integers(0, 120)))
    def put_obstacle(self, corners_in: tuple[int, int]) -> None:
        x, y = corners_in
        self.control("obstacle", {"put": [[x, y], [x + 20, y], [x, y + 20]]}, may_fail=True)
        self.pump()

    @rule(name=st.sampled_from(sorted(PLANS)))
    def inject(self, name: str) -> None:
        self.has_had_faults = True
        self.daemon.faults.put(PLANS[name], self.daemon.lines())
        self.pump()

    # How steps run

    def peer_of(self, number: int) -> Peer:
        """Return the connection of a client, opened and connected to a robot if there is none."""
        if (peer := self.peers[number]) is None:
            self.connect(number, 1 + number % 2)
            peer = self.peers[number]
        return peer or self.peer_of(number)

    def open_peer(self, number: int) -> Peer:
        self.ports += 1
        peer: Peer = self.call_in_loop(lambda: Peer(self.loop, self.daemon, f"10.0.0.{number}", self.ports))
        return peer

    def control(self, command: str, argument: object = None, may_fail: bool = False) -> None:
        line = json.dumps({"command": command, "argument": argument}).encode()
        answer = json.loads(self.call_in_loop(lambda: answer_line(self.daemon, line)))
        assert answer["ok"] or may_fail, answer

    def pump(self, *, clock: bool = False) -> None:
        """Run the loop until nothing happens any more, and read the replies."""
        before = -1
        # A turn may cause work for the next one, so turns are run until no request is answered any more.
        while before != (before := self.progress()):
            self.loop.turns(3)
            if self.proxy is not None:
                self.call_in_loop(self.run_gateway)
        if clock:
            self.call_in_loop(lambda: self.daemon._advance(0.01))
            self.loop.turns(3)
            if self.proxy is not None:
                self.call_in_loop(self.run_gateway)
        # Replies are read here and compared with what was recorded when their requests were executed.
        for peer in [*self.peers, *self.others]:
            if peer is not None:
                self.read(peer)
        self.peers = [None if peer is None or peer.closed else peer for peer in self.peers]
        self.others = [peer for peer in self.others if not peer.closed]

    def progress(self) -> int:
        """Return the number of requests answered."""
        answered = sum(connection.session.answered for connection in self.daemon.connections)
        return int(answered + self.daemon.closed_answered)

    def run_gateway(self) -> None:
        assert self.proxy is not None
        # Until two rounds found nothing to do: the second sees what the ticks of the first have caused.
        idle = 0
        for _ in range(20):
            idle += 1
            while self.proxy.robot.run_next() == 0.0:
                idle = 0
            self.gateway.tick()
            self.daemon.tick()
            if idle == 2:
                break

    # What is executed

    def watched_by(self, context: ConnectionContext) -> Watched | None:
        """Return the robot that a connection's commands go to; None if there is none."""
        robot_id = context.robot_id
        # While robot 1 of the gateway is switched to its simulation, its commands reach no watched robot.
        if robot_id == 1 and self.proxy is not None and not self.proxy.active:
            return None
        return None if robot_id is None else self.watched[robot_id]

    def before_call(self, made: Call, context: ConnectionContext) -> None:
        if made.name not in TIMELESS:
            self.note_alive(context)
        # An observer must neither get nor move a real robot that another connection owns.
        self.is_foreign = (
            self.proxy is not None and context.robot_id == 1 and self.proxy.active and made.name in MOTIONS
            and self.proxy.ownership.owner not in (None, context)
        )  # fmt: skip

    def note_alive(self, context: ConnectionContext) -> None:
        """Note a request, or waiting for a reply, of one who may keep the robot moving."""
        watched = self.watched_by(context)
        if watched is not None and (not watched.drivers() or context in watched.drivers()):
            watched.fed_s = watched.simulation.time_s + STEP_S

    def after_call(self, made: Call, context: ConnectionContext, reply: Reply | DeferredReply) -> None:
        refused = isinstance(reply, Reply) and reply.kind == "error"
        if self.is_foreign and moves(made) and not self.emulator.estop.get(1):
            assert isinstance(reply, Reply), made
            assert reply == Reply("error", values=(REFUSED,)) or refused, made
        states = self.states.setdefault(context, deque())
        is_state = isinstance(reply, Reply) and reply.kind == "state"
        robot_id = context.robot_id
        states.append(state_slots(self.emulator.simulation.robots[robot_id], 0) if is_state and robot_id else None)
        if (watched := self.watched_by(context)) is None or refused:
            return
        # 1. Who drives which axis.
        # Modes 1, 2 and 3 of mv move an axis or release it; 0, 4 and 5 do not, and do not make the client its owner.
        axes = [axis for axis in AXES if made.name == "mv" and made.args[2 * axis] in (1, 2, 3)]
        if made.name in ("vm", "pr", "pa", "st", "lp", "zr"):
            axes = list(AXES)
        for axis in axes:
            watched.owners[axis] = context
        # 2. Time-out and encoders.
        if axes or made.name in ("dp", "da", "place_robot") or (made.name == "conf_tm" and not watched.timeout_s):
            watched.fed_s = watched.simulation.time_s
        if made.name == "conf_tm":
            # A shorter one may be over already: it takes effect from now.
            watched.timeout_s = max(0, made.args[0])
            watched.fed_s = max(watched.fed_s, watched.simulation.time_s - watched.timeout_s)
        watched.commanded |= bool(axes) or made.name in ("sp", "real_robot", "simulated_robot", *RESETTING)
        watched.reset |= made.name in RESETTING
        watched.has_true_encoders &= made.name not in RESETTING

    # Replies

    def read(self, peer: Peer) -> None:
        """Check the replies that have arrived at a client."""
        data = bytes(peer.received)
        peer.received.clear()
        for frame in peer.framer.receive(data):
            assert isinstance(frame, TcpFrame), frame
            assert peer.sent, f"a reply to nothing: {frame}"
            # One reply per request, in order: the reply belongs to the oldest request without one.
            name = peer.sent.popleft()
            row = BY_NAME[name]
            assert frame.type in (ERROR_TYPE, REPLY_TYPES[row.tcp_reply]), (name, frame)
            reply = codec.decode_tcp_reply(row, frame, peer.wire_state)
            # The handler recorded one entry per executed request; requests before CONNECT are answered by the session
            # alone.
            states = self.states.get(peer.context)
            is_executed = reply != Reply("error", values=(NOT_CONNECTED,))
            state = states.popleft() if states and is_executed else None
            if reply.kind == "state" and state is not None:
                # Sensors, pose, velocities and motor bits of this client's robot when the request was executed.
                assert [reply.slots[slot] for slot in range(1, 42)] == state[1:42], name
            if name == "connect_robot":
                assert reply.values in ((PORT,), (0,))

    # Invariants

    @invariant()
    def encoders_and_motor_bits_agree_with_motion(self) -> None:
        ProtocolMachine.steps += 1
        for watched in self.watched.values():
            # 1. What may have changed since the last observation is bounded by the time that has passed.
            robot, span_s = watched.robot, watched.simulation.time_s - watched.time_s
            slots = StateSnapshot(robot, 0).slots(MOTION)
            # 2. Bit k of State[41] is set exactly while axis k moves.
            assert slots[41] & 0b111 == sum(bit << axis for axis, bit in enumerate(robot.moving))
            # 3. Each axis: no faster than its top speed, velocity 0 at rest, and counts that agree with the velocity.
            for axis in AXES:
                travelled = robot.counts[axis] - watched.counts[axis]
                limit = robot.model.axes[axis].top_speed
                assert abs(robot.velocities[axis]) <= limit + 1e-9
                assert robot.moving[axis] or robot.velocities[axis] == 0.0
                assert robot.moving[axis] or slots[38 + axis] == 0
                if watched.reset:
                    continue
                assert abs(travelled) <= limit * span_s + 1e-6
                # Without a command an axis at rest stays at rest, and a moving one travels velocity x time.
                if not watched.commanded and not watched.moved[axis]:
                    assert travelled == 0.0
                if not watched.commanded and robot.moving[axis]:
                    expected = watched.velocities[axis] * span_s
                    assert robot.zeroing or abs(travelled - expected) < 1e-6
            # 4. The robot itself moves no farther than its fastest axis allows.
            if not watched.reset:
                moved_in = hypot(robot.actual.x_in - watched.actual.x_in, robot.actual.y_in - watched.actual.y_in)
                assert moved_in <= max(axis.top_speed for axis in robot.model.axes) * span_s + 1e-6
            # 5. Without noise, dp and da the encoders and the actual pose are the same.
            if watched.has_true_encoders:
                for counted, actual in zip(robot.encoder[:3], robot.actual[:3], strict=True):
                    assert isclose(counted, actual, rel_tol=1e-5, abs_tol=1e-6)
            watched.observe()

    @invariant()
    def bumpers_show_contact(self) -> None:
        for watched in self.watched.values():
            robot, world = watched.robot, watched.simulation.world
            x, y, radius_in = robot.disc
            # The oracle: distance from the robot's disc to the nearest wall or other robot.
            gap = min(distance_to_segment(x, y, *wall) for wall in world.walls.tolist()) - radius_in
            for number, other in watched.simulation.robots.items():
                if number != watched.number:
                    other_x, other_y, other_radius_in = other.disc
                    gap = min(gap, hypot(x - other_x, y - other_y) - radius_in - other_radius_in)
            assert gap > -TOUCH_IN - UNSURE_IN
            if abs(gap - TOUCH_IN) > UNSURE_IN:
                assert (robot.bumpers != 0) == (gap < TOUCH_IN), gap

    @invariant()
    def robots_without_driver_stand(self) -> None:
        for watched in self.watched.values():
            for owner, is_moving in zip(watched.owners, watched.robot.moving, strict=True):
                assert not (is_moving and owner in self.gone)

    @invariant()
    def silent_drivers_are_stopped(self) -> None:
        # A client that waits for a deferred reply (ws, zr) restarts the timeout as long as it waits.
        waiting = {peer.context for peer in (*self.peers, *self.others) if peer and peer.connection.session.waiting}
        for number, watched in self.watched.items():
            if number == 1 and self.proxy is not None:
                continue  # the proxy feeds it
            drivers, now_s = watched.drivers(), watched.simulation.time_s
            if waiting & drivers or not drivers or watched.robot.zeroing:
                watched.fed_s = now_s
            assert not (watched.timeout_s and drivers and now_s - watched.fed_s > watched.timeout_s + 1e-6)

    @invariant()
    @precondition(lambda self: self.emulator.estop.as_dict())
    def held_robots_stand(self) -> None:
        for number, watched in self.watched.items():
            if self.emulator.estop.get(number):
                assert not any(watched.robot.moving)

    def teardown(self) -> None:
        if hasattr(self, "loop"):
            self.loop.close()


def run_batch(seed_number: int, batch: int) -> int:
    """Run one batch of examples, whose choices follow from the two numbers, and return its steps."""
    ProtocolMachine.steps = 0
    run_state_machine_as_test(
        seed(f"{seed_number} {batch}")(ProtocolMachine),
        # Long examples: the daemon is created less often. Longer ones would fill the room with obstacles.
        settings=settings(
            max_examples=15, stateful_step_count=150, deadline=None, database=None, print_blob=True,
            phases=[Phase.generate, Phase.shrink], suppress_health_check=list(HealthCheck),
        ),
    )  # fmt: skip
    return ProtocolMachine.steps


def main() -> None:
    """Run the machine for a number of steps, in batches, and report progress."""
    parser = argparse.ArgumentParser(description=str(main.__doc__))
    parser.add_argument("--steps", type=int, default=1_000_000, help="number of steps of all jobs (default 1,000,000)")
    parser.add_argument("--jobs", type=int, default=1, help="processes that share the steps (default 1)")
    parser.add_argument("--seed", type=int, help="repeat the choices of a run; default: new ones")
    wanted = parser.parse_args()
    seed_number = time.time_ns() if wanted.seed is None else wanted.seed
    print(f"--seed {seed_number}", flush=True)
    begin_s, steps, batches = time.monotonic(), 0, itertools.count()
    initializer = functools.partial(logging.disable, logging.CRITICAL)
    with ProcessPoolExecutor(wanted.jobs, initializer=initializer) as pool:
        running = {pool.submit(run_batch, seed_number, next(batches)) for _ in range(wanted.jobs)}
        while running:
            done, running = wait(running, return_when=FIRST_COMPLETED)
            # A violation ends the run here, with the shortest sequence of steps that shows it.
            steps += sum(batch.result() for batch in done)
            if steps < wanted.steps:
                running |= {pool.submit(run_batch, seed_number, next(batches)) for _ in done}
            print(f"{steps} steps in {time.monotonic() - begin_s:.0f} s, no violation", flush=True)


if __name__ == "__main__":
    main()
