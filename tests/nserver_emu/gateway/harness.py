"""Stand-ins for real robots in the gateway's tests, in this process.

    ScriptedRobot      a backend with scripted answers, errors and disconnections
    EmulatedLine       the serial line of an emulated robot: each exchange is encoded and decoded
    GatewayHarness     a gateway with one real robot, without a thread
    GatewayClient      a client session on it: `ask` runs the gateway until there is a reply
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nclient.backends.base import Backend, LinkStatistics
from nclient.errors import ConnectionLost, RobotRefused
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFramer
from nclient.protocol.types import N150, Model, WireState, get_model, serial_wire_state, tcp_wire_state
from nserver_emu.gateway.gateway import Gateway, RealRobotProxy
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.server.session import Session
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import ORIGIN, WireClient
from worlds.io import load_world
from worlds.world import StartPose

ScriptedAnswer = Reply | Exception
LINE_STATE = Reply(
    "state",
    {**dict.fromkeys(range(17, 33), 40), 33: 0xF00000, 34: 100, 35: -50, 36: 900, 37: 1800,
     **dict.fromkeys(range(38, 42), 0), 43: 450},
    clock=5000,
    volts=(200, 210),
)  # fmt: skip
"""State packet of a standing N150 on its own line."""


class ScriptedRobot:
    """Answer by command name, else with `state`; raise `trouble` first. `first` runs before each call."""

    def __init__(
        self, model: Model = N150, *, line: bool = True, answers: Mapping[str, ScriptedAnswer] | None = None
    ) -> None:
        self.wire_state: WireState = serial_wire_state(model) if line else tcp_wire_state(model)
        self.greeting: Reply | None = None
        self.port = 1
        self.link: LinkStatistics | None = None
        self.closed = False
        self.answers = dict(answers or {})
        self.state = LINE_STATE
        self.trouble: list[Exception] = []
        self.calls: list[Call] = []
        self.first: Callable[[], object] = lambda: None

    def execute(self, call: Call) -> Reply:
        # 1. The call can be interrupted, or the line be closed, before it is executed.
        self.first()
        if self.closed:
            raise ConnectionLost("this robot is gone")
        self.calls.append(call)
        # 2. Errors that were prepared come first, then the answer of this command, else the state.
        if self.trouble:
            raise self.trouble.pop(0)
        answer = self.answers.get(call.name, self.state)
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        self.closed = True

    def names(self) -> list[str]:
        """Return the names of the calls since the last time, and clear them."""
        names = [call.name for call in self.calls]
        self.calls.clear()
        return names


class EmulatedLine:
    """A backend over the bytes of a robot's own line; each exchange advances simulated time by `step_s`."""

    def __init__(self, emulator: Emulator, model: Model, step_s: float = 0.1) -> None:
        self.wire_state = serial_wire_state(model)
        self.greeting: Reply | None = None
        self.port = 1
        self.link: LinkStatistics | None = None
        self.closed = False
        self.emulator = emulator
        self._step_s = step_s
        self._framer = SerialFramer()
        self._session = SerialSession(emulator.answer, 1, model, lambda: emulator.simulation.time_s)

    def execute(self, call: Call) -> Reply:
        request = codec.encode_serial_request(call, self.wire_state)
        codec.update_from_request(call, self.wire_state)
        self.emulator.simulation.step(self._step_s)
        self._session.receive(request)
        answer = self._session.process_requests(max_requests=1)
        # Deferred replies (ws, zr) take as many steps as they need.
        while not answer:
            self.emulator.simulation.step(self._step_s)
            answer = self._session.tick()
        (frame,) = self._framer.receive(answer)
        reply = codec.decode_serial_reply(frame, self.wire_state)
        if reply.kind == "nak":
            raise RobotRefused(call.name, None)
        return reply

    def close(self) -> None:
        self.closed = True


def emulated(
    model: str = "n150", start: StartPose = ORIGIN, setup: RobotSetup = IDEAL, pace: SimulationClock | None = None
) -> Emulator:
    """Return an emulator with one robot of a model, number 1."""
    made = Simulation(load_world("thesis_room"), seed=3)
    made.add_robot(1, start, MODELS[model], setup)
    return Emulator(made, clock=pace)


def line_of(emulator: Emulator) -> EmulatedLine:
    """Return the line of its robot 1."""
    return EmulatedLine(emulator, get_model(emulator.simulation.robots[1].model.family))


class GatewayHarness:
    """A gateway to one robot. `now_s` is its clock; `client` returns a connected client."""

    def __init__(
        self,
        opens: Callable[[], Backend],
        *,
        emulator: Emulator | None = None,
        shadow: bool = False,
        read_only: bool = False,
        wrap: Callable[[Backend], Backend] = lambda backend: backend,
    ) -> None:
        self.now_s = 0.0
        self.proxy = RealRobotProxy(lambda: wrap(opens()), lambda: self.now_s, read_only=read_only)
        self.emulator = emulator or emulated(self.proxy.robot.link.model.name)
        self.gateway = Gateway(self.emulator, {1: self.proxy}, shadow=shadow, wrap=wrap)

    def client(self) -> GatewayClient:
        return GatewayClient(self)

    def run_pending(self) -> None:
        """Run all queued jobs."""
        while self.proxy.robot.run_next() == 0.0:
            pass


class GatewayClient:
    """A client of the gateway, and its session."""

    def __init__(self, harness: GatewayHarness) -> None:
        self.harness = harness
        self.session = Session(harness.gateway.answer)
        self.wire = WireClient(self._exchange)
        self.ask("connect_robot", 1, 4711)

    def ask(self, name: str, *args: int) -> Reply:
        """Make one call and return its reply."""
        reply: Reply = self.wire.ask(name, *args)
        return reply

    def _exchange(self, data: bytes) -> bytes:
        self.session.receive(data)
        answer = self.session.process_requests(max_requests=100)
        # The bound ends the test if there is never a reply.
        for _ in range(1000):
            if answer:
                break
            self.harness.run_pending()
            self.harness.now_s += 0.1
            answer = self.session.tick()
        return answer

    def leave(self) -> None:
        """Close the connection."""
        self.harness.gateway.on_disconnect(self.session.context)
