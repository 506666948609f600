"""The files that a request over TCP crosses, from the bytes of the socket to those of the reply."""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import nclient.protocol
import nserver_emu
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.server.connection import TcpConnection
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.inprocess import open_address

MAX_FILES = 6
PROTOCOL, EMULATOR = (Path(package.__file__ or "").parent for package in (nclient.protocol, nserver_emu))
# The path ends where the simulated robot is commanded and read; what it computes is behind robot.py.
SIMULATION, ROBOT = EMULATOR / "simulation", EMULATOR / "simulation" / "robot.py"
# Conversions of units, which call nothing.
UNITS = PROTOCOL / "types.py"


class FakeSocket:
    def setsockopt(self, *_: int) -> None:
        """Ignore options."""


class FakeTransport:
    """A transport that keeps what is written to it."""

    def __init__(self) -> None:
        self.written = b""

    def get_extra_info(self, name: str) -> Any:
        return ("127.0.0.1", 4711) if name == "peername" else FakeSocket()

    def set_write_buffer_limits(self, high: int) -> None:
        """Ignore the limit."""

    def write(self, data: bytes) -> None:
        self.written += data

    def resume_reading(self) -> None:
        """Go on; nothing reads here."""

    def pause_reading(self) -> None:
        """Go on; nothing reads here."""

    def is_closing(self) -> bool:
        return False


def files_of(connection: TcpConnection, call: Call) -> set[Path]:
    """Return the files of the path in which a function runs while a request is answered."""
    data = codec.encode_tcp_request(call)
    connection.get_buffer(-1)[: len(data)] = data
    files: set[Path] = set()

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call":
            files.add(Path(frame.f_code.co_filename))

    sys.setprofile(note)
    try:
        connection.buffer_updated(len(data))
    finally:
        sys.setprofile(None)
    behind_robot = {file for file in files if SIMULATION in file.parents and file != ROBOT}
    return {file for file in files - behind_robot - {UNITS} if PROTOCOL in file.parents or EMULATOR in file.parents}


@pytest.mark.parametrize("call", [Call("gs"), Call("vm", (100, 0, 0)), Call("st")], ids=lambda call: call.name)
async def test_a_request_crosses_at_most_six_files(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    # No turn of the event loop ends here, and the profiler makes everything slow.
    monkeypatch.setattr("nserver_emu.server.connection.ITERATION_BUDGET_S", 10.0)
    emulator = open_address("sim:thesis_room").emulator
    emulator.clock.lockstep_s = None
    connection, transport = TcpConnection(Daemon(emulator)), FakeTransport()
    connection.connection_made(transport)  # type: ignore[arg-type]  # a fake of what the connection uses
    # CONNECT and the first request behind it also enter the client in a registry.
    files_of(connection, Call("connect_robot", (1, 1)))
    files_of(connection, Call("gs"))
    # Time has passed, so that the state is read and encoded again.
    emulator.pass_time(0.01)
    sent = len(transport.written)
    files = files_of(connection, call)
    assert len(transport.written) > sent
    assert len(files) <= MAX_FILES, sorted(map(str, files))
    assert ROBOT in files
    assert not any("gateway" in file.parts for file in files)
