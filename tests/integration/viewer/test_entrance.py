"""The token in a browser: out of the address bar at once, kept by the tab alone."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, opened


def test_the_token_leaves_the_address_and_a_reload_has_it_still(browser: Browser) -> None:
    with nserver("thesis_room") as program, opened(browser, program.url) as page:
        bare, _, token = program.url.partition("?token=")
        assert page.page.url == bare
        page.page.reload()
        page.wait("window.nserver && nserver.scene.world && nserver.mayAct")
        assert page.page.url == bare
        page.page.click("#stop")
        page.wait("!document.querySelector('#held').hidden")
        page.page.goto(f"{bare}?token={page.value('nserver.watchToken')}")
        page.wait("window.nserver && document.body.classList.contains('only-looks')")
        assert page.page.url == bare
        another = page.page.context.new_page()
        another.goto(bare)
        another.wait_for_selector("#link-state:text('no way in without a token')")
        assert another.evaluate("nserver.scene.world") is None
        assert token not in another.content()
