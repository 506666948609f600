"""Obstacles at the page: moving, deleting, exact undo, with any number of corners; the laser of the selected robot."""

from __future__ import annotations

import json
import math
from pathlib import Path

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import OpenPage, nserver, open_page
from worlds.io import format_world, load_world

OBSTACLES = "nserver.scene.world.obstacles"
CORNERS = 12


# Twelve corners in centimetres, with more decimals than the page shows.
def test_obstacle_with_twelve_corners_is_restored(browser: Browser, tmp_path: Path) -> None:
    angles = [2 * math.pi * k / CORNERS for k in range(CORNERS)]
    corners = [[170.123 + 30 * math.cos(angle), 170 + 30 * math.sin(angle)] for angle in angles]
    file = tmp_path / "pillar.toml"
    pillar = f'\n[[obstacle]]\nname = "pillar"\ncorners_cm = {corners}\n'
    file.write_text(format_world(load_world("thesis_room")) + pillar)
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.set_input_files("#load-world", file)
        page.wait(f"{OBSTACLES}.length === 1")
        before = page.value(f"JSON.stringify({OBSTACLES})")
        left = page.value(f"{OBSTACLES}[0].corners[0][0]")
        page.page.fill("#move-step", "2.5")
        page.page.click("[aria-label='move right pillar']")
        page.wait(f"Math.abs({OBSTACLES}[0].corners[0][0] - {left} - 2.5) < 1e-6")
        page.page.click("#tool-remove")
        page.page.mouse.click(*page.at(67, 67))
        page.wait(f"{OBSTACLES}.length === 0")
        # Undo the deletion, then the move: the obstacle must be exactly the old one.
        page.page.keyboard.press("Control+z")
        page.wait(f"{OBSTACLES}.length === 1 && {OBSTACLES}[0].corners[0][0] > {left} + 2")
        page.page.keyboard.press("Control+z")
        page.wait(f"JSON.stringify({OBSTACLES}) === {json.dumps(before)}")
        page.page.click("#tool-shift")
        page.page.mouse.move(*page.at(67, 67))
        page.page.mouse.down()
        # Onto the robot: refused, and drawn at its old place.
        page.page.mouse.move(*page.at(0, 0), steps=3)
        page.page.mouse.up()
        page.wait("document.querySelector('#notice').innerText.includes('it would overlap a robot')")
        assert page.value(f"JSON.stringify({OBSTACLES})") == before
        page.page.keyboard.press("Control+Shift+z")
        page.wait(f"{OBSTACLES}[0].corners[0][0] > {left} + 2")


def test_laser_of_selected_robot(browser: Browser) -> None:
    with nserver("thesis_room", "--robot", "n200", "--robots", "2") as program, open_page(browser, program.url) as page:
        page.wait("Object.keys(nserver.scene.lasers).join() === '1'")
        page.page.select_option("#robot-choice", "2")
        page.wait("Object.keys(nserver.scene.lasers).join() === '2'")


def undo(page: OpenPage) -> None:
    """Undo the last step and wait for it."""
    page.value("nserver.history.undo()")


def test_viewers_undo_their_own_steps(browser: Browser) -> None:
    corners = f"JSON.stringify({OBSTACLES}.map((thing) => thing.corners[0]))"
    words = "document.querySelector('#notice').innerText"

    def add(page: OpenPage, text: str, count: int) -> None:
        page.page.fill("#corners", text)
        page.page.press("#corners", "Enter")
        page.wait(f"{OBSTACLES}.length === {count}")

    def press(page: OpenPage, word: str, number: int, corner: str) -> None:
        page.wait(f"document.querySelector('#world-list').innerText.includes('obstacle {number}: {corner} ')")
        page.page.click(f"[aria-label='{word} obstacle {number}']")

    with (
        nserver("thesis_room") as program,
        open_page(browser, program.url) as one,
        open_page(browser, program.url) as two,
    ):
        add(one, "40,40 50,40 50,50", 1)
        two.wait(f"{OBSTACLES}.length === 1")
        add(two, "70,40 80,40 80,50", 2)
        one.wait(f"{OBSTACLES}.length === 2")
        press(one, "move up", 1, "40,40")
        two.wait(f"{corners} === '[[40,41],[70,40]]'")
        press(two, "move right", 2, "70,40")
        one.wait(f"{corners} === '[[40,41],[71,40]]'")
        # Each page undoes its own last step, whatever the other has done meanwhile.
        undo(one)
        two.wait(f"{corners} === '[[40,40],[71,40]]'")
        press(one, "delete", 1, "40,40")
        two.wait(f"{corners} === '[[71,40]]'")
        undo(two)
        one.wait(f"{corners} === '[[70,40]]'")
        undo(one)
        two.wait(f"{corners} === '[[40,40],[70,40]]'")
        undo(one)
        two.wait(f"{corners} === '[[70,40]]'")
        one.value("nserver.history.redo()")
        two.wait(f"{corners} === '[[70,40],[40,40]]'")
        press(two, "move up", 2, "40,40")
        one.wait(f"{corners} === '[[70,40],[40,41]]'")
        # The other page has moved the obstacle that this step added: it cannot be undone.
        undo(one)
        one.wait(f"{words}.includes('cannot undo “add obstacle”: ')")
        assert one.value(corners) == "[[70,40],[40,41]]"
        one.page.click("#clear-world")
        # The step ends when the page has read the world that it made.
        one.wait("nserver.history.undoTitle === 'remove all'")
        two.wait(f"{OBSTACLES}.length === 0")
        add(two, "20,60 30,60 30,70", 1)
        undo(one)
        one.wait(f"{words}.includes('cannot undo “remove all”: the world was changed meanwhile')")
        undo(two)
        one.wait(f"{OBSTACLES}.length === 0")


