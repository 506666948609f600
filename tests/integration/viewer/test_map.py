"""The map in a browser: the robot is drawn where State says it is, and who has no token sees nothing."""

from __future__ import annotations

import math

import pytest
from playwright.sync_api import Browser

from nclient import Pose
from tests.integration.viewer.browsing import nserver, open_page

NEAR = 40
"""How far apart two colours of the screen may be, of 255, and still be one."""


def near(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return all(abs(a - b) <= NEAR for a, b in zip(one, other, strict=True))


def test_robot_on_canvas_follows_state(browser: Browser) -> None:
    with nserver("thesis_room", "--start", "20,30,0,0") as program, open_page(browser, program.url) as page:
        for layer in ("sonar", "grid", "encoder"):
            page.page.evaluate(f"document.getElementById('layer-{layer}').click()")
        # Redraw without these layers at once.
        page.wait("(nserver.map.draw(), true)")
        body = page.pixel(20 - 4, 30 - 7)
        floor = page.pixel(90, 90)
        assert not near(body, (floor[0], floor[1], floor[2] - 60))
        with program.robot() as robot:
            robot.move(translation_in=40)
            state = robot.wait_until_still(timeout_s=20)
            assert state.x_in == pytest.approx(60, abs=0.2)
            page.wait(f"nserver.scene.robots['1'].state[34] === {round(10 * state.x_in)}")
            page.wait("(nserver.map.draw(), true)")
        assert page.pixel(state.x_in - 4, state.y_in - 7) == body
        assert page.pixel(20 - 4, 30 - 7) == floor
        shown = page.value("nserver.scene.robots['1'].encoder")
        assert shown[:2] == pytest.approx([state.x_in, state.y_in], abs=0.06)
        # The trace ends at the robot, to half an inch.
        page.wait("nserver.scene.traces['1'].actual.points.at(-2) > 59.3")
        assert page.value("nserver.scene.traces['1'].actual.points.slice(0, 2)") == [20, 30]
        assert page.pixel(30, 30) != floor


def test_map_is_drawn_only_when_something_changes(browser: Browser) -> None:
    start = "(window.drawn = 0, window.first = nserver.scene.frame, window.begun_ms = performance.now(), true)"
    # Ages of data are drawn once a second.
    more_often = "drawn > 2 + (performance.now() - begun_ms) / 1000"
    with nserver("thesis_room", "--start", "20,30,0,0") as program, open_page(browser, program.url) as page:
        # Each drawing fills the map once.
        page.value("""(() => { const pen = nserver.map.canvas.getContext('2d'), fill = pen.fillRect.bind(pen);
            pen.fillRect = (...box) => { window.drawn += 1; fill(...box); }; })()""")
        page.wait(start)
        # Twenty pictures in which nothing moves.
        page.wait("nserver.scene.frame >= first + 20")
        assert not page.value(more_often)
        with program.robot() as robot:
            robot.drive(translation_in_s=2)
            page.wait("nserver.scene.robots['1'].actual[0] > 20.2")
            page.wait(start)
            page.wait(more_often)


def test_beams_stay_until_robot_is_placed(browser: Browser) -> None:
    beams = """import('/page/export.js').then((m) => m.svgOf(nserver).split('<path ').filter((path) =>
        path.includes(`stroke="${nserver.theme.sonar}"`)).map((path) => path.split('"')[1]))"""
    with nserver("thesis_room", "--start", "20,30,0,0") as program, open_page(browser, program.url) as page:
        assert len(page.value(beams)) == 16
        with program.robot() as robot:
            # An empty firing order: no new beam replaces the old ones.
            robot.configure_sonars(rate=15, order=())
            now = page.value("nserver.scene.time_s")
            page.wait(f"nserver.scene.time_s > {now} + 0.3")
            before = page.value(beams)
            robot.move(translation_in=40, turret_rad=1.0)
            robot.wait_until_still(timeout_s=20)
            page.wait("Math.abs(nserver.scene.robots['1'].actual[0] - 60) < 0.1")
            assert page.value(beams) == before
            robot.place(Pose(70, 70, 0, 0))
            page.wait("nserver.scene.beams['1'].length === 0")
            assert page.value(beams) == []
            robot.configure_sonars(rate=15, order=(4,))
            page.wait("nserver.scene.beams['1'].length === 1")
            start = page.value("nserver.map.screenOf(70, 70 + nserver.scene.bodies['1'].ring_in)")
            drawn = page.value(beams)[0][1:].split("L")[0].split()
            assert [float(number) for number in drawn] == pytest.approx(start, abs=0.02)


def test_client_graphics_have_colours_and_xor(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        floor = page.pixel(75.3, 60)
        for _ in range(2):
            robot.draw_line(points_in=((70, 60), (90, 60)), mode=18)
            page.wait("nserver.scene.graphics.length === 1")
            page.wait("(nserver.map.draw(), true)")
            assert page.pixel(75.3, 60)[0] > 200
            assert page.pixel(75.3, 60)[1] < 130
            robot.draw_line(points_in=((70, 60), (90, 60)), mode=18)
            page.wait("nserver.scene.graphics.length === 0")
            page.wait("(nserver.map.draw(), true)")
            assert page.pixel(75.3, 60) == floor


def test_zoom_pan_fit_follow_and_units(browser: Browser) -> None:
    with nserver("thesis_room", "--start", "20,30,0,0") as program, open_page(browser, program.url) as page:
        scale = page.value("nserver.map.view.scale")
        x, y = page.at(20, 30)
        page.page.mouse.move(x, y)
        page.page.mouse.wheel(0, -300)
        page.wait(f"nserver.map.view.scale > {scale * 1.5}")
        assert page.at(20, 30) == pytest.approx((x, y), abs=1)
        page.page.mouse.down()
        page.page.mouse.move(x + 50, y + 30, steps=3)
        page.page.mouse.up()
        assert page.at(20, 30) == pytest.approx((x + 50, y + 30), abs=1)
        page.page.locator("#map").focus()
        page.page.keyboard.press("f")
        page.wait("nserver.map.following")
        page.wait("Math.abs(nserver.map.view.x - 20) < 0.1")
        page.page.keyboard.press("f")
        page.page.keyboard.press("ArrowRight")
        page.wait("nserver.map.view.x > 20.5")
        page.page.keyboard.press("0")
        assert page.value("nserver.map.view.scale") == pytest.approx(scale)
        page.page.keyboard.press("+")
        page.page.keyboard.press("-")
        assert page.value("nserver.map.view.scale") == pytest.approx(scale)
        page.page.keyboard.press("u")
        assert page.page.locator("#units").inner_text() == "centimetres"
        page.wait("document.querySelector('#window-robot').innerText.includes('50.8 cm')")


def test_canvas_has_resolution_of_dense_screen(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url, device_scale_factor=2) as page:
        assert page.value("nserver.map.canvas.width / nserver.map.canvas.clientWidth") == pytest.approx(2, abs=0.01)


@pytest.mark.parametrize(("viewport", "scheme"), [((800, 600), "dark"), ((390, 844), "light"), ((360, 640), "dark")])
def test_page_fits_small_screens_in_light_and_dark(browser: Browser, viewport: tuple[int, int], scheme: str) -> None:
    width, height = viewport
    with (
        nserver("thesis_room") as program,
        open_page(browser, program.url, viewport={"width": width, "height": height}, color_scheme=scheme) as page,
    ):
        assert page.value("document.documentElement.scrollWidth") <= width
        box = page.page.locator("#stop").bounding_box()
        assert box is not None
        assert box["x"] + box["width"] <= width
        assert box["y"] + box["height"] <= height
        canvas = page.page.locator("#map").bounding_box()
        assert canvas is not None
        assert min(canvas["width"], canvas["height"]) > 250
        dark = sum(page.pixel(45, 90)) < 3 * 128
        assert dark == (scheme == "dark")
        for menu in ("layers", "save"):
            assert not page.page.is_visible(f"#{menu}")
            page.page.click(f"[popovertarget={menu}]")
            page.page.wait_for_selector(f"#{menu}", state="visible")
            box = page.page.locator(f"#{menu}").bounding_box()
            assert box is not None
            assert min(box["x"], box["y"]) >= 0
            assert box["x"] + box["width"] <= width
            assert box["y"] + box["height"] <= height
            on_top = f"""(() => {{ const last = document.querySelector('#{menu}').lastElementChild;
                const box = last.getBoundingClientRect();
                return last.contains(document.elementFromPoint(box.x + box.width / 2, box.y + box.height / 2)); }})()"""
            assert page.value(on_top)
            page.page.keyboard.press("Escape")
            assert not page.page.is_visible(f"#{menu}")
            assert page.value(f"document.activeElement.getAttribute('popovertarget') === '{menu}'")
        page.value("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        page.page.wait_for_timeout(200)
        assert page.value("document.documentElement.scrollWidth") <= width


def test_every_task_fits_narrow_screens(browser: Browser) -> None:
    """Addresses in the texts are longer with some ports, so where their lines end is tested at several widths."""
    with (
        nserver("thesis_room") as program,
        open_page(browser, program.url, viewport={"width": 360, "height": 640}) as page,
    ):
        page.value("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
        tasks = page.page.locator("#tasks button").all()
        assert len(tasks) >= 4
        for task in tasks:
            task.click()
            for width in range(360, 310, -10):
                page.page.set_viewport_size({"width": width, "height": 640})
                assert page.value("document.documentElement.scrollWidth") <= width, (task.inner_text(), width)


def test_menu_is_below_button_and_inside_window(browser: Browser) -> None:
    place = """import("/page/menus.js").then((m) =>
        m.menuPosition({ left: %s, top: %s, bottom: %s }, [168, 300], [390, 844]))"""
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        assert page.value(place % (20, 100, 130)) == [20, 134]
        assert page.value(place % (300, 100, 130)) == [390 - 168 - 8, 134]
        assert page.value(place % (20, 700, 730)) == [20, 700 - 4 - 300]
        assert page.value(place % (20, 200, 830)) == [20, 8]


def test_wrong_token_is_rejected(browser: Browser) -> None:
    with nserver("thesis_room") as program, browser.new_context() as context:
        page = context.new_page()
        # The right token with its last three characters replaced.
        answer = page.goto(program.url[:-3] + "xxx")
        assert answer is not None
        assert answer.status == 403
        assert "token is wrong" in page.inner_text("body")


def test_other_site_cannot_open_websocket(browser: Browser) -> None:
    with nserver("thesis_room") as program, nserver("thesis_room") as other, open_page(browser, other.url) as page:
        # The page of one server connects to another: same machine, another origin.
        address = program.url.replace("http", "ws").replace("/?", "/ws?")
        was_opened = page.value(
            f"""new Promise((done) => {{ const socket = new WebSocket('{address}');
            socket.onopen = () => done(true); socket.onerror = () => done(false); }})"""
        )
        assert not was_opened
        assert any("Content Security Policy" in error or "403" in error for error in page.errors)
        page.errors.clear()


def test_view_and_grid_values(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        round_length = "import('/page/geometry.js').then((m) => m.roundLength(%s, %s, 1))"
        # Scale in pixels per inch, minimum distance in pixels: the next round length of 1, 2 or 5.
        for scale, pixels, length in [(4, 40, 10), (4, 41, 20), (40, 40, 1), (0.1, 40, 500), (3, 60, 20)]:
            assert page.value(round_length % (scale, pixels)) == pytest.approx(length)
        back = page.value(
            """import('/page/geometry.js').then((m) => { const v = {...m.newView(), x: 3, y: -7, scale: 2.5};
            return m.toWorld(v, ...m.toScreen(v, 11, 13)); })"""
        )
        assert back == pytest.approx([11, 13])
        degrees = page.value(f"import('/page/units.js').then((m) => m.degreesText({-math.pi / 2}))")
        assert degrees == "270.0°"
