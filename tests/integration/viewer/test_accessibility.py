"""Accessibility: every control has a name and is reached by Tab in visual order."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page

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
        page.page.wait_for_timeout(200)
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
