"""By keyboard and by name: every control is reached by Tab in the order it is seen, and says what it is, of what."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, opened

NAMED = """[...document.querySelectorAll('button, input, select, textarea, canvas, summary')]
    .filter((one) => one.checkVisibility() && !(one.ariaLabel || one.innerText || one.labels?.length || one.title))
    .map((one) => one.outerHTML)"""
HERE = """(() => { const one = document.activeElement, group = one.closest('[role=group]')?.ariaLabel;
    return [...(group ? [group] : []), one.ariaLabel || one.labels?.[0]?.innerText || one.innerText].join(': '); })()"""


def test_every_control_has_a_name_and_its_turn(browser: Browser) -> None:
    with nserver("thesis_room") as program, opened(browser, program.url, reduced_motion="reduce") as page:
        page.page.evaluate("for (const one of document.querySelectorAll('details')) one.open = true")
        page.page.wait_for_timeout(200)
        assert page.value(NAMED) == []
        places = []
        for _ in range(45):
            page.page.keyboard.press("Tab")
            places.append(page.value(HERE))
        wanted = ["Stop", "Zoom in", "Move map", "A pose: x, in", "A pose: Place robot", "Waypoints: x, in"]
        assert [place for place in places if place in wanted] == wanted
        assert page.value("document.getAnimations().length") == 0
