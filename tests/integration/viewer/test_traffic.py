"""The window Traffic in a browser: rows of requests and replies, filtered, and opened to their bytes."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page
from tests.waiting import wait_until

LOG = "document.querySelector('#window-traffic .log')"


def test_traffic_is_shown_and_filtered(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        robot.refresh()
        page.page.click("#window-traffic > summary")
        page.wait("nserver.link && document.querySelector('#window-traffic').open")
        # The server learns that the window is open from a message that may come after the first request.
        wait_until(lambda: bool(robot.refresh() and page.value(f"{LOG}.childElementCount > 0")))
        robot.drive(translation_in_s=5)
        robot.refresh()
        page.wait(f"{LOG}.innerText.includes('> vm 50 0 0')")
        page.wait(f"{LOG}.innerText.includes('< state')")
        page.page.click("text=> vm 50 0 0")
        page.wait(f"{LOG}.innerText.includes('16 bytes: 00 0c 00 03 00 00 00 32')")
        page.wait(f"{LOG}.innerText.includes('vm: code 12, translation 50, steering 0, turret 0')")
        page.page.fill("#traffic-filter", "vm -gs")
        page.wait(f"{LOG}.childElementCount === 2")
        shown = page.value(f"[...{LOG}.querySelectorAll('summary')].map((one) => one.innerText)")
        assert [text.split()[2:4] for text in shown] == [[">", "vm"], ["<", "state"]]
        page.page.fill("#traffic-filter", "")
        page.page.click("#traffic-hold")
        count = page.value(f"{LOG}.childElementCount")
        robot.refresh()
        page.page.wait_for_timeout(300)
        assert page.value(f"{LOG}.childElementCount") == count
        page.page.click("#traffic-hold")
        page.wait(f"{LOG}.childElementCount === {count + 2}")
        page.page.focus("#pad")
        page.page.keyboard.press("w")
        page.wait(f"{LOG}.innerText.includes('viewer 1 on robot 1 > st')")
