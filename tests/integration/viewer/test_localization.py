"""`nomad localize --publish` in a browser: the estimate is where it says, and way-points clicked there are gone to."""

from __future__ import annotations

import subprocess
import sys

import pytest
from browsing import nserver, opened
from playwright.sync_api import Browser


def test_an_estimate_is_shown_and_waypoints_come_back(browser: Browser) -> None:
    words = ("thesis_room", "--noisy", "--seed", "1", "--speed", "4")
    with nserver(*words) as program, opened(browser, program.url) as page:
        command = [
            sys.executable, "-c", "import sys; from nclient.cli import main; sys.exit(main())", "localize",
            f"nserver://127.0.0.1:{program.port}/1",
            "--map", "thesis_room", "--waypoints", "60,0", "--publish", program.url,
        ]  # fmt: skip
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as localizer:
            page.wait("document.querySelector('#window-localization').innerText.includes('0 of 1 reached')")
            page.wait("nserver.map.shown.estimate")
            page.page.click("#tool-waypoint")
            page.page.mouse.click(*page.at(30, 30))
            page.wait("document.querySelector('#window-localization').innerText.includes('2 of 2 reached')")
            out, _ = localizer.communicate(timeout=60)
        assert localizer.returncode == 0
        assert "2 of 2 way-points reached" in out
        x, y = page.value("nserver.scene.robots['1'].actual.slice(0, 2)")
        assert (x, y) == pytest.approx((30, 30), abs=2)
        words = page.value("document.querySelector('#window-localization').innerText")
        assert " used, " in words
        axes = page.value("import('/page/localization_window.js').then((m) => m.ellipse([2, 1, 0, 1, 2, 0, 0, 0, 1]))")
        assert axes == pytest.approx([3**0.5, 1, 3.14159265 / 4])
