"""The page in lockstep mode: its commands advance time, except for Stop and Release."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page

TIME = "nserver.scene.time_s"
TEXT = "document.querySelector('#lockstep')"


def test_lockstep_page_explains_time(browser: Browser) -> None:
    with nserver("thesis_room", "--lockstep", "0.05") as program, open_page(browser, program.url) as page:
        page.wait(f"!{TEXT}.hidden && {TEXT}.innerText.includes('by 50 ms, also those of this page')")
        page.page.click("#stop")
        page.wait("!document.querySelector('#estop-banner').hidden")
        page.page.click("#release")
        page.wait("document.querySelector('#estop-banner').hidden")
        assert page.value(TIME) == 0
        page.page.fill("#corners", "60,60 70,60 70,70")
        page.page.press("#corners", "Enter")
        page.wait("nserver.scene.world.obstacles.length === 1")
        assert page.value(TIME) == pytest.approx(0.05 * round(page.value(TIME) / 0.05))
        assert page.value(TIME) > 0


def test_no_lockstep_text_in_real_time(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.wait("document.querySelector('#factor').value === '1'")
        assert page.value(f"{TEXT}.hidden")
