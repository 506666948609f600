"""Real robots for the tests of the gateway, in this process: one that says what it is told to, and emulated ones.

    ScriptedRobot     a backend that answers each call as told, falls silent, hangs up
    EmulatedLine      the own line of an emulated robot: every exchange goes through the bytes of the direct language
    House             a gateway over a backend, without a thread: `house.ask` works until there is an answer
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from nclient.backends.base import Backend, LinkStatistics
from nclient.errors import ConnectionLost, RobotRefused
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFramer
from nclient.protocol.types import N150, Model, model_named
from nclient.protocol.wire_state import Terms, line_terms, tcp_terms
from nserver_emu.gateway.gateway import Gateway, RealSide
from nserver_emu.server.context import Pace
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import LineSession
from nserver_emu.server.session import Session
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from tests.nserver_emu.server.wire_client import ORIGIN, WireClient
from worlds.files import load_world
from worlds.world import StartPose

Said = Reply | Exception
LINE_STATE = Reply(
    "state",
    {**dict.fromkeys(range(17, 33), 40), 33: 0xF00000, 34: 100, 35: -50, 36: 900, 37: 1800,
     **dict.fromkeys(range(38, 42), 0), 43: 450},
    clock=5000,
    volts=(200, 210),
)  # fmt: skip
"""What an N150 that stands says on its own line."""


class ScriptedRobot:
    """Answers by name, else with `state`; `trouble` is raised instead while there is any. `first` runs before."""

    def __init__(self, model: Model = N150, *, line: bool = True, answers: Mapping[str, Said] | None = None) -> None:
        self.terms: Terms = line_terms(model) if line else tcp_terms(model)
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
        self.first()
        if self.closed:
            raise ConnectionLost("this robot is gone")
        self.calls.append(call)
        if self.trouble:
            raise self.trouble.pop(0)
        said = self.answers.get(call.name, self.state)
        if isinstance(said, Exception):
            raise said
        return said

    def close(self) -> None:
        self.closed = True

    def names(self) -> list[str]:
        """The calls since the last look, by name."""
        names = [call.name for call in self.calls]
        self.calls.clear()
        return names


class EmulatedLine:
    """A backend over the bytes of a robot's own line; `step_s` of simulated time pass with each exchange."""

    def __init__(self, emulator: Emulator, model: Model, step_s: float = 0.1) -> None:
        self.terms = line_terms(model)
        self.greeting: Reply | None = None
        self.port = 1
        self.link: LinkStatistics | None = None
        self.closed = False
        self.emulator = emulator
        self._step_s = step_s
        self._framer = SerialFramer()
        self._session = LineSession(emulator.answer, 1, model, lambda: emulator.simulation.time_s)

    def execute(self, call: Call) -> Reply:
        request = codec.line_request(call, self.terms)
        codec.note(call, self.terms)
        self.emulator.simulation.step(self._step_s)
        self._session.receive(request)
        answer = self._session.answers(most=1)
        while not answer:
            self.emulator.simulation.step(self._step_s)
            answer = self._session.tick()
        (frame,) = self._framer.receive(answer)
        reply = codec.read_line_reply(frame, self.terms)
        if reply.kind == "nak":
            raise RobotRefused(call.name, None)
        return reply

    def close(self) -> None:
        self.closed = True


def emulated(
    model: str = "n150", start: StartPose = ORIGIN, setup: RobotSetup = IDEAL, pace: Pace | None = None
) -> Emulator:
    """An emulator with one robot of a model, number 1."""
    made = Simulation(load_world("thesis_room"), seed=3)
    made.add_robot(1, start, MODELS[model], setup)
    return Emulator(made, pace=pace)


def line_of(emulator: Emulator) -> EmulatedLine:
    """The own line of its robot 1."""
    return EmulatedLine(emulator, model_named(emulator.simulation.robots[1].model.family))


class House:
    """A gateway to one robot. `now_s` is its clock; `guest` brings a connected client."""

    def __init__(
        self,
        opens: Callable[[], Backend],
        *,
        emulator: Emulator | None = None,
        shadow: bool = False,
        read_only: bool = False,
        around: Callable[[Backend], Backend] = lambda backend: backend,
    ) -> None:
        self.now_s = 0.0
        self.side = RealSide(lambda: around(opens()), lambda: self.now_s, read_only=read_only)
        self.emulator = emulator or emulated(self.side.robot.link.model.name)
        self.gateway = Gateway(self.emulator, {1: self.side}, shadow=shadow, around=around)

    def guest(self) -> Guest:
        return Guest(self)

    def work(self) -> None:
        """Let the robot say all that it is to say now."""
        while self.side.robot.work() == 0.0:
            pass


class Guest:
    """A client of the gateway, and its session."""

    def __init__(self, house: House) -> None:
        self.house = house
        self.session = Session(house.gateway.answer)
        self.client = WireClient(self._exchange)
        self.ask("connect_robot", 1, 4711)

    def ask(self, name: str, *args: int) -> Reply:
        """One call, one reply."""
        reply: Reply = self.client.ask(name, *args)
        return reply

    def _exchange(self, data: bytes) -> bytes:
        self.session.receive(data)
        answer = self.session.answers(most=100)
        for _ in range(1000):
            if answer:
                break
            self.house.work()
            self.house.now_s += 0.1
            answer = self.session.tick()
        return answer

    def leave(self) -> None:
        """Hang up."""
        self.house.gateway.leave(self.session.visit)
