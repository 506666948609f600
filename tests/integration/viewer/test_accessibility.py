"""Accessibility: axe finds nothing, every control has a name and is reached by Tab in visual order; slow links."""

from __future__ import annotations

import time
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import OpenPage, nserver, open_page

NAMED = """[...document.querySelectorAll('button, input, select, textarea, canvas, summary')]
    .filter((one) => one.checkVisibility() && !(one.ariaLabel || one.innerText || one.labels?.length || one.title))
    .map((one) => one.outerHTML)"""
FOCUSED = """(() => { const one = document.activeElement, group = one.closest('[role=group]')?.ariaLabel;
    return [...(group ? [group] : []), one.ariaLabel || one.labels?.[0]?.innerText || one.innerText].join(': '); })()"""


def test_controls_have_names_on_a_phone(browser: Browser) -> None:
    with (
        nserver("thesis_room") as program,
        open_page(browser, program.url, viewport={"width": 390, "height": 844}) as page,
    ):
        page.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        for task in ("drive", "world", "localize", "observe"):
            page.page.click(f"#show-{task}")
            assert page.value(NAMED) == []


def test_controls_have_names_and_tab_order(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url, reduced_motion="reduce") as page:
        page.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        page.wait("document.querySelector('.gallery').children.length > 0")
        assert page.value(NAMED) == []
        places: list[str] = []
        # Once around the page.
        while len(places) < 150 and places.count("Stop mine") < 2:
            page.page.keyboard.press("Tab")
            places.append(page.value(FOCUSED))
        places.pop()
        wanted = ["Stop mine", "Stop all", "Zoom in", "Robot on the map: Move robot", "Pose: x, in",
                  "Pose: Place robot", "Walls and obstacles on the map: Add obstacle", "Localizer: Localize",
                  "Waypoints: x, in"]
        assert [place for place in places if place in wanted] == wanted
        assert page.value("document.getAnimations().length") == 0


@pytest.mark.parametrize("size", [(1000, 720), (390, 844)], ids=["desktop", "phone"])
def test_axe_finds_no_violations(browser: Browser, size: tuple[int, int]) -> None:
    axe, (width, height) = Axe(), size

    def violations(page: OpenPage) -> list[Any]:
        """Return rule and elements of each violation."""
        found = axe.run(page.page).response["violations"]
        return [(each["id"], [node["html"] for node in each["nodes"]]) for each in found]

    with (
        nserver("two_rooms") as program,
        open_page(browser, program.url, viewport={"width": width, "height": height}, reduced_motion="reduce") as page,
    ):
        page.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        page.wait("document.querySelector('#world-list').children.length > 4")
        if width > 500:
            assert violations(page) == []
            return
        for task in ("drive", "world", "localize", "observe"):
            page.page.click(f"#show-{task}")
            assert violations(page) == []


def test_slow_link_shows_something_within_five_seconds(browser: Browser) -> None:
    with nserver("thesis_room") as program, browser.new_context() as context:
        page = context.new_page()
        link = context.new_cdp_session(page)
        link.send("Network.enable")
        # 50 kbit/s, which is 6,250 bytes per second, and the delay of a mobile network.
        link.send(
            "Network.emulateNetworkConditions",
            {"offline": False, "latency": 200, "downloadThroughput": 6250, "uploadThroughput": 6250},
        )
        begin = time.monotonic()
        page.goto(program.url, wait_until="commit")
        # The browser itself says how long it took until something was painted: the tests' machine may be slow.
        shown = "performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? 0"
        while not (painted_ms := page.evaluate(shown)):
            assert time.monotonic() - begin < 60.0
            page.wait_for_timeout(100)
        assert painted_ms < 5000
        assert "Nserver" in page.inner_text("h1")
