"""Whose laser mode is followed: that of any client of the robot, whoever is not there or only looks apart."""

from __future__ import annotations

import asyncio
from typing import Any

from nclient import connect
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.viewer.scene import LASER_EVERY, MOST_NAMED, Album, is_shown, laser_modes
from tests.nserver_emu.viewer.viewed_daemon import Page, served
from worlds.io import load_world
from worlds.world import StartPose

OFF, LINES, POINTS = 50, 33, 51


def two_robots() -> Emulator:
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, StartPose(0.0, 0.0), N200)
    simulation.add_robot(2, StartPose(50.0, 0.0), N200)
    return Emulator(simulation)


def test_it_is_shown_while_nobody_is_there_or_anybody_has_it_on() -> None:
    assert is_shown([])
    assert is_shown([("a", OFF), ("b", LINES)])
    assert not is_shown([("a", OFF), ("b", 0)])


def test_a_picture_has_no_laser_of_a_robot_whose_clients_all_have_it_off_and_tells_that_it_went() -> None:
    album = Album(two_robots())

    def look(modes: dict[int, list[tuple[str, int]]]) -> Any:
        before = album.number
        for _ in range(LASER_EVERY):
            album.take(lasers=None, modes=modes)
        return album.since(before)

    told = look({1: [("a", POINTS)], 2: [("b", OFF)]})
    assert set(told["lasers"]) == {"1"}
    assert told["laser_modes"] == {"1": [("a", POINTS)], "2": [("b", OFF)]}
    told = look({1: [("a", OFF)], 2: [("b", OFF)]})
    assert told["lasers"] == {}
    told = look({1: [("a", OFF)], 2: [("b", OFF)]})
    assert not {"lasers", "laser_modes"} & set(told)
    assert set(look({1: [], 2: [("b", OFF)]})["lasers"]) == {"1"}


def test_each_client_is_named_with_its_mode_and_pages_are_none_of_them() -> None:
    def two_clients(place: str) -> None:
        for number, mode in ((1, OFF), (2, LINES)):
            robot = connect(f"nserver://{place}/{number}")
            robot.configure_laser(mode=mode)
            asked.append(robot)

    asked: list[Any] = []

    async def told(page: Page) -> Any:
        return (await page.until(lambda message: "laser_modes" in message))["laser_modes"]

    async def scenario() -> None:
        async with served(two_robots()) as here, here.page() as page:
            assert await told(page) == {"1": [], "2": []}
            await page.say(do="watch", traffic=False, laser=True)
            await page.say(do="call", id=1, robot=1, call="st", args=[])
            await page.answer(1)
            await page.until(lambda message: set(message.get("lasers", ())) == {"1", "2"})
            await asyncio.to_thread(two_clients, dict(here.daemon.lines())["nserver"])
            last = await page.until(lambda message: message.get("lasers", {}).keys() == {"2"})
            assert "laser_modes" not in last or last["laser_modes"]["1"]
            modes = laser_modes(here.daemon.connections, (1, 2))
            assert [[mode for _, mode in modes[number]] for number in (1, 2)] == [[OFF], [LINES]]
            assert all(name.startswith("127.0.0.1:") for clients in modes.values() for name, _ in clients)
            for robot in asked:
                await asyncio.to_thread(robot.disconnect)

    asyncio.run(scenario())


def test_of_a_crowd_those_who_have_it_on_are_named_first() -> None:
    class Visitor:
        """As much of a connection as counts."""

        is_connected, line = True, "nserver"

        def __init__(self, name: str, mode: int) -> None:
            wire_state = type("WireState", (), {"laser_mode": mode})()
            context = type("ConnectionContext", (), {"robot_id": 1, "wire_state": wire_state})()
            self.session = type("Session", (), {"context": context, "name": name})()

    crowd: list[Any] = [Visitor(f"client {number:02}", OFF) for number in range(2 * MOST_NAMED)]
    crowd.append(Visitor("z", POINTS))
    named = laser_modes(crowd, (1,))[1]
    assert named[:2] == [("z", POINTS), ("client 00", OFF)]
    assert len(named) == MOST_NAMED
