"""An Nserver that says what a test tells it to, built on the protocol room alone: in this process or on a socket.

    ScriptedServer(answers)   send, receive, close: what MemoryStream wants; `calls` are the calls that came
    on_socket(talk)           a real loopback port where `talk(connection)` runs on a thread for one client

Rules: no emulator, no clock. An answer is a Reply, bytes as they are, or None for silence.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor

from nclient.backends.nserver import NserverBackend
from nclient.protocol import codec
from nclient.protocol import replies as shape
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.tcp_framing import TcpFrame, TcpFramer, request_bounds
from nclient.protocol.types import N150, Model
from nclient.protocol.wire_state import tcp_wire_state
from nclient.robot import Robot
from nclient.transports.memory import MemoryStream

_SLOTTED = (shape.INFRARED, shape.SONAR, shape.BUMPER, shape.COMPASS, shape.CONFIGURATION, shape.VELOCITY)
Answer = Reply | bytes | None
PORT = 7019


def error(code: int) -> Reply:
    """The ERROR reply with this code."""
    return Reply("error", values=(code,))


def simple(*values: int) -> Reply:
    """A reply of plain numbers."""
    return Reply("simple", values=values)


class ScriptedServer:
    """Answers each call as told, else in the dullest way that fits. `slots`: what State is."""

    def __init__(self, answers: Mapping[str, Answer] | None = None, model: Model = N150) -> None:
        self.answers: dict[str, Answer] = dict(answers or {})
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
        """The C names of the calls after connecting, in order."""
        return [call.name for call in self.calls[2:]]

    def last(self) -> Call:
        """The call that came last."""
        return self.calls[-1]

    def state(self) -> Reply:
        """The state reply as things are."""
        return Reply("state", dict(self.slots), clock=self.clock, volts=self.volts)

    def _bytes_for(self, call: Call) -> bytes:
        row = BY_NAME[call.name]
        answer = self.answers[call.name] if call.name in self.answers else self._dull(row.name, row.tcp_reply)
        if answer is None or isinstance(answer, bytes):
            return answer or b""
        return codec.encode_tcp_reply(row, answer, self.wire_state)

    def _dull(self, name: str, layout: shape.ReplyShape) -> Reply:
        if name in ("connect_robot", "create_robot"):
            return simple(PORT)
        if layout is shape.STATE:
            return self.state()
        if layout in _SLOTTED:
            return Reply(layout.kind, dict(self.slots), clock=self.clock)
        lengths = {shape.COLLISION: 4, shape.CLICKED_CONFIGURATION: 4, shape.PREDICTION: 44, shape.SPECIAL: 16,
                   shape.TRUTH: 8, shape.CONTROL: 4}
        return Reply(layout.kind, values=(0,) * lengths.get(layout, 1), clock=self.clock)


def robot_on(server: ScriptedServer, timeout_s: float = 5.0) -> Robot:
    """A robot in this process that the script answers for."""
    return Robot(NserverBackend(MemoryStream(server), model=server.wire_state.model, timeout_s=timeout_s))


@contextlib.contextmanager
def on_socket(talk: Callable[[socket.socket], None]) -> Iterator[int]:
    """The port of a server that talks to one client; what goes wrong on its thread is raised at the end."""

    def serve() -> None:
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(10)
            talk(connection)

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as thread:
        listener.settimeout(10)
        serving = thread.submit(serve)
        yield listener.getsockname()[1]
        serving.result(10)


def by_script(server: ScriptedServer, calls: int) -> Callable[[socket.socket], None]:
    """A talk that answers so many calls by the script, and then hangs up; sooner where the client has."""

    def talk(connection: socket.socket) -> None:
        while len(server.calls) < calls and (heard := connection.recv(65536)):
            server.send(heard)
            connection.sendall(server.receive())

    return talk
