"""Doors and people who walk, at the page: added, opened, moved, deleted, undone; the same commands from a terminal."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import OpenPage, nserver, open_page

DOORS = (
    "JSON.stringify((nserver.scene.world.doors ?? []).map("
    "({ name, ends, open }) => ({ name, ends: ends.map((at) => at.map(Math.round)), open })))"
)
ROUTES = (
    "JSON.stringify((nserver.scene.world.walkers ?? []).map(({ points }) => points.map((at) => at.map(Math.round))))"
)


def click(page: OpenPage, *points: tuple[float, float]) -> None:
    """Click on points of the world."""
    for point in points:
        page.page.mouse.click(*page.at(*point))


def test_doors_are_added_opened_and_deleted(browser: Browser) -> None:
    door = '{"name":"1","ends":[[70,90],[102,102]],"open":%s}'
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.click("#tool-door")
        page.page.mouse.move(*page.at(70, 90))
        page.page.mouse.down()
        page.page.mouse.move(*page.at(101, 101), steps=3)
        page.page.mouse.up()
        page.wait(f"{DOORS} === '[{door % 'false'}]'")
        # A click with the tool that moves the map opens it, the button in the panel closes it.
        page.page.keyboard.press("Escape")
        click(page, (86, 96))
        page.wait(f"{DOORS} === '[{door % 'true'}]'")
        page.page.click("[aria-label='close door 1']")
        page.wait(f"{DOORS} === '[{door % 'false'}]'")
        page.value("nserver.history.undo()")
        page.wait(f"{DOORS} === '[{door % 'true'}]'")
        page.page.click("[aria-label='move left door 1']")
        page.wait(f"{DOORS}.includes('[[69,90],[101,102]]')")
        page.page.click("#tool-remove")
        click(page, (85, 96))
        page.wait(f"{DOORS} === '[]'")
        page.value("nserver.history.undo()")
        page.wait(f"{DOORS}.includes('[[69,90],[101,102]]')")


def test_walkers_are_added_watched_and_deleted(browser: Browser) -> None:
    with nserver("thesis_room", "--speed", "4") as program, open_page(browser, program.url) as page:
        page.page.fill("#walking-speed", "10")
        page.page.click("#tool-walker")
        click(page, (30, 80), (80, 80), (80, 92))
        page.page.keyboard.press("Enter")
        page.wait(f"{ROUTES} === '[[[30,80],[80,80],[80,92]]]'")
        assert page.value("nserver.scene.world.walkers[0].speed") == 10
        page.wait("nserver.scene.walkers[0][1] > 82")
        page.page.click("#tool-shift")
        page.page.mouse.move(*page.at(55, 80))
        page.page.mouse.down()
        page.page.mouse.move(*page.at(55, 75), steps=3)
        page.page.mouse.up()
        page.wait(f"{ROUTES} === '[[[30,75],[80,75],[80,87]]]'")
        page.page.click("[aria-label='delete walker 1']")
        page.wait(f"{ROUTES} === '[]' && nserver.scene.walkers.length === 0")
        page.value("nserver.history.undo()")
        page.wait(f"{ROUTES} === '[[[30,75],[80,75],[80,87]]]'")
        # A route through a wall is refused.
        page.page.click("#tool-walker")
        page.value("nserver.link.request({do: 'control', command: 'wall', argument: {put: [[50, 20], [50, 60]]}})")
        page.wait("nserver.scene.world.walls.length === 5")
        click(page, (30, 40), (70, 40))
        page.page.keyboard.press("Enter")
        page.wait("document.querySelector('#notice').innerText.includes('expected a route clear of walls')")
        # Its points stay, so that it can be added when the wall is gone.
        page.value("nserver.link.request({do: 'control', command: 'wall', argument: {wall: [[50, 20], [50, 60]]}})")
        page.page.keyboard.press("Enter")
        page.wait(f"{ROUTES} === '[[[30,75],[80,75],[80,87]],[[30,40],[70,40]]]'")
