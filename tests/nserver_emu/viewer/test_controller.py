"""Messages that the clock sends to viewers: pose requests, and the traffic to those that watch it; slow robots."""

from __future__ import annotations

import asyncio
from typing import Any

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import ConnectionContext, DeferredReply
from nserver_emu.viewer.clients import ErrorBoundary, ViewerClients
from nserver_emu.viewer.messages import DRIVE_TIMEOUT_S
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer


async def test_pose_requests_are_sent_once_and_withdrawn() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page:
        assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {}
        context = ConnectionContext(robot_id=1)
        # A client waits for a pose to be clicked in the page (get_robot_conf).
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


class SlowRobot:
    """A robot that answers velocities when `answers` are left, as a real one on a slow line."""

    def __init__(self, emulator: Emulator) -> None:
        self.emulator = emulator
        self.calls: list[tuple[Any, ...]] = []
        self.answers = 0

    def answer(self, call: Call, context: ConnectionContext) -> Reply | DeferredReply:
        reply = self.emulator.answer(call, context)
        self.calls.append((call.name, *call.args))
        return self.poll(reply) if call.name == "vm" and isinstance(reply, Reply) else reply

    def poll(self, reply: Reply) -> DeferredReply:
        def poll() -> Reply | None:
            self.answers -= 1
            return reply if self.answers >= 0 else None

        return poll

    def on_disconnect(self, context: ConnectionContext) -> None:
        self.emulator.on_disconnect(context)

    def hold(self, robot_id: int, by: str) -> None:
        self.emulator.hold(robot_id, by)


async def test_slow_robot_gets_only_the_latest_velocities() -> None:
    daemon = Daemon(Emulator(simulation()))
    slow = SlowRobot(daemon.emulator)
    daemon.handler = slow
    robots = ViewerClients(daemon, "test", ErrorBoundary())
    answers: list[dict[str, Any]] = []

    async def answer_one() -> None:
        slow.answers = 1
        for connection in tuple(daemon.connections):
            connection.tick()
        # Requests that waited for the answer have their turns.
        await asyncio.sleep(0.01)

    # 1. While the first velocities are not answered, later ones replace each other.
    for speed in range(1, 10):
        robots.drive(1, [speed, 0, 0], 0.0, answers.append)
    # The slow robot has received the first velocities only; of the eight others the last one waits.
    assert slow.calls[1:] == [("vm", 1, 0, 0)]
    # Those that were replaced are answered at once: 2 to 8.
    assert len(answers) == 7
    await answer_one()
    assert slow.calls[2:] == [("vm", 9, 0, 0)]
    # 2. Velocities that wait when their driver falls silent are not sent after the stop.
    robots.drive(1, [5, 0, 0], 0.1, answers.append)
    robots.tick(0.1 + DRIVE_TIMEOUT_S)
    await answer_one()
    assert slow.calls[3:] == [("st",)]
    assert len(answers) == 10
    assert all(answer["ok"] for answer in answers)
    # 3. Nor when it has gone.
    robots.drive(1, [3, 0, 0], 1.0, answers.append)
    robots.drive(1, [4, 0, 0], 1.0, answers.append)
    robots.close()
    assert slow.calls[4:] == [("vm", 3, 0, 0)]
    assert not daemon.connections
    await daemon.close()
