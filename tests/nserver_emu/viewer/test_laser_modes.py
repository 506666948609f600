"""Laser modes that decide whether the laser is shown: those of the robot's clients, not of pages."""

from __future__ import annotations

import asyncio
from typing import Any

from nclient import connect
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.models import N200
from nserver_emu.simulation.simulation import Simulation
from nserver_emu.viewer.scene import LASER_INTERVAL, MAX_NAMED, SceneHistory, is_shown, laser_modes
from tests.nserver_emu.viewer.page_client import Page, serve_viewer
from worlds.io import load_world
from worlds.world import StartPose

# Mode 50 has bit 0 cleared: the laser is off.
OFF, LINES, POINTS = 50, 33, 51


def two_robots() -> Emulator:
    simulation = Simulation(load_world("thesis_room"))
    simulation.add_robot(1, StartPose(0.0, 0.0), N200)
    simulation.add_robot(2, StartPose(50.0, 0.0), N200)
    return Emulator(simulation)


def test_the_laser_is_shown_without_clients_or_if_any_has_it_on() -> None:
    assert is_shown([])
    assert is_shown([("a", OFF), ("b", LINES)])
    assert not is_shown([("a", OFF), ("b", 0)])


def test_the_laser_disappears_when_all_clients_switch_it_off() -> None:
    history = SceneHistory(two_robots())

    def look(modes: dict[int, list[tuple[str, int]]]) -> Any:
        # LASER_INTERVAL pictures, so that the laser is measured once.
        before = history.number
        for _ in range(LASER_INTERVAL):
            history.take(lasers=None, modes=modes)
        return history.since(before)

    picture = look({1: [("a", POINTS)], 2: [("b", OFF)]})
    assert set(picture["lasers"]) == {"1"}
    assert picture["laser_modes"] == {"1": [("a", POINTS)], "2": [("b", OFF)]}
    picture = look({1: [("a", OFF)], 2: [("b", OFF)]})
    # An empty list once, so that the page clears the points; then nothing.
    assert picture["lasers"] == {}
    picture = look({1: [("a", OFF)], 2: [("b", OFF)]})
    assert not {"lasers", "laser_modes"} & set(picture)
    assert set(look({1: [], 2: [("b", OFF)]})["lasers"]) == {"1"}


async def test_clients_are_listed_with_modes_and_pages_are_not() -> None:
    def two_clients(place: str) -> None:
        for number, mode in ((1, OFF), (2, LINES)):
            robot = connect(f"nserver://{place}/{number}")
            robot.configure_laser(mode=mode)
            asked.append(robot)

    asked: list[Any] = []

    async def picture(page: Page) -> Any:
        return (await page.until(lambda message: "laser_modes" in message))["laser_modes"]

    async with serve_viewer(two_robots()) as here, here.page() as page:
        assert await picture(page) == {"1": [], "2": []}
        await page.send_message(do="watch", traffic=False, laser=True)
        await page.send_message(do="call", id=1, robot=1, call="st", args=[])
        await page.answer(1)
        await page.until(lambda message: set(message.get("lasers", ())) == {"1", "2"})
        await asyncio.to_thread(two_clients, dict(here.daemon.lines())["nserver"])
        # The client of robot 1 has the laser off, so only that of robot 2 is shown.
        last = await page.until(lambda message: message.get("lasers", {}).keys() == {"2"})
        assert "laser_modes" not in last or last["laser_modes"]["1"]
        modes = laser_modes(here.daemon.connections, (1, 2))
        assert [[mode for _, mode in modes[number]] for number in (1, 2)] == [[OFF], [LINES]]
        assert all(name.startswith("127.0.0.1:") for clients in modes.values() for name, _ in clients)
        for robot in asked:
            await asyncio.to_thread(robot.disconnect)


def test_of_many_clients_those_with_the_laser_on_come_first() -> None:
    class Connection:
        """As much of a connection as counts."""

        is_connected, line = True, "nserver"

        def __init__(self, name: str, mode: int) -> None:
            wire_state = type("WireState", (), {"laser_mode": mode})()
            context = type("Context", (), {"robot_id": 1, "wire_state": wire_state})()
            self.session = type("Session", (), {"context": context, "name": name})()

    # More clients than are named; the one with the laser on is the last by name.
    crowd: list[Any] = [Connection(f"client {number:02}", OFF) for number in range(2 * MAX_NAMED)]
    crowd.append(Connection("z", POINTS))
    named = laser_modes(crowd, (1,))[1]
    assert named[:2] == [("z", POINTS), ("client 00", OFF)]
    assert len(named) == MAX_NAMED
