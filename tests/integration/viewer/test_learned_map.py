"""A learned map at the page: opened, a taped length entered, undone; what contradicts the map is refused."""

from __future__ import annotations

import json
from pathlib import Path
from urllib.request import Request, urlopen

import pytest
from playwright.sync_api import Browser

from localization.mapping.adjust import TapeLength, adjust_walls
from tests.integration.viewer.browsing import OpenPage, nserver, open_page
from tests.localization.cli.test_map import LEARNED
from worlds.io import load_world, parse_world

WIDTH = "nserver.scene.world.walls[0][2] - nserver.scene.world.walls[0][0]"


def measure(page: OpenPage, start: tuple[float, float], end: tuple[float, float], length: str) -> None:
    """Drag from one end of a wall to another one, and enter the length between them."""
    if page.page.get_attribute("#tool-length", "aria-pressed") == "false":
        page.page.click("#tool-length")
    page.page.mouse.move(*page.at(*start))
    page.page.mouse.down()
    page.page.mouse.move(*page.at(*end), steps=3)
    page.page.mouse.up()
    page.page.fill("#tape-length", length)
    page.page.press("#tape-length", "Enter")


def test_map_adjusts_to_a_taped_length(browser: Browser, tmp_path: Path) -> None:
    room = tmp_path / "room.toml"
    room.write_text(LEARNED)
    with nserver(str(room)) as program, open_page(browser, program.url) as page:
        measure(page, (1, 1), (99, 1), "100.4")
        page.wait(f"Math.abs({WIDTH} - 100.28) < 0.03", 60.0)
        page.wait("document.querySelector('#tapes').innerText.includes('0,0 to 100,0: 100.40 in')")
        # The second length is entered beside the first, which stays true.
        measure(page, (0, 80), (0, 0), "80.1")
        page.wait("document.querySelector('#tapes').children.length === 2", 60.0)
        assert abs(page.value(WIDTH) - 100.3) < 0.06
        # Each length counts once, as if both were given to `nomad map edit` with the learned map.
        request = "nserver.link.request({ do: 'control', command: 'world show' }).then((one) => one.result.text)"
        tapes = [TapeLength(((1.0, 1.0), (99.0, 1.0)), 100.4), TapeLength(((0.0, 80.0), (0.0, 0.0)), 80.1)]
        once = adjust_walls(load_world(room), tapes).world.accuracies
        shown = parse_world(page.value(request), "page", "room").accuracies
        assert shown.keys() == once.keys()
        assert [shown[k][:3] for k in once] == [pytest.approx(once[k][:3], rel=1e-3) for k in once]
        page.value("nserver.history.undo()")
        page.wait("document.querySelector('#tapes').children.length === 1")
        page.value("nserver.history.undo()")
        page.wait(f"{WIDTH} === 100 && document.querySelector('#tapes').children.length === 0")
        measure(page, (1, 1), (99, 1), "150")
        page.wait("document.querySelector('#notice').innerText.includes('contradicts the map')", 60.0)
        assert page.value(WIDTH) == 100


