"""Messages that the clock sends to viewers: pose requests, and the traffic to those that watch it."""

from __future__ import annotations

import asyncio

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import ConnectionContext
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer


async def test_pose_requests_are_sent_once_and_withdrawn() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {}
        context = ConnectionContext(robot_id=1)
        clicked = here.daemon.emulator.pose_requests.add(1, context, lambda: (0, 0, 0, 0))
        assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {"1": 1}
        await page.send_message(do="click", robot=1, pose=[1, 2, 3, 4])
        assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {}
        assert clicked() == (1, 2, 3, 4)


async def test_traffic_rows_name_the_command_they_answer() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page, here.page() as other:
        await other.send_message(do="call", id=1, robot=1, call="st", args=[])
        await other.answer(1)
        await page.send_message(do="watch", traffic=True, laser=False)
        while not here.viewer_server.controller.traffic_monitor.watched:
            await asyncio.sleep(0.01)
        await other.send_message(do="call", id=2, robot=1, call="vm", args=[10, 0, 0])
        message = await page.until(lambda message: message["type"] == "traffic")
        rows = [(row["who"], row["to"], row["of"]) for row in message["rows"]]
        assert rows == [("viewer 2 on robot 1", "robot", "vm"), ("viewer 2 on robot 1", "host", "vm")]
        await other.send_message(do="call", id=3, robot=1, call="st", args=[])
        assert (await other.until(lambda message: message["type"] in ("traffic", "answer")))["type"] == "answer"
