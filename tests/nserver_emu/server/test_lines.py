"""Lines on real ports in one process: hosts that connect, disconnect, do not read or send garbage."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import struct
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path

import pytest

from nclient.errors import AddressError, ConnectionLost
from nclient.faults.plan import GREETING, Cut, Delay, HangUp, Plan, Rule, When
from nclient.protocol import codec
from nclient.protocol.client_state import read_handshake
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import SerialFrame, SerialFramer
from nclient.protocol.types import EVERYTHING, MODELS, Mask, serial_wire_state
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.pty import PseudoTerminal
from nserver_emu.server.serial_lines import PtyConnection, RobotdConnection, robot_line
from nserver_emu.server.serial_session import RateLimitedChannel
from nserver_emu.server.server_state import SimulationClock
from tests.nserver_emu.server.line_host import emulated
from tests.nserver_emu.server.running_server import serving

GS = bytes.fromhex("010200070a5c")
BAUD = 38400
# gs has 6 bytes and its reply 48 (data 42, framing 6), each byte ten bits (8N1).
MIN_EXCHANGE_S = 54 * 10 / BAUD
"""Duration of gs and its reply at a Nomad's baud rate."""


class Host:
    """A host at a line: `send`, and `some`, a coroutine that returns received bytes."""

    def __init__(self, model: str, send: Callable[[bytes], object], some: Callable[[], Awaitable[bytes]]) -> None:
        self.wire_state = serial_wire_state(MODELS[model])
        self.send, self.some = send, some
        self._framer = SerialFramer()
        self._frames: list[SerialFrame] = []

    async def ask(self, name: str, *args: int) -> Reply:
        self.send(codec.encode_serial_request(Call(name, args), self.wire_state))
        return await self.reply()

    async def reply(self) -> Reply:
        while not self._frames:
            data = await self.some()
            assert data, "the line is dead"
            self._frames += self._framer.receive(data)
        return codec.decode_serial_reply(self._frames.pop(0), self.wire_state)


