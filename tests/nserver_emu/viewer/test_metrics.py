"""/metrics and /health: contents, format and access."""

from __future__ import annotations

import asyncio
import re

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer.server import STUCK_S, all_metrics, health, metrics
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import elsewhere, serve_viewer

LINE = re.compile(r"# HELP [a-z_]+ \S.*|# TYPE [a-z_]+ (gauge|counter)|[a-z_]+ -?\d+(\.\d+)?(e[+-]?\d+)?")


def test_the_text_is_prometheus() -> None:
    daemon = Daemon(Emulator(simulation()))
    lines = metrics(daemon, 3, 7).splitlines()
    assert all(LINE.fullmatch(line) for line in lines)
    assert "nserver_viewers 3" in lines
    assert "nserver_robots 1" in lines
    assert "nserver_tasks 7" in lines
    found = list(all_metrics(daemon, 3, 7))
    # Beside them the head of the metric that has a value for each connection.
    assert len({one.name for one in found}) == len(found) == (len(lines) - 2) / 3
    assert all(one.name.endswith("_total") is (one.kind == "counter") for one in found)


def test_steps_are_counted_with_the_time_they_took() -> None:
    daemon = Daemon(Emulator(simulation()))
    for _ in range(5):
        daemon.step(0.2)
    message = {one.name: one.value for one in all_metrics(daemon, 0, 0)}
    assert (message["steps_total"], message["simulated_seconds"]) == (5, 1.0)


def test_a_clock_that_stands_is_not_well() -> None:
    daemon = Daemon(Emulator(simulation()))
    assert not health(daemon, 2 * STUCK_S)[0], "it has not begun"
    daemon.ticked_s = 100.0
    # The clock's last step is the measure: below STUCK_S it is well.
    assert health(daemon, 100.0 + STUCK_S - 0.1) == (
        True, {"status": "ok", "clock_age_s": STUCK_S - 0.1, "simulated_s": 0.0, "paused": False},
    )  # fmt: skip
    assert health(daemon, 100.0 + STUCK_S)[1]["status"] == "clock stuck"


async def test_what_clients_did_is_counted_after_they_are_gone() -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        reader, writer = await asyncio.open_connection("127.0.0.1", here.daemon.emulator.port)
        writer.write(codec.encode_tcp_request(Call("connect_robot", (1, 1))) + codec.encode_tcp_request(Call("gs")))
        writer.write(codec.encode_tcp_request(Call("add_obstacle", (3, 0, 0, 0, 0, 0, 0))))
        # CONNECT: 4 + 4 bytes. State: 4 + 49 words (45 of State, laser count, clock, two voltages). Error: 4 + 4.
        await reader.readexactly(8 + 4 + 4 * 49 + 8)
        for connections in (1, 0):
            async with here.web.get(f"{here.origin}/metrics") as answer:
                assert answer.status == 200
                assert answer.headers["Content-Type"].startswith("text/plain; version=0.0.4")
                text = await answer.text()
            assert f"nserver_connections {connections}\n" in text
            assert "nserver_answers_total 3\n" in text
            assert "nserver_refusals_total 1\n" in text
            # Only open connections have a time of their own; the total includes closed ones.
            times = re.findall(r'nserver_connection_cpu_seconds_total\{connection="(\d+)"\} (\S+)\n', text)
            clients = here.daemon.connected_clients()
            assert [(int(number), round(float(cpu_s), 6)) for number, cpu_s in times] == [
                (client["number"], client["cpu_s"]) for client in clients
            ]
            assert len(times) == connections
            assert all(float(cpu_s) > 0.0 for _, cpu_s in times)
            (total,) = re.findall(r"\nnserver_cpu_seconds_total (\S+)\n", text)
            assert float(total) > 0.0
            writer.close()
            await writer.wait_closed()
            while here.daemon.connections:
                await asyncio.sleep(0.005)


@pytest.mark.parametrize("path", ["/metrics", "/health"])
async def test_from_elsewhere_a_token_is_wanted(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async with serve_viewer(Emulator(simulation())) as here, elsewhere() as outsider:
        while not here.daemon.ticked_s:
            await asyncio.sleep(0.005)
        async with outsider.get(here.origin + path) as answer:
            # On loopback all addresses are this machine's.
            assert answer.status == 200
        async with here.web.get(here.origin + path, headers={"Host": "evil.example"}) as answer:
            assert answer.status == 403
        monkeypatch.setattr("nclient.transports.listener.is_loopback", lambda _host: False)
        async with here.web.get(here.origin + path) as answer:
            # From this machine by its own address.
            assert answer.status == 200
        async with outsider.get(here.origin + path) as answer:
            assert answer.status == 403
        async with outsider.get(here.origin + path, params={"token": here.viewer_server.watch_token}) as answer:
            assert answer.status == 200
