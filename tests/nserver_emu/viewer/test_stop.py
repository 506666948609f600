"""Stop at the page holds: a program that goes on driving does not, until the robot is released; everybody sees it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N150
from nserver_emu.simulation.noise import IDEAL
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import HOST, Message, Page, serve_viewer
from worlds.world import StartPose


@contextlib.asynccontextmanager
async def a_program(port: int, robot_id: int = 1) -> AsyncIterator[None]:
    """A client that repeats the same velocities, as a path-following program does."""
    reader, writer = await asyncio.open_connection(HOST, port)

    async def drive() -> None:
        # The program ignores all replies and repeats its command, also after the stop.
        writer.write(codec.encode_tcp_request(Call("connect_robot", (robot_id, 1))))
        while True:
            writer.write(codec.encode_tcp_request(Call("vm", (40, 0, 0))))
            await asyncio.sleep(0.02)

    driving, reading = asyncio.create_task(drive()), asyncio.create_task(reader.read())
    try:
        yield
    finally:
        for task in (driving, reading):
            task.cancel()
        writer.close()
        with contextlib.suppress(OSError):
            await writer.wait_closed()


async def picture(page: Page, speed: int, held: object = ..., beyond: int = -1) -> Message:
    """The next picture in which robot 1 goes at this speed, is held so, and is farther along x than so many tenths."""
    def right(message: Message) -> bool:
        if message["type"] != "picture":
            return False
        robot = message["robots"]["1"]
        state = robot["state"]
        return bool(state[38] == speed and (held is ... or robot["held"] == held) and state[34] > beyond)

    return await page.until(right)


async def test_stop_holds_against_a_driving_program() -> None:
    emulator = Emulator(simulation())
    async with serve_viewer(emulator) as here, here.page() as page, here.page() as other, a_program(emulator.port):
        robot = emulator.simulation.robots[1]
        hello = await page.until(lambda message: message["type"] == "hello")
        await picture(page, 40, None)
        await page.send_message(do="stop", id=1)
        answer = await page.answer(1)
        assert (answer["ok"], answer["held"]["1"]["by"]) == (True, hello["name"])
        at = robot.actual
        # Ten pictures at rest, and more until ten commands are ignored: the program sends vm every 20 ms.
        holds: list[Message] = []
        while len(holds) < 10 or holds[-1]["ignored"] < 10:
            holds.append((await picture(page, 0))["robots"]["1"]["held"])
        assert robot.actual == at
        assert {hold["by"] for hold in holds} == {"viewer 1"}
        ignored = [hold["ignored"] for hold in holds]
        assert ignored == sorted(ignored)
        shown = await other.until(
            lambda message: message["type"] == "picture" and message["robots"]["1"]["held"] is not None
        )
        assert shown["robots"]["1"]["held"]["by"] == "viewer 1"
        await other.send_message(do="release", id=1, robot=1)
        assert (await other.answer(1))["held"] == {}
        # After the release the next vm of the program moves the robot, with no action of its own.
        await picture(page, 40, None, beyond=round(10 * at.x_in) + 1)
        assert robot.actual != at


async def test_a_page_cannot_move_a_held_robot() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page() as page, here.page() as other:
        robot = here.daemon.emulator.simulation.robots[1]
        await other.send_message(do="drive", id=1, robot=1, args=[50, 0, 0])
        await other.answer(1)
        await page.send_message(do="stop", id=1, robot=1)
        await page.answer(1)
        assert robot.is_still((0, 1, 2))
        for who in (page, other):
            await who.send_message(do="drive", id=2, robot=1, args=[50, 0, 0])
            answer = await who.answer(2)
            assert (answer["ok"], answer["held"]) == (False, "viewer 1")
            assert answer["error"] == "robot 1 is held by viewer 1: release it first"
            # Motions are refused for the page that stopped it, too; st and place_robot are not motions.
            for number, call, args in ((3, "pr", [10, 0, 0]), (4, "zr", []), (5, "lp", [])):
                await who.send_message(do="call", id=number, robot=1, call=call, args=args)
                assert not (await who.answer(number))["ok"]
            for number, call, args in ((6, "st", []), (7, "place_robot", [300, 200, 0, 0])):
                await who.send_message(do="call", id=number, robot=1, call=call, args=args)
                assert (await who.answer(number))["ok"]
            # Zero velocities are a stop.
            await who.send_message(do="drive", id=8, robot=1, args=[0, 0, 0])
            assert (await who.answer(8))["ok"]
        assert robot.is_still((0, 1, 2))


async def test_stop_applies_to_one_robot_or_to_all() -> None:
    emulator = Emulator(simulation())
    emulator.simulation.add_robot(2, StartPose(40.0, 0.0), N150, IDEAL)
    # The program drives robot 2, which a stop of robot 1 must not affect.
    async with serve_viewer(emulator) as here, here.page() as page, a_program(emulator.port, 2):
        await page.send_message(do="stop", id=1, robot=1)
        assert list((await page.answer(1))["held"]) == ["1"]
        async with asyncio.timeout(5):
            while emulator.simulation.robots[2].is_still((0,)):
                await asyncio.sleep(0.01)
        await page.send_message(do="stop", id=2)
        assert list((await page.answer(2))["held"]) == ["1", "2"]
        assert emulator.simulation.robots[2].is_still((0,))
        await page.send_message(do="release", id=3)
        assert (await page.answer(3))["held"] == {}
        await page.send_message(do="stop", id=4, robot=7)
        assert (await page.answer(4))["error"] == "there is no robot 7; there are 1, 2"


async def test_stop_and_release_are_logged_with_the_viewer(caplog: pytest.LogCaptureFixture) -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        here.daemon.hold([1], "nserver ctl")
        here.daemon.release([1])
    assert [record.getMessage() for record in caplog.records if record.levelname == "WARNING"] == [
        "emergency stop by nserver ctl: robot 1; release in the viewer or with nserver ctl release",
        "released: robot 1",
    ]


async def test_a_watcher_neither_stops_nor_releases() -> None:
    async with serve_viewer(Emulator(simulation())) as here, here.page(here.viewer_server.watch_token) as page:
        here.daemon.hold([1], "viewer 9")
        for number, word in enumerate(("stop", "release")):
            await page.send_message(do=word, id=number)
            assert (await page.answer(number))["error"] == "this link only looks"
        assert here.daemon.emulator.estop.as_dict() == {"1": {"by": "viewer 9", "ignored": 0}}


async def test_a_hold_outlasts_the_page_that_pressed_stop() -> None:
    async with serve_viewer(Emulator(simulation())) as here:
        async with here.page() as page:
            await page.send_message(do="stop", id=1)
            await page.answer(1)
        async with here.page() as later:
            shown = await later.until(lambda message: message["type"] == "picture")
            assert shown["robots"]["1"]["held"] == {"by": "viewer 1", "ignored": 0}
