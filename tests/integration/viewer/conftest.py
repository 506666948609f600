"""One browser for all pages of a worker, each page in a context of its own. Its driver has an event loop in the thread
that began it for as long as it is open, so that thread is its own: the tests of this folder run there, and those of
others may run loops of theirs where they are."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from playwright.sync_api import Browser, sync_playwright

from tests.integration.viewer.browsing import CHROMIUM, FLAGS

_THREAD = ThreadPoolExecutor(1, "pages")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool:
    """A test, in the thread of the browser; what it raises is raised here."""
    wanted = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    _THREAD.submit(pyfuncitem.obj, **wanted).result()
    return True


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, without a screen."""
    playwright = _THREAD.submit(sync_playwright().start).result()
    chromium = playwright.chromium
    browser = _THREAD.submit(chromium.launch, executable_path=CHROMIUM, args=FLAGS).result()
    yield browser
    _THREAD.submit(browser.close).result()
    _THREAD.submit(playwright.stop).result()
