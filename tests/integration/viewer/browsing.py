"""A server process, its page in Chromium, and helpers to test both."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from playwright.sync_api import Browser, Page

from nclient import Robot, connect
from tests.programs.forked import Forked

# The shell is the same engine without the browser's own windows, which cost a second of computing per page.
SHELL = "/usr/bin/chromium-headless-shell"
CHROMIUM = os.environ.get("CHROMIUM", SHELL if os.access(SHELL, os.X_OK) else "/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
    # Fewer processes: starting them is most of what a test costs.
    "--renderer-process-limit=1", "--in-process-gpu",
]  # fmt: skip
TIMEOUT_S, PAUSE_MS = 15.0, 20


@dataclass
class OpenPage:
    """An open page, with the errors from its console."""

    page: Page
    errors: list[str] = field(default_factory=list)

    def wait(self, condition: str, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until a JavaScript condition is true.

        The page's application is the variable `nserver`. The page itself checks the condition again and again, as a
        call from here takes milliseconds; its content security policy forbids Playwright's own function for that.
        """
        is_true = self.page.evaluate(
            f"""new Promise((resolve, reject) => {{
            const end_ms = performance.now() + {1000.0 * timeout_s};
            const check = async () => {{
                if (await ({condition})) resolve(true);
                else if (performance.now() > end_ms) resolve(false);
                else setTimeout(() => check().catch(reject), {PAUSE_MS});
            }};
            check().catch(reject); }})"""
        )
        if not is_true:
            notice = self.page.inner_text("#notice")
            raise AssertionError(f"time-out: {condition}" + (f"; the page shows {notice!r}" if notice else ""))

    def value(self, expression: str) -> Any:
        """Return the value of a JavaScript expression."""
        return self.page.evaluate(expression)

    def at(self, x_in: float, y_in: float) -> tuple[float, float]:
        """Return the position in the window of a point of the world."""
        box = self.page.locator("#map").bounding_box()
        assert box is not None
        x, y = self.value(f"nserver.map.screenOf({x_in}, {y_in})")
        return box["x"] + x, box["y"] + y

    def pixel(self, x_in: float, y_in: float) -> tuple[int, int, int]:
        """Return the colour drawn at a point of the world."""
        red, green, blue, _ = self.value(
            f"""(() => {{ const [x, y] = nserver.map.screenOf({x_in}, {y_in}), d = devicePixelRatio;
            const pen = nserver.map.canvas.getContext('2d');
            return [...pen.getImageData(Math.round(x * d), Math.round(y * d), 1, 1).data]; }})()"""
        )
        return red, green, blue


@dataclass
class RunningServer:
    """A running server with a page."""

    port: int
    url: str

    def robot(self, number: int = 1) -> Robot:
        """Connect a client to a robot."""
        return connect(f"nserver://127.0.0.1:{self.port}/{number}")


@contextmanager
def nserver(*words: str) -> Iterator[RunningServer]:
    """Run nserver with these arguments."""
    with Forked("nserver", *words, "--port", "0", "--viewer", "0") as process:
        try:
            port = int(process.stdout.readline().rpartition(":")[2])
            line = process.stdout.readline()
            found = re.fullmatch(r"listening viewer (\S+)\n", line)
            assert found, line
            yield RunningServer(port, found[1])
        finally:
            process.terminate()
            assert process.wait(timeout=10) == 0


OPEN_WINDOWS = "document.querySelectorAll('.window:not(#window-traffic), #raw-state').forEach((one) => one.open = true)"


@contextmanager
def open_page(browser: Browser, url: str, *, windows: bool = True, **context: Any) -> Iterator[OpenPage]:
    """Open a page; errors on its console fail the test. `windows` opens the windows that are closed at first."""
    with browser.new_context(**{"viewport": {"width": 1000, "height": 720}} | context) as made:
        page = made.new_page()
        found = OpenPage(page)
        page.on("console", lambda message: found.errors.extend([message.text] if message.type == "error" else []))
        page.on("pageerror", lambda error: found.errors.append(str(error)))
        page.goto(url)
        found.wait("window.nserver && nserver.scene.world && nserver.map.fitted")
        if windows:
            page.evaluate(OPEN_WINDOWS)
        yield found
        assert found.errors == []
