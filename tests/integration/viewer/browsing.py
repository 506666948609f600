"""A daemon as a program, its page in Debian's Chromium, and what the tests ask of both."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from playwright.sync_api import Browser, Page

from nclient import Robot, connect
from tests.programs.forked import Forked

CHROMIUM = os.environ.get("CHROMIUM", "/usr/bin/chromium")
FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
]  # fmt: skip
PATIENCE_S, PAUSE_MS = 15.0, 20


@dataclass
class Opened:
    """An open page. `troubles`: errors on its console, and what it failed at."""

    page: Page
    troubles: list[str] = field(default_factory=list)

    def wait(self, condition: str, patience_s: float = PATIENCE_S, doing: Callable[[], object] = lambda: None) -> None:
        """Until this JavaScript is true, `doing` this before each look; `nserver` is the page's own application.

        Asked again and again from here: the page's policy forbids what Playwright would have it ask itself.
        """
        deadline = time.monotonic() + patience_s
        doing()
        while not self.page.evaluate(condition):
            if time.monotonic() > deadline:
                told = self.page.inner_text("#notice")
                raise AssertionError(f"never came true: {condition}" + (f"; the page says {told!r}" if told else ""))
            self.page.wait_for_timeout(PAUSE_MS)
            doing()

    def value(self, expression: str) -> Any:
        """What this JavaScript comes to."""
        return self.page.evaluate(expression)

    def at(self, x_in: float, y_in: float) -> tuple[float, float]:
        """Where in the window a place of the world is shown."""
        box = self.page.locator("#map").bounding_box()
        assert box is not None
        x, y = self.value(f"nserver.map.screenOf({x_in}, {y_in})")
        return box["x"] + x, box["y"] + y

    def pixel(self, x_in: float, y_in: float) -> tuple[int, int, int]:
        """The colour drawn at a place of the world."""
        red, green, blue, _ = self.value(
            f"""(() => {{ const [x, y] = nserver.map.screenOf({x_in}, {y_in}), d = devicePixelRatio;
            const pen = nserver.map.canvas.getContext('2d');
            return [...pen.getImageData(Math.round(x * d), Math.round(y * d), 1, 1).data]; }})()"""
        )
        return red, green, blue


@dataclass
class Program:
    """A daemon that runs with its page."""

    port: int
    url: str

    def robot(self, number: int = 1) -> Robot:
        """A client of it."""
        return connect(f"nserver://127.0.0.1:{self.port}/{number}")


@contextmanager
def nserver(*words: str) -> Iterator[Program]:
    """The program with these words."""
    with Forked("nserver", *words, "--port", "0", "--viewer", "0") as process:
        try:
            port = int(process.stdout.readline().rpartition(":")[2])
            line = process.stdout.readline()
            found = re.fullmatch(r"listening viewer (\S+)\n", line)
            assert found, line
            yield Program(port, found[1])
        finally:
            process.terminate()
            assert process.wait(timeout=10) == 0


@contextmanager
def opened(browser: Browser, url: str, **context: Any) -> Iterator[Opened]:
    """The page there; it must say nothing on its console."""
    with browser.new_context(**{"viewport": {"width": 1000, "height": 720}} | context) as made:
        page = made.new_page()
        found = Opened(page)
        page.on("console", lambda message: found.troubles.extend([message.text] if message.type == "error" else []))
        page.on("pageerror", lambda error: found.troubles.append(str(error)))
        page.goto(url)
        found.wait("window.nserver && nserver.scene.world && nserver.map.fitted")
        yield found
        assert found.troubles == []
