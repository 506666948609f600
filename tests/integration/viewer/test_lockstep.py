"""A page of a simulation in lockstep: what it does moves time, as it says, but for Stop and Release."""

from __future__ import annotations

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, opened

TIME = "nserver.scene.time_s"
WORDS = "document.querySelector('#lockstep')"


def test_it_says_that_its_own_commands_move_time(browser: Browser) -> None:
    with nserver("thesis_room", "--lockstep", "0.05") as program, opened(browser, program.url) as page:
        page.wait(f"!{WORDS}.hidden && {WORDS}.innerText.includes('by 50 ms, those of this page too')")
        page.page.click("#stop")
        page.wait("!document.querySelector('#held').hidden")
        page.page.click("#release")
        page.wait("document.querySelector('#held').hidden")
        assert page.value(TIME) == 0
        page.page.fill("#corners", "60,60 70,60 70,70")
        page.page.press("#corners", "Enter")
        page.wait("nserver.scene.world.obstacles.length === 1")
        assert page.value(TIME) == pytest.approx(0.05 * round(page.value(TIME) / 0.05))
        assert page.value(TIME) > 0


def test_who_runs_by_the_clock_reads_nothing_of_it(browser: Browser) -> None:
    with nserver("thesis_room") as program, opened(browser, program.url) as page:
        page.wait("document.querySelector('#factor').value === '1'")
        assert page.value(f"{WORDS}.hidden")
