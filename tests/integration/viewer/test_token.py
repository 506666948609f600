"""The token in a browser: removed from the address bar and stored only in the tab."""

from __future__ import annotations

from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page


def test_token_is_removed_from_address_and_survives_reload(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        bare, _, token = program.url.partition("?token=")
        assert page.page.url == bare
        page.page.reload()
        page.wait("window.nserver && nserver.scene.world && nserver.mayAct")
        assert page.page.url == bare
        page.page.click("#stop")
        page.wait("!document.querySelector('#estop-banner').hidden")
        page.page.goto(f"{bare}?token={page.value('nserver.watchToken')}")
        page.wait("window.nserver && document.body.classList.contains('read-only')")
        assert page.page.url == bare
        another = page.page.context.new_page()
        another.goto(bare)
        another.wait_for_selector("#link-state:text('token missing')")
        assert another.evaluate("nserver.scene.world") is None
        assert token not in another.content()
