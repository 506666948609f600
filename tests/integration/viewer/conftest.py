"""One browser for all tests of a worker, with a context per page.

Playwright's event loop runs in the thread that started it. The tests of this folder therefore run in a thread of their
own, so that other tests can run event loops in the main thread.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from playwright.sync_api import Browser, sync_playwright

from tests.integration.viewer.browsing import CHROMIUM, FLAGS

_THREAD = ThreadPoolExecutor(1, "pages")


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool:
    """Run a test in the thread of the browser; its exceptions are raised here."""
    wanted = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    _THREAD.submit(pyfuncitem.obj, **wanted).result()
    return True


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Start Chromium without a display."""
    playwright = _THREAD.submit(sync_playwright().start).result()
    chromium = playwright.chromium
    browser = _THREAD.submit(chromium.launch, executable_path=CHROMIUM, args=FLAGS).result()
    yield browser
    _THREAD.submit(browser.close).result()
    _THREAD.submit(playwright.stop).result()
