"""Actions at the page, by pointer and by keyboard, and their effect on clients of the same server."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import OpenPage, nserver, open_page
from worlds.io import load_world


def drag(page: OpenPage, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Drag with the active tool from one point of the world to another."""
    page.page.mouse.move(*page.at(*start))
    page.page.mouse.down()
    page.page.mouse.move(*page.at(*end), steps=4)
    page.page.mouse.up()


def test_obstacle_drawn_by_pointer_changes_sonar(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        # From the sonar ring to the wall ahead: 102.17 - 9.06 = 93.1 in.
        assert robot.refresh().sonars_in[0] == 93
        page.page.click("#tool-add")
        drag(page, (50, -8), (60, 8))
        page.wait("nserver.scene.world.obstacles.length === 1")
        left = page.value("Math.min(...nserver.scene.world.obstacles[0].corners.map((corner) => corner[0]))")
        # Reading of sonar 0: the distance to the obstacle's left side minus the ring's radius.
        page.wait(f"nserver.scene.robots['1'].state[17] === {math.floor(left - 9.06 + 0.5)}")
        assert abs(robot.refresh().sonars_in[0] - (left - 9.06)) <= 1
        page.page.click("#tool-shift")
        drag(page, (55, 0), (65, 0))
        page.wait(f"nserver.scene.world.obstacles[0].corners.every((corner) => corner[0] > {left + 9})")
        page.page.click("#tool-remove")
        page.page.mouse.click(*page.at(65, 0))
        page.wait("nserver.scene.world.obstacles.length === 0")
        # Undo in reverse order: the deletion, the move, the addition.
        for step, count, middle in (("delete", 1, 65), ("move", 1, 55), ("add", 0, None)):
            page.page.click(f"#undo:has-text('{step} obstacle')")
            page.wait(f"nserver.scene.world.obstacles.length === {count}")
            if middle:
                page.wait(f"Math.abs(nserver.scene.world.obstacles[0].corners[0][0] + 5 - {middle}) < 1")


def test_obstacle_by_clicks_and_by_keyboard(browser: Browser) -> None:
    hint = "document.querySelector('#tool-hint').innerText"
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.click("#tool-add")
        # The last click is on the first corner and closes the outline.
        for corner in ((40, 40), (60, 40), (50, 60), (40, 40)):
            page.page.mouse.click(*page.at(*corner))
        page.wait("nserver.scene.world.obstacles.length === 1")
        assert len(page.value("nserver.scene.world.obstacles[0].corners")) == 3
        # Enter closes an outline, then it finishes the tool.
        for corner in ((10, 80), (20, 80), (15, 90)):
            page.page.mouse.click(*page.at(*corner))
        page.page.keyboard.press("Enter")
        page.wait("nserver.scene.world.obstacles.length === 2")
        page.page.keyboard.press("Enter")
        assert page.value("nserver.toolName") == "pan"
        page.value("nserver.history.undo()")
        page.wait("nserver.scene.world.obstacles.length === 1")
        # A tool says what it wants where it can do nothing.
        for tool, words in (("remove", "nothing to delete"), ("place", "no robot"), ("waypoint", "cannot stand")):
            page.page.click(f"#tool-{tool}")
            page.page.mouse.click(*page.at(45, 45) if tool == "waypoint" else page.at(80, 80))
            page.wait(f"{hint}.includes('{words}')")
        page.page.click("#tool-pan")
        page.page.fill("#corners", "70,70 80,70 80,80 70,80")
        page.page.press("#corners", "Tab")
        page.page.keyboard.press("Enter")
        page.wait("nserver.scene.world.obstacles.length === 2")
        page.page.fill("#corners", "70,70 80")
        page.page.click("#add-corners")
        assert "Corners must be pairs" in page.page.inner_text("#notice")
        page.page.fill("#corners", "-5,-5 5,-5 5,5")
        page.page.click("#add-corners")
        page.wait("document.querySelector('#notice').innerText.includes('not possible there') "
                  "|| document.querySelector('#notice').innerText.includes('range of values')")


def test_robot_is_dragged_turned_and_placed(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        page.page.click("#tool-place")
        drag(page, (3, 2), (43, 32))
        page.wait("Math.abs(nserver.scene.robots['1'].actual[0] - 40) < 1")
        assert robot.truth().y_in == pytest.approx(30, abs=0.6)
        page.page.click("#tool-turn")
        drag(page, (43, 32), (40, 60))
        page.wait("Math.abs(nserver.scene.robots['1'].actual[2] - Math.PI / 2) < 0.05")
        page.page.fill("#window-pose input[step='any'] >> nth=0", "20")
        page.page.click("#place-robot")
        page.wait("nserver.scene.robots['1'].actual[0] === 20")
        page.page.click("#tool-place")
        # Into the wall: the robot stays where it was.
        drag(page, (20, 0), (-11, 0))
        page.wait("!document.querySelector('#notice').hidden")
        assert robot.truth().x_in == pytest.approx(20)


def test_keys_drive_while_pressed_and_stop_button_stops(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        page.page.focus("#pad")
        page.page.keyboard.down("w")
        page.wait("nserver.scene.robots['1'].state[38] === 100")
        # Longer than the timeout of a drive message: the page repeats it while the key is down.
        page.page.wait_for_timeout(900)
        assert robot.refresh().moving
        page.page.keyboard.up("w")
        page.wait("nserver.scene.robots['1'].state[38] === 0")
        assert robot.truth().x_in > 5
        robot.drive(steering_rad_s=0.5)
        page.wait("nserver.scene.robots['1'].state[41] !== 0")
        page.page.click("#stop")
        page.wait("nserver.scene.robots['1'].state[41] === 0")
        page.page.click("#release")
        page.wait("document.querySelector('#estop-banner').hidden")
        robot.drive(steering_rad_s=0.5)
        page.wait("nserver.scene.robots['1'].state[41] !== 0")
        page.page.focus("#map")
        page.page.keyboard.press("Space")
        page.wait("nserver.scene.robots['1'].state[41] === 0")


def test_closing_the_page_stops_driving(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        box = page.page.locator("#pad").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.page.mouse.move(x, y)
        page.page.mouse.down()
        page.page.mouse.move(x, y - box["height"] / 4)
        page.wait("nserver.scene.robots['1'].state[38] === 50")
        # The page is closed while the pointer is down.
        page.page.close()
        robot.wait_until_still(timeout_s=5)
        assert not robot.refresh().moving


@pytest.mark.parametrize("by_keyboard", [False, True])
def test_get_robot_conf_gets_pose_from_page(browser: Browser, by_keyboard: bool) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        found: list[Any] = []
        asking = threading.Thread(target=lambda: found.append(robot.ask_pose()), daemon=True)
        asking.start()
        page.wait("document.querySelector('#pose-request').innerText.includes('requests a pose')")
        if by_keyboard:  # the request is shown as long as the program waits
            page.page.click("#tool-pan")
            page.page.click("#stop")
            page.page.wait_for_timeout(200)
            assert page.page.is_visible("#pose-request")
        if by_keyboard:
            page.page.fill("#window-pose input[step='any'] >> nth=0", "50")
            page.page.fill("#window-pose input[step='any'] >> nth=1", "20")
            page.page.focus("#give-pose")
            page.page.keyboard.press("Enter")
        else:
            # From the position to the direction: 90 deg.
            drag(page, (50, 20), (50, 60))
        asking.join(timeout=10)
        (pose,) = found
        assert (pose.x_in, pose.y_in) == pytest.approx((50, 20), abs=0.5)
        assert pose.steering_rad == pytest.approx(0 if by_keyboard else math.pi / 2, abs=0.02)
        page.wait("document.querySelector('#pose-request').hidden && nserver.toolName === 'pan'")


def test_pause_step_speed_and_faults(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.click("#pause")
        page.wait("nserver.scene.paused")
        before = page.value("nserver.scene.time_s")
        page.page.click("#step")
        page.wait(f"Math.abs(nserver.scene.time_s - {before} - 0.1) < 0.002")
        page.page.click("#pause")
        page.page.fill("#factor", "5")
        page.page.press("#factor", "Tab")
        page.wait("nserver.scene.speed === 5 && !nserver.scene.paused")
        page.page.click("text=Fault injection")
        page.page.fill("#faults", '[[rule]]\nkind = "unknown"\n')
        page.page.click("#faults-set")
        page.wait("document.querySelector('#notice').innerText.includes('the page')")


def test_open_faults_lose_neither_text_nor_notice(browser: Browser) -> None:
    """The browser reports an opened part later: what was typed and reported until then must stay."""
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.value("""(async () => {
            const part = document.querySelector('#faults-part');
            const isReported = new Promise((resolve) => part.addEventListener('toggle', resolve, { once: true }));
            part.open = true;
            document.querySelector('#faults').value = '[[rule]]\\nkind = "unknown"\\n';
            document.querySelector('#faults-set').click();
            await isReported; })()""")
        page.wait("document.querySelector('#faults-counts').innerText === 'no faults are active'")
        assert "the page" in page.page.inner_text("#notice")
        assert "unknown" in page.page.input_value("#faults")


def test_saved_world_can_be_loaded(browser: Browser, tmp_path: Path) -> None:
    with nserver("centre_vertex") as program, open_page(browser, program.url) as page:
        page.page.fill("#corners", "70,70 80,70 80,80")
        page.page.click("#add-corners")
        page.wait("nserver.scene.world.obstacles.some((thing) => thing.corners[0][0] === 70)")
        with page.page.expect_download() as saved:
            page.page.click("#save-world")
        file = tmp_path / "again.toml"
        saved.value.save_as(file)
        page.page.click("text=Remove all obstacles")
        page.wait("nserver.scene.world.obstacles.length === 0")
        page.page.set_input_files("#load-world", file)
        page.wait("nserver.scene.world.obstacles.some((thing) => thing.corners[0][0] === 70)")
    again, original = load_world(file), load_world("centre_vertex")
    assert again.fixed_walls == pytest.approx(original.fixed_walls)
    assert len(again.obstacles) == len(original.obstacles) + 1
    assert len(again.rooms) == len(original.rooms)
    assert again.starts == original.starts


def test_read_only_page_has_no_controls(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        watch = program.url.split("token=")[0] + "token=" + page.value("nserver.watchToken")
        with open_page(browser, watch) as other:
            other.wait("document.body.classList.contains('read-only')")
            assert not other.page.is_visible("#stop")
            assert not other.page.is_visible("#window-drive")
            assert other.page.is_visible("#window-robot")
