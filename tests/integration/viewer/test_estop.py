"""Emergency stop in a browser: commands are ignored until Release, and all pages show the state."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from nclient import RobotHeld
from tests.integration.viewer.browsing import nserver, open_page

BANNER = "document.querySelector('#estop-banner').innerText"
RELEASED = "document.querySelector('#estop-banner').hidden"
SPEED = "nserver.scene.robots['1'].state[38]"


def test_stop_blocks_programs_until_release(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        robot.drive(translation_in_s=2)
        page.wait(f"{SPEED} === 20")
        page.page.keyboard.press("Escape")
        page.wait(f"{BANNER}.includes('no robot moves until Release. Stopped by you (viewer 1)')")
        for _ in range(3):
            with pytest.raises(RobotHeld, match="viewer 1"):
                robot.drive(translation_in_s=2)
        page.wait(f"{BANNER}.includes('3 motion commands ignored')")
        assert page.value(SPEED) == 0
        page.page.focus("#pad")
        page.page.keyboard.down("w")
        page.wait("document.querySelector('#notice').innerText.includes('release it first')")
        page.page.keyboard.up("w")
        page.page.focus("#corners")
        page.page.keyboard.press("Shift+R")
        assert page.page.input_value("#corners") == "R"
        assert not page.value(RELEASED)
        page.page.focus("#map")
        page.page.keyboard.press("Shift+R")
        page.wait(RELEASED)
        robot.drive(translation_in_s=2)
        page.wait(f"{SPEED} === 20")


def test_escape_closes_what_is_open_then_stops_own_robot(browser: Browser) -> None:
    held = "Object.keys(nserver.scene.robots).filter((id) => nserver.scene.robots[id].held).join()"
    with nserver("thesis_room", "--robots", "2") as program, open_page(browser, program.url, windows=False) as page:
        # Menu, unfinished outline, tool and notice are closed one after the other.
        page.page.click("[popovertarget=layers]")
        page.page.keyboard.press("Escape")
        assert not page.page.is_visible("#layers")
        page.page.click("#tool-add")
        page.page.mouse.click(*page.at(60, 60))
        page.page.keyboard.press("Escape")
        assert page.value("nserver.toolName") == "add"
        page.page.keyboard.press("Escape")
        assert page.value("nserver.toolName") == "pan"
        page.value("nserver.notice('a notice')")
        page.page.keyboard.press("Escape")
        assert page.value("document.querySelector('#notice').hidden")
        assert page.value(held) == ""
        page.page.keyboard.press("Escape")
        page.wait(f"{held} === '1'")
        # Shift+Space stops all, from a text field too.
        page.page.focus("#corners")
        page.page.keyboard.press("Shift+Space")
        page.wait(f"{held} === '1,2'")
        page.page.click("#release")
        page.wait(RELEASED)
        page.page.select_option("#robot-choice", "2")
        page.page.click("#stop")
        page.wait(f"{held} === '2'")
        page.page.click("#stop-all")
        page.wait(f"{held} === '1,2'")


def test_all_see_stop_and_read_only_page_cannot_release(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        watch = program.url.split("token=")[0] + "token=" + page.value("nserver.watchToken")
        page.page.click("#stop")
        with open_page(browser, watch) as other:
            other.wait(f"{BANNER}.includes('Stopped by viewer 1.')")
            assert not other.page.is_visible("#release")
            other.page.keyboard.press("Shift+R")
            other.page.wait_for_timeout(200)
            assert not page.value(RELEASED)
            page.page.click("#release")
            other.wait(RELEASED)


@pytest.mark.parametrize("viewport", [(390, 844), (360, 640), (844, 390)])
def test_stop_and_release_stay_visible_on_phone(browser: Browser, viewport: tuple[int, int]) -> None:
    width, height = viewport
    with (
        nserver("thesis_room", "--robots", "2") as program,
        open_page(browser, program.url, viewport={"width": width, "height": height}) as page,
    ):
        page.page.click("#stop")
        page.wait(f"!{RELEASED}")
        page.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        for name in ("stop", "release"):
            box = page.page.locator(f"#{name}").bounding_box()
            assert box is not None
            assert min(box["x"], box["y"]) >= 0
            assert box["x"] + box["width"] <= width
            assert box["y"] + box["height"] <= height / 3
        assert page.value("document.documentElement.scrollWidth") <= width
        page.page.click("#release")
        page.wait(RELEASED)
