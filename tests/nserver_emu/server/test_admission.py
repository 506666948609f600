"""Ports reject addresses that are not allowed, and a warning is printed if they are open to the network."""

from __future__ import annotations

import asyncio
import ipaddress

import pytest

from nclient.common.allowlist import Allowlist
from nserver_emu import cli
from tests.nserver_emu.server.running_server import running_server


async def test_a_rejected_connection_is_closed_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    async with running_server() as server:
        inside = await server.connect_client()
        with monkeypatch.context() as patched:
            patched.setattr("nclient.common.allowlist.is_loopback", lambda _host: False)
            server.daemon.admission.access = Allowlist((ipaddress.ip_network("192.0.2.0/24"),))
            outsider = await server.open_client(of="127.0.0.2")
            assert await outsider.reader.read() == b""
            assert (await (await server.connect_client()).ask("gs")).kind == "state"  # from the address that it calls
        assert server.daemon.admission.rejected == 1
        assert (await inside.ask("gs")).kind == "state"
        assert (await (await server.connect_client()).ask("gs")).kind == "state"


def test_a_warning_is_printed_at_start(caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "stop_on_signals", lambda stop: asyncio.get_running_loop().call_later(0.05, stop.set))
    assert cli.main(["--port", "0", "--bind", "0.0.0.0"]) == 0
    assert "open to the network at 0.0.0.0" in caplog.text
