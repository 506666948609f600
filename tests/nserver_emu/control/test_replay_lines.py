"""Replay of serial lines, byte by byte: partial frames, hosts that stop waiting, several lines."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from nclient.protocol import codec
from nclient.protocol.client_state import HANDSHAKE_SIZE, apply_handshake, read_handshake
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFrame, SerialFramer
from nclient.protocol.types import N150, Model, serial_wire_state
from nclient.recording.format import Recording, read_recording
from nserver_emu.control.recording import RunHeader, replay
from nserver_emu.server.config import SimulationConfig, pose_from_text
from nserver_emu.server.connection import MAX_REQUESTS_PER_TURN
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.pty import PseudoTerminal
from nserver_emu.server.serial_lines import PtyConnection, RobotdConnection, robot_line
from nserver_emu.server.server_state import Allowed, SimulationClock
from tests.nserver_emu.server.running_server import serving

TWO = SimulationConfig(
    world="several_walls", start=pose_from_text("5,5,0,0"), seed=3, noisy=True, others=(("n200", None),)
)


class Host:
    """A host on a robot's serial line over TCP."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, model: Model) -> None:
        self.reader, self.writer, self.wire_state = reader, writer, serial_wire_state(model)
        self._framer = SerialFramer()
        self._frames: list[SerialFrame] = []

    def request(self, name: str, *args: int) -> bytes:
        call = Call(name, args)
        data = codec.encode_serial_request(call, self.wire_state)
        codec.update_from_request(call, self.wire_state)
        return data

    async def ask(self, name: str, *args: int) -> Reply:
        self.writer.write(self.request(name, *args))
        return await self.reply()

    async def reply(self) -> Reply:
        while not self._frames:
            data = await self.reader.read(65536)
            assert data, "the line is dead"
            self._frames += self._framer.receive(data)
        return codec.decode_serial_reply(self._frames.pop(0), self.wire_state)


class RunningServer:
    """A daemon with robotd lines of two robots."""

    def __init__(self, daemon: Daemon) -> None:
        self.daemon = daemon
        self.hosts = contextlib.AsyncExitStack()

    async def host(self, robot_id: int) -> Host:
        daemon, own = self.daemon, robot_line(self.daemon, robot_id)
        port = await daemon.open_listener(lambda: RobotdConnection(daemon, own), "127.0.0.1", 0, "--robotd")
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        self.hosts.callback(writer.close)
        host = Host(reader, writer, own.model)
        # A N200 sends its handshake first; without it the host would misread the replies.
        if own.model.sends_mask:
            apply_handshake(read_handshake(await reader.readexactly(HANDSHAKE_SIZE)), host.wire_state)
        return host


async def recorded(
    path: Path, pace: SimulationClock, scenario: Callable[[RunningServer], Awaitable[None]]
) -> Recording:
    """Return the recording of a server with hosts on its serial lines."""
    run_header = RunHeader(TWO, pace, Allowed())
    daemon = Daemon(run_header.create_emulator(), pace.factor)
    port = await daemon.listen("127.0.0.1", 0)
    daemon.record(path, run_header.to_json("2026-01-01T00:00:00", port=port, requests_a_turn=MAX_REQUESTS_PER_TURN))
    server = RunningServer(daemon)
    async with serving(daemon), server.hosts:
        await scenario(server)
    return read_recording(path)


async def drive(host: Host, turns: int) -> None:
    await host.ask("sp", 100, 450, 450)
    for turn in range(turns):
        await host.ask("vm", 40 + turn, 100 - 30 * turn, 50)
        await host.ask("get_sn")
        await host.ask("ws", 1, 1, 1, 1)
        await host.ask("gs")
    await host.ask("st")


def check(recording: Recording, at_least: int) -> None:
    outcome = replay(recording)
    assert outcome.difference == ""
    # The recording must contain what the scenario is about.
    assert outcome.answers >= at_least


@pytest.mark.long
async def test_two_robots_on_two_lines(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        one, two = await server.host(1), await server.host(2)
        await asyncio.gather(drive(one, 3), drive(two, 3))

    for pace in (SimulationClock(factor=20.0), SimulationClock(lockstep_s=0.05)):
        recording = await recorded(tmp_path / "run.log", pace, scenario)
        wires = [entry.more["wire"] for entry in recording.entries if entry.kind == "open"]
        assert wires == ["serial", "hello"]
        # 14 exchanges of each host (sp, 3 x 4, st), and the handshake.
        check(recording, 2 * 14 + 1)


async def test_partial_frames_stray_bytes_and_short_timeouts(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        host = await server.host(1)
        await host.ask("vm", 50, 0, 0)
        # A stray byte, then two start bytes whose lengths (257 and 513) are out of range.
        host.writer.write(b"\xee\x01\x01" + host.request("gs"))
        await host.reply()
        # st arrives during ws and cancels its reply.
        host.writer.write(host.request("ws", 1, 1, 1, 200))
        await asyncio.sleep(0.05)
        await host.ask("st")
        # The begin of a frame with a length of 60: the two requests behind it are found after its timeout.
        host.writer.write(bytes((1, 60, 0, 5)) + host.request("get_rc") + host.request("get_bp"))
        assert (await host.reply()).kind == "configuration", "behind half a frame that was given up"
        assert (await host.reply()).kind == "bumper"
        host.writer.write(bytes((1, 60, 0, 5, 9)))
        # Longer than the timeout of a frame, 0.5 s.
        await asyncio.sleep(0.7)
        await host.ask("get_rv")

    check(await recorded(tmp_path / "run.log", SimulationClock(), scenario), 5)


async def test_consecutive_hosts_at_a_pseudo_terminal(tmp_path: Path) -> None:
    async def scenario(server: RunningServer) -> None:
        daemon, loop = server.daemon, asyncio.get_running_loop()
        line = PtyConnection(daemon, robot_line(daemon, 1), PseudoTerminal(tmp_path / "robot"))
        try:
            # Two hosts in turn, each of which ends with its motion running.
            for _ in range(2):
                fd = os.open(tmp_path / "robot", os.O_RDWR | os.O_NOCTTY)
                request = codec.encode_serial_request(Call("vm", (100, 0, 0)), serial_wire_state(N150))
                os.write(fd, request)
                answered = await loop.run_in_executor(None, os.read, fd, 1)
                assert answered == b"\x01"
                os.close(fd)
                while any(daemon.emulator.simulation.robots[1].moving):
                    await asyncio.sleep(0.01)
        finally:
            line.close()

    recording = await recorded(tmp_path / "run.log", SimulationClock(), scenario)
    assert [entry.kind for entry in recording.entries if entry.kind in ("open", "close")] == ["open", "close"] * 2
    check(recording, 2)
