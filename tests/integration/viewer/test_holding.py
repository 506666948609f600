"""Stop holds, in a browser: what a program says moves nothing until somebody releases, and all of that can be seen."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, opened

HELD = "document.querySelector('#held').innerText"
FREE = "document.querySelector('#held').hidden"
SPEED = "nserver.scene.robots['1'].state[38]"


def test_a_program_drives_nothing_until_it_is_released(browser: Browser) -> None:
    with nserver("thesis_room") as program, opened(browser, program.url) as page, program.robot() as robot:
        robot.drive(translation_in_s=2)
        page.wait(f"{SPEED} === 20")
        page.page.keyboard.press("Escape")
        page.wait(f"{HELD}.includes('nothing moves until Release. Stopped by you (viewer 1)')")
        for _ in range(3):
            robot.drive(translation_in_s=2)
        page.wait(f"{HELD}.includes('3 commands to move ignored')")
        assert page.value(SPEED) == 0
        page.page.focus("#pad")
        page.page.keyboard.down("w")
        page.wait("document.querySelector('#notice').innerText.includes('release it first')")
        page.page.keyboard.up("w")
        page.page.focus("#corners")
        page.page.keyboard.press("Shift+R")
        assert page.page.input_value("#corners") == "R"
        assert not page.value(FREE)
        page.page.focus("#map")
        page.page.keyboard.press("Shift+R")
        page.wait(FREE)
        robot.drive(translation_in_s=2)
        page.wait(f"{SPEED} === 20")


def test_everybody_sees_who_holds_and_who_only_looks_releases_nothing(browser: Browser) -> None:
    with nserver("thesis_room") as program, opened(browser, program.url) as page:
        watch = program.url.split("token=")[0] + "token=" + page.value("nserver.watchToken")
        page.page.click("#stop")
        with opened(browser, watch) as other:
            other.wait(f"{HELD}.includes('Stopped by viewer 1.')")
            assert not other.page.is_visible("#release")
            other.page.keyboard.press("Shift+R")
            other.page.wait_for_timeout(200)
            assert not page.value(FREE)
            page.page.click("#release")
            other.wait(FREE)


@pytest.mark.parametrize("viewport", [(390, 844), (360, 640), (844, 390)])
def test_stop_and_release_stay_in_reach_on_a_phone(browser: Browser, viewport: tuple[int, int]) -> None:
    width, height = viewport
    with (
        nserver("thesis_room", "--robots", "2") as program,
        opened(browser, program.url, viewport={"width": width, "height": height}) as page,
    ):
        page.page.click("#stop")
        page.wait(f"!{FREE}")
        page.page.evaluate("window.scrollTo(0, document.body.scrollHeight)")
        for name in ("stop", "release"):
            box = page.page.locator(f"#{name}").bounding_box()
            assert box is not None
            assert min(box["x"], box["y"]) >= 0
            assert box["x"] + box["width"] <= width
            assert box["y"] + box["height"] <= height / 3
        assert page.value("document.documentElement.scrollWidth") <= width
        page.page.click("#release")
        page.wait(FREE)
