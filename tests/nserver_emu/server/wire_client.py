"""A client for the tests of the server: calls in, replies out, over whatever takes bytes and gives bytes."""

from __future__ import annotations

from collections.abc import Callable

from nclient.protocol import codec
from nclient.protocol.codec import TcpFrame, TcpFramer, reply_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, tcp_wire_state
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from nserver_emu.simulation.models import N150 as SIMULATED_N150
from nserver_emu.simulation.noise import IDEAL, NOISY
from nserver_emu.simulation.simulation import Simulation
from worlds.io import load_world
from worlds.world import StartPose

ORIGIN = StartPose(0.0, 0.0, 0.0, 0.0)


class WireClient:
    """`exchange` sends bytes and gives back what has been answered."""

    def __init__(self, exchange: Callable[[bytes], bytes], wide: bool = False) -> None:
        self.wire_state = tcp_wire_state(N150)
        self.wire_state.wide = wide
        self._exchange = exchange
        self._framer = TcpFramer(reply_bounds, wide=wide)

    def ask(self, name: str, *args: int) -> Reply:
        """One call, one reply."""
        call = Call(name, args)
        codec.update_from_request(call, self.wire_state)
        (reply,) = self.send(name, codec.encode_tcp_request(call, wide=self.wire_state.wide))
        return reply

    def send(self, name: str, data: bytes) -> list[Reply]:
        """Raw bytes; the replies, read as answers to that command."""
        return self.read(name, self._exchange(data))

    def read(self, name: str, data: bytes) -> list[Reply]:
        """Replies that came, read as answers to that command."""
        found = self._framer.receive(data)
        frames = [frame for frame in found if isinstance(frame, TcpFrame)]
        assert len(frames) == len(found)
        return [codec.decode_tcp_reply(BY_NAME[name], frame, self.wire_state) for frame in frames]


def simulation(world: str = "thesis_room", start: StartPose = ORIGIN, noisy: bool = False, seed: int = 0) -> Simulation:
    """A simulation with one N150, number 1."""
    made = Simulation(load_world(world), seed=seed)
    made.add_robot(1, start, SIMULATED_N150, NOISY if noisy else IDEAL)
    return made


def meet(emulator: Emulator) -> tuple[WireClient, Session]:
    """A connected client and its session, in one process; time stands still unless the test steps it."""
    session = Session(emulator.answer)

    def exchange(data: bytes) -> bytes:
        session.receive(data)
        return session.process_requests(max_requests=100)

    client = WireClient(exchange)
    client.ask("connect_robot", 1, 4711)
    return client, session
