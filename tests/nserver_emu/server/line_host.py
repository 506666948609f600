"""A host for the tests of the robot's own line: calls in, replies out, over whatever takes bytes and gives bytes."""

from __future__ import annotations

from collections.abc import Callable

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFrame, SerialFramer
from nclient.protocol.types import Model, get_model, serial_wire_state
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import SerialSession
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.noise import IDEAL, RobotSetup
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world
from worlds.world import StartPose

ORIGIN = StartPose(0.0, 0.0, 0.0, 0.0)


class LineHost:
    """`exchange` sends bytes and gives back what has been answered."""

    def __init__(self, exchange: Callable[[bytes], bytes], model: Model) -> None:
        self.wire_state = serial_wire_state(model)
        """The settings of the host: as at power-on until changed."""
        self._exchange = exchange
        self._framer = SerialFramer()

    def ask(self, name: str, *args: int | str) -> Reply:
        """One call, one reply."""
        return codec.decode_serial_reply(self.frame(name, *args), self.wire_state)

    def frame(self, name: str, *args: int | str) -> SerialFrame:
        """One call, the frame that answers it."""
        call = Call(name, args)
        request = codec.encode_serial_request(call, self.wire_state)
        codec.update_from_request(call, self.wire_state)
        (frame,) = self.raw(request)
        return frame

    def raw(self, data: bytes) -> list[SerialFrame]:
        """Any bytes; the frames that come back."""
        found = self._framer.receive(self._exchange(data))
        assert self._framer.pending == self._framer.skipped_bytes == 0
        return found


def emulated(
    model: str = "n150", start: StartPose = ORIGIN, setup: RobotSetup = IDEAL, pace: SimulationClock | None = None
) -> Emulator:
    """An emulator with one robot of a model, number 1."""
    made = Simulation(load_world("thesis_room"), seed=3)
    made.add_robot(1, start, MODELS[model], setup)
    return Emulator(made, clock=pace)


def meet_on_line(emulator: Emulator, robot_id: int = 1) -> tuple[LineHost, SerialSession]:
    """A host and the session of that robot's line, in one process; the clock is the simulated time."""
    simulation = emulator.simulation
    model = get_model(simulation.robots[robot_id].model.family)
    clock, wire_state = (lambda: simulation.time_s), emulator.serial_wire_state(robot_id)
    session = SerialSession(emulator.answer, robot_id, model, clock, wire_state=wire_state)

    def exchange(data: bytes) -> bytes:
        session.receive(data)
        return session.process_requests(max_requests=100) + session.tick()

    return LineHost(exchange, model), session