class RunningServer:
    """A daemon with a serial line of robot 1 at `path` and its robotd at `port`."""

    def __init__(self, daemon: Daemon, line: PtyConnection, port: int, model: str) -> None:
        self.daemon, self.line, self.port, self.model = daemon, line, port, model
        self.hosts = contextlib.AsyncExitStack()

    @property
    def moving(self) -> bool:
        return any(self.daemon.emulator.simulation.robots[1].moving)

    def at_link(self) -> tuple[Host, Callable[[], None]]:
        """A host that has the link open, and how it leaves."""
        fd = os.open(self.line.terminal.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        come = asyncio.Event()
        # A pseudo-terminal has no asyncio transport: the descriptor is non-blocking and watched by the loop.
        loop = asyncio.get_running_loop()
        loop.add_reader(fd, come.set)

        async def some() -> bytes:
            while True:
                with contextlib.suppress(BlockingIOError):
                    return os.read(fd, 65536)
                come.clear()
                await come.wait()

        def leave() -> None:
            with contextlib.suppress(OSError):
                loop.remove_reader(fd)
                os.close(fd)

        self.hosts.callback(leave)
        return Host(self.model, lambda data: os.write(fd, data), some), leave

    async def at_port(self) -> tuple[Host, asyncio.StreamWriter]:
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        self.hosts.callback(writer.close)
        return Host(self.model, writer.write, lambda: reader.read(65536)), writer

    async def until(self, true: Callable[[], bool]) -> None:
        while not true():
            await asyncio.sleep(0.002)


@contextlib.asynccontextmanager
async def running_lines(
    path: Path,
    emulator: Emulator | None = None,
    new_channel: Callable[[], RateLimitedChannel] | None = None,
    model: str = "n150",
) -> AsyncIterator[RunningServer]:
    """Run a daemon with a serial link at `path` and a robotd port, both of robot 1."""
    daemon = Daemon(emulator or emulated(model))
    robot = robot_line(daemon, 1)
    line = PtyConnection(daemon, robot, PseudoTerminal(path), new_channel)
    port = await daemon.open_listener(lambda: RobotdConnection(daemon, robot), "127.0.0.1", 0, "--robotd")
    server = RunningServer(daemon, line, port, model)
    async with serving(daemon), server.hosts:
        yield server
    assert not daemon.connections
    assert not os.path.lexists(path)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the path of the serial link."""
    return tmp_path / "nomad"


async def test_a_robot_stops_when_its_host_closes_the_line(path: Path) -> None:
    async with running_lines(path) as server:
        for _ in range(3):
            host, leave = server.at_link()
            # Slot 39 is the steering velocity, tenths of a degree per second.
            assert (await host.ask("vm", 0, 100, 0)).slots[39] == 100
            assert server.moving
            leave()
            await server.until(lambda: not server.moving)


async def test_a_second_opening_of_the_link_stops_nothing(path: Path) -> None:
    async with running_lines(path) as server:
        host, _ = server.at_link()
        await host.ask("vm", 0, 100, 0)
        # Each time a second descriptor is opened and closed, while the first host stays.
        for _ in range(3):
            _, leave = server.at_link()
            await host.ask("gs")
            leave()
            assert (await host.ask("gs")).slots[39] == 100


async def test_a_removed_link_is_restored_and_logged(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    async with running_lines(path) as server:
        path.unlink()
        async with asyncio.timeout(1.0):
            await server.until(path.is_symlink)
        assert (await server.at_link()[0].ask("gs")).kind == "state"
    assert "symbolic link was removed" in caplog.text


async def test_a_line_without_host_is_no_client(path: Path) -> None:
    async with running_lines(path) as server:
        assert server.daemon.connected_clients() == []
        host, leave = server.at_link()
        await host.ask("gs")
        (client,) = server.daemon.connected_clients()
        assert (client["name"], client["robot"]) == (f"serial {path}", 1)
        leave()
        await server.until(lambda: not server.daemon.connected_clients())


async def test_it_stops_too_when_a_host_on_its_port_vanishes(path: Path) -> None:
    async with running_lines(path) as server:
        host, writer = await server.at_port()
        assert (await host.ask("vm", 0, 100, 0)).slots[39] == 100
        # SO_LINGER with 0 s: the close sends RST instead of FIN, as when a machine disappears.
        linger = struct.pack("ii", 1, 0)
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
        writer.transport.abort()
        await server.until(lambda: not server.moving)


async def test_a_host_that_moved_nothing_stops_nothing(path: Path) -> None:
    async with running_lines(path) as server:
        # 1. A client on the port moves the robot.
        driver, _ = await server.at_port()
        await driver.ask("vm", 0, 100, 0)
        # 2. A host on the link only reads, and closes it.
        host, leave = server.at_link()
        assert (await host.ask("gs")).slots[39] == 100
        leave()
        await server.until(lambda: not server.line.is_connected)
        assert server.moving


async def test_an_n200_sends_a_handshake_over_tcp_only(path: Path) -> None:
    async with running_lines(path, model="n200") as server:
        host, _ = await server.at_port()
        # Over TCP the N200 sends mask and laser mode 51 first, without a request.
        assert read_handshake(await host.some()) == (EVERYTHING, 51)
        assert (await host.ask("gs")).laser is not None
        serial, _ = server.at_link()
        # On the link a host needs no handshake before its request.
        assert (await serial.ask("get_rv")).slots == {38: 0, 39: 0, 40: 0}


async def test_the_handshake_contains_the_mask_of_another_line(path: Path) -> None:
    async with running_lines(path, model="n200") as server:
        # 1. A host on the link selects only the last ten slots.
        serial, leave = server.at_link()
        few = Mask((0,) * 34 + (1,) * 10)
        serial.wire_state.set_mask(few)
        await serial.ask("ct", *few.smask)
        leave()
        # 2. Over TCP the handshake carries that mask.
        host, writer = await server.at_port()
        assert read_handshake(await host.some()) == (few, 51)
        host.wire_state.set_mask(few)
        # 3. The state reply follows it: no sonar (slot 17).
        assert 17 not in (await host.ask("gs")).slots
        writer.close()
        await writer.wait_closed()
        await server.until(lambda: not server.daemon.connected_clients())


@pytest.mark.parametrize("lockstep_s", [None, 0.1])
async def test_ws_replies_when_the_robot_is_still(path: Path, lockstep_s: float | None) -> None:
    async with running_lines(path, emulated(pace=SimulationClock(lockstep_s=lockstep_s))) as server:
        host, _ = server.at_link()
        await host.ask("pr", 0, 90, 0)
        assert (await host.ask("ws", 1, 1, 1, 20)).slots[36] == 90
        assert not server.moving


async def test_a_host_that_does_not_read_blocks_nothing(path: Path) -> None:
    async with running_lines(path) as server:
        deaf, _ = server.at_link()
        other, _ = await server.at_port()
        while not server.line.lost:
            with contextlib.suppress(BlockingIOError):
                deaf.send(GS * 20)
            assert (await other.ask("gs")).kind == "state"
        await server.until(lambda: not server.line.session.ready)
        deaf.send(codec.encode_serial_request(Call("vm", (0, 100, 0)), deaf.wire_state))
        await server.until(lambda: server.moving)
        # The kernel passes on more than it takes at once: the rest of a reply is written after several reads.
        received = 0
        while received < 1000 or server.line._write_buffer:
            received += len(await deaf.some())
        assert (await deaf.ask("get_rv")).kind in ("state", "velocity")


@pytest.mark.long
async def test_what_one_host_did_not_read_the_next_does_not_get(path: Path) -> None:
    async with running_lines(path) as server:
        deaf, leave = server.at_link()
        while not server.line.lost:
            with contextlib.suppress(BlockingIOError):
                deaf.send(GS * 20)
            await asyncio.sleep(0)
        leave()
        await server.until(lambda: not server.line.is_connected)
        assert server.line._write_buffer == b""
        host, _ = server.at_link()
        assert (await host.ask("get_rc")).kind == "configuration"


@pytest.mark.long
async def test_a_crowd_of_requests_is_answered_in_turns_in_full(path: Path) -> None:
    async with running_lines(path) as server:
        host, _ = server.at_link()
        host.send(GS * 300)
        for _ in range(300):
            assert (await host.reply()).kind == "state"
        assert not server.line.lost


async def test_a_cut_frame_is_given_up_while_the_host_waits(path: Path) -> None:
    async with running_lines(path) as server:
        host, _ = server.at_link()
        host.send(b"\x01\xf0\x00\x05" + GS)
        assert (await host.reply()).kind == "state"
        assert server.line.session.unfinished == 0


async def test_a_paced_line_is_as_slow_as_a_cable(path: Path) -> None:
    async with running_lines(path, new_channel=lambda: RateLimitedChannel(BAUD)) as server:
        loop = asyncio.get_running_loop()
        host, leave = server.at_link()
        await host.ask("gs")
        start_s = loop.time()
        for _ in range(10):
            await host.ask("gs")
        assert loop.time() - start_s > 9 * MIN_EXCHANGE_S
        host.send(GS * 50)
        leave()
        await server.until(lambda: not server.line.is_connected)
        again, _ = server.at_link()
        assert (await again.ask("get_rc")).kind == "configuration"


async def test_an_internal_error_hangs_up_and_the_line_recovers(
    path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.ERROR)
    async with running_lines(path) as server:
        host, _ = server.at_link()
        await host.ask("vm", 0, 100, 0)

        def broken(*_: object) -> Reply:
            raise RuntimeError("a fault")

        server.line.session._answer = broken
        # More than the bytes of one turn: the session for the next host must not execute the rest.
        host.send(codec.encode_serial_request(Call("vm", (0, 100, 0)), host.wire_state) * 60)
        assert await host.some() == b""
        other, _ = await server.at_port()
        for _ in range(10):
            await other.ask("gs")
            assert not server.moving
        again, _ = server.at_link()
        assert (await again.ask("gs")).kind == "state"
    assert "internal error" in caplog.text


async def test_faults_put_during_a_request_lose_no_reply(path: Path) -> None:
    async with running_lines(path, new_channel=lambda: RateLimitedChannel(9600)) as server:
        host, _ = server.at_link()
        await host.ask("get_rv")
        host.send(GS)
        while (channel := server.line._channel) is None or channel.due_s is None:
            await asyncio.sleep(0)
        late = Rule("late", (Delay(0.001),), lines=("serial",))
        server.daemon.faults.put(Plan((late,)), ["serial:1", "robotd:1"])
        async with asyncio.timeout(30):
            assert (await host.reply()).kind == "state"


@pytest.mark.parametrize("new_channel", [None, lambda: RateLimitedChannel(BAUD)], ids=["unlimited", "baud"])
async def test_an_injected_hang_up_leaves_a_working_line(
    path: Path, new_channel: Callable[[], RateLimitedChannel] | None
) -> None:
    async with running_lines(path, new_channel=new_channel) as server:
        rule = Rule("pulled", (HangUp(),), When(at=(3,)), lines=("serial",))
        server.daemon.faults.put(Plan((rule,)), ["serial:1", "robotd:1"])
        host, _ = server.at_link()
        other, _ = await server.at_port()
        await host.ask("vm", 0, 100, 0)
        await host.ask("gs")
        host.send(GS)
        assert await host.some() == b""
        assert not server.moving
        again, _ = server.at_link()
        for _ in range(5):
            assert (await again.ask("gs")).kind == (await other.ask("gs")).kind == "state"
        assert server.daemon.faults.counts()["serial:1"]["pulled"]["hang_up"] == 1


async def test_a_plan_knows_the_hello_of_an_n200_from_what_follows(path: Path) -> None:
    async with running_lines(path, model="n200") as server:
        rule = Rule("mumbled", (Cut(keep=3),), commands=(GREETING,))
        server.daemon.faults.put(Plan((rule,)), ["serial:1", "robotd:1"])
        host, _ = await server.at_port()
        assert await host.some() == b"\xff\xff\xff"
        assert (await host.ask("get_rv")).kind == "velocity"


def test_a_line_for_a_missing_robot_names_the_robots() -> None:
    daemon = Daemon(emulated())
    with pytest.raises(AddressError, match="robot 3"):
        robot_line(daemon, 3)


async def test_a_port_that_is_taken_names_the_remedy_for_robotd(path: Path) -> None:
    async with running_lines(path) as server:
        with pytest.raises(ConnectionLost, match="--robotd 0 takes"):
            await server.daemon.open_listener(
                lambda: RobotdConnection(server.daemon, robot_line(server.daemon, 1)),
                "127.0.0.1", server.port, "--robotd",
            )
