"""What viewers are told by the clock: who waits for a pose, and what is said on the lines, to those who watch it."""

from __future__ import annotations

import asyncio

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import ConnectionContext
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.viewed_daemon import served


def test_that_a_program_waits_for_a_pose_is_told_once_and_that_it_waits_no_more() -> None:
    async def scenario() -> None:
        async with served(Emulator(simulation())) as here, here.page() as page:
            assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {}
            visit = ConnectionContext(robot_id=1)
            clicked = here.daemon.emulator.pose_requests.add(1, visit, lambda: (0, 0, 0, 0))
            assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {"1": 1}
            await page.say(do="click", robot=1, pose=[1, 2, 3, 4])
            assert (await page.until(lambda message: message["type"] == "asked"))["robots"] == {}
            assert clicked() == (1, 2, 3, 4)

    asyncio.run(scenario())


def test_what_is_said_is_told_to_those_who_watch_with_the_command_it_answers() -> None:
    async def scenario() -> None:
        async with served(Emulator(simulation())) as here, here.page() as page, here.page() as other:
            await other.say(do="call", id=1, robot=1, call="st", args=[])
            await other.answer(1)
            await page.say(do="watch", traffic=True, laser=False)
            while not here.viewing.desk.listening.watched:
                await asyncio.sleep(0.01)
            await other.say(do="call", id=2, robot=1, call="vm", args=[10, 0, 0])
            told = await page.until(lambda message: message["type"] == "traffic")
            rows = [(row["who"], row["to"], row["of"]) for row in told["rows"]]
            assert rows == [("viewer 2 on robot 1", "robot", "vm"), ("viewer 2 on robot 1", "host", "vm")]
            await other.say(do="call", id=3, robot=1, call="st", args=[])
            assert (await other.until(lambda message: message["type"] in ("traffic", "answer")))["type"] == "answer"

    asyncio.run(scenario())
