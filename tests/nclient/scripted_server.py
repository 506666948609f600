"""A scripted Nserver, built on nclient.protocol alone, in this process or on a socket: no emulator, no clock.

    ScriptedServer(replies)   a peer for MemoryStream that replies by script; `calls` are the received calls
    on_socket(serve)          a loopback port where `serve(connection)` runs in a thread for one client

A scripted reply is a Reply, bytes, or None for silence.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

from nclient.backends.nserver import NserverBackend
from nclient.protocol import codec
from nclient.protocol import replies as shape
from nclient.protocol.codec import TcpFrame, TcpFramer, request_bounds
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, Model, tcp_wire_state
from nclient.robot import Robot
from nclient.transports.stream import MemoryStream

_SLOTTED = (shape.INFRARED, shape.SONAR, shape.BUMPER, shape.COMPASS, shape.CONFIGURATION, shape.VELOCITY)
Answer = Reply | bytes | None
PORT = 7019


def error(code: int) -> Reply:
    """Return the ERROR reply with this code."""
    return Reply("error", values=(code,))


def simple(*values: int) -> Reply:
    """Return a reply of plain numbers."""
    return Reply("simple", values=values)


class ScriptedServer:
    """Replies by script, else with a default reply. `slots` is its State."""

    def __init__(self, answers: Mapping[str, Answer] | None = None, model: Model = N150) -> None:
        self.answers: dict[str, Answer] = dict(answers or {})
        # State[0] = 10: the simulation runs in real time.
        self.slots: dict[int, int] = {0: 10}
        self.clock = 0
        self.volts = (255, 255)
        self.calls: list[Call] = []
        self.closed = 0
        self.wire_state = tcp_wire_state(model)
        self._framer = TcpFramer(request_bounds)
        self._out = bytearray()

    def send(self, data: bytes) -> None:
        for frame in self._framer.receive(data):
            assert isinstance(frame, TcpFrame), frame
            call = codec.decode_tcp_request(frame)
            self.calls.append(call)
            codec.update_from_request(call, self.wire_state)
            if BY_NAME[call.name].has_tcp_reply:
                self._out += self._bytes_for(call)

    def receive(self) -> bytes:
        data, self._out = bytes(self._out), bytearray()
        return data

    def close(self) -> None:
        self.closed += 1

    def names(self) -> list[str]:
        """Return the C names of the calls after connecting, in order."""
        # The first two calls are connect_robot and ct.
        return [call.name for call in self.calls[2:]]

    def last(self) -> Call:
        """Return the last call."""
        return self.calls[-1]

    def state(self) -> Reply:
        """Return the current state reply."""
        return Reply("state", dict(self.slots), clock=self.clock, volts=self.volts)

    def _bytes_for(self, call: Call) -> bytes:
        row = BY_NAME[call.name]
        answer = self.answers[call.name] if call.name in self.answers else self._default_reply(row.name, row.tcp_reply)
        if answer is None or isinstance(answer, bytes):
            return answer or b""
        return codec.encode_tcp_reply(row, answer, self.wire_state)

    def _default_reply(self, name: str, layout: shape.TcpLayout) -> Reply:
        if name in ("connect_robot", "create_robot"):
            return simple(PORT)
        if layout is shape.STATE:
            return self.state()
        if layout in _SLOTTED:
            return Reply(layout.kind, dict(self.slots), clock=self.clock)
        # Replies without slots: numbers of each layout.
        lengths = {shape.COLLISION: 4, shape.CLICKED_CONFIGURATION: 4, shape.PREDICTION: 44, shape.SPECIAL: 16,
                   shape.TRUTH: 8, shape.CONTROL: 4}
        return Reply(layout.kind, values=(0,) * lengths.get(layout, 1), clock=self.clock)


def robot_on(server: ScriptedServer, timeout_s: float = 5.0) -> Robot:
    """Return a robot on a scripted server in this process."""
    return Robot(NserverBackend(MemoryStream(server), model=server.wire_state.model, timeout_s=timeout_s))


@contextlib.contextmanager
def on_socket(talk: Callable[[socket.socket], None]) -> Iterator[int]:
    """Yield the port of a server for one client; errors of its thread are raised at the end."""

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            # A client that fails must not leave this thread waiting without end.
            connection.settimeout(10)
            talk(connection)

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as thread:
        listener.settimeout(10)
        serving = thread.submit(serve)
        yield listener.getsockname()[1]
        serving.result(10)


def by_script(server: ScriptedServer, calls: int) -> Callable[[socket.socket], None]:
    """Return a function that answers that many calls by script, or fewer if the client disconnects."""

    def talk(connection: socket.socket) -> None:
        while len(server.calls) < calls and (data := connection.recv(65536)):
            server.send(data)
            connection.sendall(server.receive())

    return talk