def test_undo_waits_for_running_step(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        # Every reply is late by 300 ms, so that steps overlap.
        page.value(
            """(() => { const request = nserver.link.request; nserver.link.request = async (message) => {
            const answer = await request(message);
            await new Promise((resolve) => setTimeout(resolve, 300));
            return answer; }; })()"""
        )
        for count, corners in enumerate(("40,40 50,40 50,50", "70,40 80,40 80,50"), 1):
            page.page.fill("#corners", corners)
            page.page.press("#corners", "Enter")
            page.wait(f"{OBSTACLES}.length === {count}")
        page.value("Promise.all([nserver.history.undo(), nserver.history.redo(), nserver.history.undo()])")
        page.wait(f"{OBSTACLES}.map((thing) => thing.corners[0][0]).join() === '40'")
        page.wait("document.querySelector('#undo').innerText === 'Undo: add obstacle'")


def test_world_is_chosen_from_gallery(browser: Browser) -> None:
    words = ("hall", "--robots", "2")
    with nserver(*words) as program, open_page(browser, program.url) as page:
        # Whole inches: poses are set in tenths.
        poses = "JSON.stringify(Object.values(nserver.scene.robots).map((one) => one.actual.map(Math.floor)))"
        before = page.value(poses)
        page.page.click("#gallery > summary")
        page.wait("document.querySelectorAll('.gallery button').length > 5")
        page.page.click("#world-arena")
        page.wait("nserver.scene.world.name === 'arena'")
        # The whole world is shown, and the step can be undone.
        page.wait("nserver.map.fitted && Math.abs(nserver.map.view.x - 256) < 20")
        page.page.keyboard.press("Control+z")
        page.wait("nserver.scene.world.name === 'hall'")
        # A robot without room is placed; undo puts it back.
        page.page.click("#world-maze")
        page.wait(f"nserver.scene.world.name === 'maze' && {poses} !== '{before}'")
        page.page.keyboard.press("Control+z")
        page.wait(f"nserver.scene.world.name === 'hall' && {poses} === '{before}'")


def test_walls_are_drawn_dragged_and_deleted(browser: Browser) -> None:
    # The first four walls are the outline of the room.
    walls = "JSON.stringify(nserver.scene.world.walls.slice(4).map((wall) => wall.map(Math.round)))"

    def drag(page: OpenPage, *points: tuple[float, float]) -> None:
        page.page.mouse.move(*page.at(*points[0]))
        page.page.mouse.down()
        for point in points[1:]:
            page.page.mouse.move(*page.at(*point), steps=3)
        page.page.mouse.up()

    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.click("#tool-wall")
        # The second end is near a corner of the room, and joins it.
        drag(page, (60, 60), (101, 101))
        page.wait(f"{walls} === '[[60,60,102,102]]'")
        page.page.click("#tool-shift")
        drag(page, (60, 60), (60, 80))
        page.wait(f"{walls} === '[[60,80,102,102]]'")
        # Dragged in the middle the whole wall moves.
        drag(page, (81, 91), (71, 81))
        page.wait(f"{walls} === '[[50,70,92,92]]'")
        page.page.click("[aria-label='move left wall 1']")
        page.wait(f"{walls} === '[[49,70,91,92]]'")
        page.page.click("#tool-remove")
        page.page.mouse.click(*page.at(70, 81))
        page.wait(f"{walls} === '[]'")
        for text in ("[[49,70,91,92]]", "[[50,70,92,92]]"):
            page.value("nserver.history.undo()")
            page.wait(f"{walls} === '{text}'")


def test_presses_count_while_the_panel_changes(browser: Browser) -> None:
    walls = "JSON.stringify(nserver.scene.world.walls.slice(4))"
    left = "[aria-label='move left wall 1']"
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        page.page.fill("#corners", "60,60 80,80")
        page.page.press("#corners", "Enter")
        page.wait(f'document.querySelector("{left}")')
        # 1. Two presses before the next picture.
        page.value(f'[1, 2].forEach(() => document.querySelector("{left}").click())')
        page.wait(f"{walls} === '[[58,60,78,80]]'")
        # 2. A press before the panel shows the newest picture.
        page.value(
            f"""new Promise((resolve) => {{
            const button = document.querySelector("{left}"), {{ request }} = nserver.link, world = nserver.scene.world;
            request({{ do: 'control', command: 'wall', argument: {{ wall: [[58, 60], [78, 80]], by: [0, 5] }} }});
            const timer = setInterval(() => {{ if (nserver.scene.world !== world) {{
                clearInterval(timer); button.click(); resolve(); }} }}, 0); }})"""
        )
        page.wait(f"{walls} === '[[57,65,77,85]]'")
        # 3. Another client adds an obstacle, and with it a row above, while the button is held down.
        page.page.hover(left)
        page.page.mouse.down()
        robot.add_obstacle(corners_in=((20, 20), (30, 20), (30, 30)))
        page.wait("document.querySelector('#world-list').innerText.includes('obstacle 1')")
        page.page.mouse.up()
        page.wait(f"{walls} === '[[56,65,76,85]]'")
