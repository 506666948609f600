"""Ports reject addresses that are not allowed, and a warning is printed if they are open to the network."""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import socket
from typing import Any

import pytest

from nclient.transports.listener import Allowlist
from nserver_emu import cli
from nserver_emu.server.admission import ACCEPTS_PER_TURN, listen
from nserver_emu.server.serial_lines import RobotdConnection, robot_line
from nserver_emu.viewer.server import ViewerServer, serve_viewer
from tests.nserver_emu.server.running_server import running_server


async def test_a_rejected_connection_is_closed_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running_server() as server:
        inside = await server.connect_client()
        with monkeypatch.context() as patched:
            patched.setattr("nclient.transports.listener.is_loopback", lambda _host: False)
            server.daemon.admission.access = Allowlist((ipaddress.ip_network("192.0.2.0/24"),))
            outsider = await server.open_client(of="127.0.0.2")
            assert await outsider.reader.read() == b""
            # From the address that it calls.
            assert (await (await server.connect_client()).ask("gs")).kind == "state"
        assert server.daemon.admission.rejected == 1
        assert (await inside.ask("gs")).kind == "state"
        assert (await (await server.connect_client()).ask("gs")).kind == "state"


def test_a_warning_is_printed_at_start(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "stop_on_signals", lambda stop: asyncio.get_running_loop().call_later(0.05, stop.set))
    assert cli.main(["--port", "0", "--bind", "0.0.0.0"]) == 0
    assert "open to the network at 0.0.0.0" in caplog.text


class Accepted(asyncio.Protocol):
    """Counts the connections that are open."""

    def __init__(self, opened: list[asyncio.BaseTransport]) -> None:
        self._opened = opened

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._opened.append(transport)


async def test_one_connection_is_accepted_per_turn() -> None:
    opened: list[asyncio.BaseTransport] = []
    server = await listen(lambda: Accepted(opened), "127.0.0.1", 0)
    with contextlib.ExitStack() as clients:
        # All of these wait in the system's queue before the loop polls the port.
        for _ in range(20):
            clients.enter_context(socket.create_connection(server.sockets[0].getsockname(), timeout=10))
        per_turn = []
        while len(opened) < 20:
            before = len(opened)
            await asyncio.sleep(0)
            per_turn.append(len(opened) - before)
        assert max(per_turn) == ACCEPTS_PER_TURN
    for transport in opened:
        transport.abort()  # type: ignore[attr-defined]
    server.close()


@pytest.mark.parametrize("option", ["--port", "--robotd", "--viewer"])
async def test_every_port_accepts_one_connection_per_turn(option: str, monkeypatch: pytest.MonkeyPatch) -> None:
    backlogs = []
    loop = asyncio.get_running_loop()
    create_server = loop.create_server

    async def creating(*args: Any, **options: Any) -> asyncio.Server:
        backlogs.append(options.get("backlog"))
        return await create_server(*args, **options)

    monkeypatch.setattr(loop, "create_server", creating)
    async with running_server() as server:
        if option == "--robotd":
            robot = robot_line(server.daemon, 1)
            await server.daemon.open_listener(
                lambda: RobotdConnection(server.daemon, robot), "127.0.0.1", 0, option
            )
        elif option == "--viewer":
            async with serve_viewer(ViewerServer(server.daemon), "127.0.0.1", 0):
                pass
    assert set(backlogs) == {ACCEPTS_PER_TURN}