def test_walls_are_joined_at_their_corner_or_to_one(browser: Browser, tmp_path: Path) -> None:
    room = tmp_path / "room.toml"
    walls = ([[0, 0], [60, 0]], [[80, 20], [80, 90]], [[10, 60], [30, 60]], [[40, 60], [60, 61]])
    room.write_text("".join(f"[[wall]]\npoints_in = {ends}\noffset_std_in = 0.1\n" for ends in walls))
    shown = "JSON.stringify(nserver.scene.world.walls)"
    with nserver(str(room), "--start", "30,30,0,0") as program, open_page(browser, program.url) as page:
        page.page.click("#tool-join")
        for x, y in ((50, 0), (80, 50)):
            page.page.mouse.click(*page.at(x, y))
        page.wait(f"{shown} === '[[0,0,80,0],[80,0,80,90],[10,60,30,60],[40,60,60,61]]'")
        for x_in, y_in in ((20, 60), (50, 60.5)):
            page.page.mouse.click(*page.at(x_in, y_in))
        page.wait(f"{shown} === '[[0,0,80,0],[80,0,80,90],[10,60,60,61]]'")
        # Longer walls keep their accuracy, and undo restores that of the deleted one; a join is one step.
        request = "nserver.link.request({ do: 'control', command: 'world show' })"
        text = f"{request}.then((one) => one.result.text)"
        assert page.value(text).count("offset_std_in = 0.1") == 2
        for _ in range(2):
            page.value("nserver.history.undo()")
        page.wait("nserver.scene.world.walls.length === 4 && nserver.scene.world.walls[0][2] === 60")
        assert page.value(text).count("offset_std_in = 0.1") == 4
        # Where the second wall would touch the robot, the first one does not move either.
        page.value("nserver.link.request({do: 'control', command: 'wall', argument: {put: [[30, 70], [30, 80]]}})")
        page.wait("nserver.scene.world.walls.length === 5")
        for x, y in ((50, 0), (30, 75)):
            page.page.mouse.click(*page.at(x, y))
        page.wait("document.querySelector('#notice').innerText.includes('touch robot 1')")
        page.wait(f"{request}.then((one) => one.result.text.includes('60.0, 0.0'))")


DRAWN = """import('/page/export.js').then((m) => { const colour = nserver.theme.estimate;
    return m.svgOf(nserver).split('<path ').filter((path) => path.includes(`stroke="${colour}"`))
        .map((path) => path.includes('stroke-dasharray')).join(); })"""
SURE, UNSURE = ({"ends": [[0, y], [90, y]], "is_uncertain": y > 0} for y in (0, 90))


def test_map_grows_on_the_page_with_uncertain_walls_dashed(browser: Browser) -> None:
    text = "document.querySelector('#window-learned-map').innerText"
    grown = {"robot": 1, "elapsed_s": 8.0, "pose": [20, 30, 0.0], "points": [], "outcome": ""}
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:

        def publish(**changes: object) -> None:
            message = json.dumps(grown | changes).encode()
            urlopen(Request(program.url.replace("/?", "/publish?"), message, method="POST"), timeout=10).close()

        page.wait(f"{text}.includes(`nomad map learn`) && {text}.includes(`--publish '{program.url}'`)")
        assert page.value(DRAWN) == ""
        publish(walls=[UNSURE])
        page.wait(f"{text}.includes('The map grows.') && {text}.includes('1, 1 of them uncertain')")
        robot = page.value(DRAWN).removeprefix("true,")
        assert robot
        assert "true" not in robot
        publish(walls=[SURE, UNSURE])
        page.wait(f"{text}.includes('2, 1 of them uncertain')")
        assert page.value(DRAWN) == f"false,true,{robot}"
        # The drive is over: the map stays, the robot is no longer drawn.
        publish(walls=[SURE], outcome="Written to room.toml.")
        page.wait(f"{text}.includes('Written to room.toml.')")
        assert page.value(DRAWN) == "false"
        with open_page(browser, program.url) as late:
            late.wait(f"{text}.includes('Written to room.toml.')")


def test_wall_gets_a_name_by_click_and_keeps_it(browser: Browser, tmp_path: Path) -> None:
    room = tmp_path / "room.toml"
    room.write_text(LEARNED)
    names = "JSON.stringify(nserver.scene.world.wall_names ?? {})"
    with nserver(str(room)) as program, open_page(browser, program.url) as page:
        page.page.click("#tool-label")
        page.page.mouse.click(*page.at(50, 0))
        page.page.fill("#wall-name", "window side")
        page.page.press("#wall-name", "Enter")
        page.wait(f"{names} === '{{\"0\":\"window side\"}}'")
        page.wait("document.querySelector('#world-list').innerText.includes('window side')")
        # A measured wall that is named stays measured; the file has the name; undo removes it.
        request = "nserver.link.request({ do: 'control', command: 'world show' }).then((one) => one.result.text)"
        world = parse_world(page.value(request), "page", "room")
        assert "window side" in world.wall_names.values()
        assert len(world.accuracies) == len(load_world(room).accuracies)
        page.value("nserver.history.undo()")
        page.wait(f"{names} === '{{}}'")
