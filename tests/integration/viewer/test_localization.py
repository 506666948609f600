"""`nomad localize --publish` in a browser: the estimate is shown, and waypoints set there are driven to."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from urllib.request import Request, urlopen

import pytest
from playwright.sync_api import Browser

from tests.docs.pages import ROOT
from tests.integration.viewer.browsing import nserver, open_page
from tests.programs.forked import Forked


def test_estimate_is_shown_and_waypoints_are_reached(browser: Browser) -> None:
    words = ("thesis_room", "--noisy", "--seed", "1", "--speed", "4")
    with nserver(*words) as program, open_page(browser, program.url) as page:
        options = ("--map", "thesis_room", "--waypoints", "60,0", "--publish", program.url)
        with Forked("nomad", "localize", f"nserver://127.0.0.1:{program.port}/1", *options) as localizer:
            page.wait("document.querySelector('#window-localization').innerText.includes('0 of 1 reached')")
            page.wait("nserver.map.shown.estimate")
            # The clock is paused, so that the new waypoint is set before the old one is reached.
            page.page.click("#pause")
            page.wait("nserver.scene.paused")
            page.page.click("#tool-waypoint")
            page.page.mouse.click(*page.at(30, 30))
            page.wait("nserver.waypoints['1'].length > 0")
            page.page.click("#pause")
            page.wait("nserver.estimateOf('1')?.waypoints.at(-1)[1] > 29")
            page.wait("/([12]) of \\1 reached/.test(document.querySelector('#window-localization').innerText)", 60.0)
            out, _ = localizer.communicate(timeout=60)
        assert localizer.returncode == 0
        assert re.search(r"([12]) of \1 waypoints reached", out)
        x, y = page.value("nserver.scene.robots['1'].actual.slice(0, 2)")
        assert (x, y) == pytest.approx((30, 30), abs=2)
        text = page.value("document.querySelector('#window-localization').innerText")
        assert " used, " in text
        axes = page.value("import('/page/localization_window.js').then((m) => m.ellipse([2, 1, 0, 1, 2, 0, 0, 0, 1]))")
        # Eigenvalues of [[2, 1], [1, 2]] are 3 and 1, the major axis is at 45 deg.
        assert axes == pytest.approx([3**0.5, 1, 3.14159265 / 4])


def test_localizer_runs_from_the_start(browser: Browser) -> None:
    words = ("several_walls", "--noisy", "--localize")
    with nserver(*words) as program, open_page(browser, program.url) as page:
        page.wait("document.querySelector('#trust').innerText === '✓ OK'", 60.0)


def test_localizer_is_started_and_stopped_on_the_page(browser: Browser) -> None:
    with nserver("thesis_room", "--noisy", "--seed", "1") as program, open_page(browser, program.url) as page:
        page.wait("document.querySelector('#trust').innerText === '– OFF'")
        assert not page.page.is_enabled("#unlocalize")
        page.page.select_option("#method", "ekf")
        page.page.click("#localize")
        page.wait("document.querySelector('#trust').innerText === '… STARTING'")
        page.wait("document.querySelector('#trust').innerText === '✓ OK'", 60.0)
        with program.robot() as robot:
            # The localizer only watches: another program drives the robot.
            robot.move(translation_in=10)
            page.wait("nserver.estimateOf('1')?.pose[0] > 9", 30.0)
        # Its map is the world of the start.
        assert page.value("document.querySelector('#map-note').innerText") == ""
        page.value("nserver.link.request({ do: 'control', command: 'wall', argument: { put: [[60, 90], [70, 90]] } })")
        page.wait("document.querySelector('#map-note').innerText.includes('The world has changed')")
        page.page.click("#unlocalize")
        page.wait("document.querySelector('#map-note').innerText === ''")
        page.wait("document.querySelector('.trust').innerText.includes('– OLD the localizer has ended (stopped)')")
        page.page.click("#kidnap")
        # The encoders do not notice.
        page.wait("""(() => { const { actual, encoder } = nserver.scene.robots['1'];
            const far = Math.hypot(actual[0] - encoder[0], actual[1] - encoder[1]) > 30;
            return far && Math.abs(encoder[0] - 10) < 2; })()""")


def publish(url: str, robot: int, **changes: Any) -> dict[str, Any]:
    """Publish a message as a localizer does and return the response."""
    message = {
        "robot": robot, "clock_s": 1.0, "pose": [20, 30, 0.0], "turret": 0.0, "odometry": [21, 31, 0], "passed": 0,
        "cov": [[1, 0, 0], [0, 1, 0], [0, 0, 0.01]], "truth": [23, 34, 6.2], "waypoints": [],
        "trust": "OK", "reason": "", "places": [],
        "echoes": [{"sonar": robot, "reading_in": 40, "refusal": "none", "innovation_in": 1.0, "nis": 1.0}],
    } | changes  # fmt: skip
    request = Request(url.replace("/?", "/publish?"), json.dumps(message).encode(), method="POST")
    with urlopen(request, timeout=10) as answer:
        response: dict[str, Any] = json.load(answer)
        return response


TEXT = "document.querySelector('#window-localization').innerText"


def test_estimates_per_robot_become_old(browser: Browser) -> None:
    with nserver("thesis_room", "--robots", "2") as program, open_page(browser, program.url) as page:
        page.wait(f"{TEXT}.includes(`--publish '{program.url}'`) && {TEXT}.includes('--map thesis_room')")
        # Robot 1 twice and robot 2 in between: each has its own estimate, echoes and age.
        publish(program.url, 1)
        publish(program.url, 2, clock_s=0.5, pose=[70, 80, 1])
        publish(program.url, 1, clock_s=2.0)
        # Estimate (20, 30), truth (23, 34): 3-4-5. Heading 6.2 against 0: 0.083 rad are 4.77 deg.
        page.wait(f"{TEXT}.includes('5.00 in, 4.77°') && {TEXT}.includes('2 used')")
        page.page.select_option("#robot-choice", "2")
        page.wait(f"{TEXT}.includes('70.00 in, 80.00 in') && {TEXT}.includes('1 used')")
        page.wait(f"{TEXT}.includes('the data shown is old')")
        assert page.value("nserver.estimateOf('2')") is None
        with open_page(browser, program.url) as late:
            late.wait(f"{TEXT}.includes('the data shown is old')")


def test_waypoints_by_keyboard_and_by_pointer(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        for x, y in ((10, 20), (60, 40)):
            page.page.fill("#waypoint-x", str(x))
            page.page.fill("#waypoint-y", str(y))
            page.page.press("#waypoint-y", "Enter")
        page.wait("JSON.stringify(nserver.waypoints['1']) === '[[10,20],[60,40]]'")
        assert publish(program.url, 1)["waypoints"] == [[10, 20], [60, 40]]
        with open_page(browser, program.url) as late:
            late.wait("JSON.stringify(nserver.waypoints['1']) === '[[10,20],[60,40]]'")

        def follow() -> None:
            """Publish as a localizer does, which has taken over the waypoints that the page set."""
            points = page.value("nserver.waypoints['1']")
            publish(program.url, 1, waypoints=points)
            page.wait(f"String(nserver.estimateOf('1').waypoints) === String({json.dumps(points)})")

        publish(program.url, 1, waypoints=[[10, 20], [60, 40]], passed=1)
        page.wait("!nserver.justSet('1')")
        page.page.click("#tool-waypoint")
        # Waypoints already reached are not driven to again.
        page.page.mouse.click(*page.at(80, 80))
        page.wait("nserver.waypoints['1'].length === 2 && nserver.waypoints['1'][0][0] === 60")
        follow()
        page.page.mouse.move(*page.at(60, 40))
        page.page.mouse.down()
        page.page.mouse.move(*page.at(60, 70), steps=3)
        page.page.mouse.up()
        page.wait("Math.abs(nserver.waypoints['1'][0][1] - 70) < 1")
        follow()
        page.page.mouse.click(*page.at(60, 70))
        page.wait("nserver.waypoints['1'].length === 1 && nserver.waypoints['1'][0][0] > 70")
        follow()
        page.page.focus("[aria-label='Delete waypoint 1']")
        page.page.keyboard.press("Enter")
        page.wait("nserver.waypoints['1'].length === 0")


def test_health_on_the_map_does_not_move_the_map(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        boxes = [page.page.locator("#map").bounding_box()]
        for trust in ("OK", "DEGRADED", "LOST"):
            publish(program.url, 1, trust=trust)
            page.wait(f"document.querySelector('#map-trust').innerText.includes('{trust}')")
            boxes.append(page.page.locator("#map").bounding_box())
        assert boxes == boxes[:1] * 4


LOST = {"trust": "LOST", "pose": [0, 0, 0], "cov": [[1e6, 0, 0], [0, 1e6, 0], [0, 0, 9]]}
PLACES = [{"pose": [30, 60, 0], "share": 0.62}, {"pose": [80, 40, 1.57], "share": 0.38}]
DRAWN = """import('/page/export.js').then((m) => { const text = m.svgOf(nserver), colour = nserver.theme.estimate;
    return [text.split('<path ').filter((path) => path.includes(`"${colour}"`)).length,
            [...text.matchAll(/>([^<]* %)<.text>/g)].map((found) => found[1])]; })"""


def test_trust_is_shown_and_alternatives_are_drawn(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        publish(program.url, 1)
        page.wait(f"{TEXT}.includes('✓ OK') && {TEXT}.includes('no other pose')")
        stroke_count, _ = page.value(DRAWN)
        assert stroke_count > 0
        publish(program.url, 1, clock_s=2.0, trust="DEGRADED", reason="position uncertainty is 3.4 in")
        page.wait(f"{TEXT}.includes('! DEGRADED position uncertainty is 3.4 in')")
        assert page.value(DRAWN) == [stroke_count, []]
        publish(program.url, 1, clock_s=3.0, reason="searching: a guess", **LOST)
        page.wait(f"{TEXT}.includes('✕ LOST searching: a guess') && {TEXT}.includes('none found yet')")
        assert "3000" not in page.value(TEXT)
        assert page.value(DRAWN) == [0, []]
        publish(program.url, 1, clock_s=4.0, reason="2 places look alike", places=PLACES, **LOST)
        page.wait(f"{TEXT}.includes('62 %: 30.00 in, 60.00 in, 0.0°; 38 %: 80.00 in, 40.00 in, 90.0°')")
        assert page.value(DRAWN) == [6, ["62 %", "38 %"]], "each pose is a circle and an arrow of two strokes"
        publish(program.url, 1, clock_s=5.0)
        page.wait(f"{TEXT}.includes('✓ OK')")
        assert page.value(DRAWN) == [stroke_count, []]


def test_global_localization_and_go_are_shown(browser: Browser) -> None:
    with nserver("several_walls", "--noisy", "--seed", "3", "--speed", "4", "--start", "5,5,0,0") as program:
        address = f"nserver://127.0.0.1:{program.port}/1"
        with open_page(browser, program.url) as page:
            map_options = ("--map", "several_walls", "--publish", program.url)
            with Forked(
                "nomad", "localize", address, *map_options, "--start", "unknown", "--waypoints", "30,10"
            ) as localizer:
                page.wait(f"{TEXT}.includes('✕ LOST')", 60.0)
                page.wait(f"{TEXT}.includes('✓ OK')", 60.0)
                localizer.terminate()
            with Forked("nomad", "go", address, *map_options, "--to", "30,20") as driver:
                page.wait("nserver.estimateOf('1')?.waypoints[0]?.join() === '30,20'", 60.0)
                page.wait("nserver.estimateOf('1')?.pose[0] + nserver.estimateOf('1').pose[1] > 47", 60.0)
                assert driver.wait(timeout=60) == 0


BROKEN = """
from examples.own_filter import MyFilter

class Broken(MyFilter):
    def update(self, echo):
        raise ValueError(f"no model of sonar {echo.sonar}")
"""


@pytest.mark.long
def test_own_filter_runs_and_its_error_is_shown(browser: Browser, tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(f"import sys\nsys.path.insert(0, {str(ROOT)!r})\n{BROKEN}")
    own = [f"{ROOT}/examples/own_filter.py:MyFilter", f"{tmp_path}/broken.py:Broken"]
    words = [word for name in own for word in ("--method", name)]
    with nserver("thesis_room", "--noisy", "--seed", "1", *words) as program, open_page(browser, program.url) as page:
        page.page.select_option("#method", own[0])
        page.page.click("#localize")
        page.wait("document.querySelector('#trust').innerText === '✓ OK'", 60.0)
        page.page.select_option("#method", own[1])
        page.page.click("#localize")
        page.wait("/ValueError: no model of sonar \\d/.test(document.querySelector('.trust').innerText)", 60.0)
