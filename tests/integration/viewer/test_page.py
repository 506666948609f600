"""The whole page: stop keys, shared links, noise, worlds, undo, connection loss; functions of its modules."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import nserver, open_page
from worlds.io import format_world, load_world

NOTICE = "document.querySelector('#notice')"
OBSTACLES = "nserver.scene.world.obstacles"


def test_noise_setting_changes_client_readings(browser: Browser) -> None:
    with nserver("thesis_room", "--robots", "2") as program, open_page(browser, program.url) as page:
        with program.robot() as robot:
            exact = robot.refresh().sonars_in[0]
            page.page.select_option("#noise-sensors", "measured")
            page.wait("nserver.scene.bodies['1'].noise.sensors === 'measured'")
            assert page.value("nserver.scene.bodies['2'].noise.sensors") == "ideal"
            page.wait("new Set(nserver.scene.history['1'].map((one) => one.sonars.join())).size > 3")
            # Measured sonars differ from the exact reading by noise, but not by more than 30 in here.
            assert abs(robot.refresh().sonars_in[0] - exact) <= 30
            page.page.check("#noise-all")
            page.page.select_option("#noise-motion", "noisy")
            page.wait("['1', '2'].every((id) => nserver.scene.bodies[id].noise.motion === 'noisy')")
            page.page.select_option("#noise-sensors", "ideal")
            # Exact sonars again: State has the rounded reading.
            page.wait(f"nserver.scene.robots['1'].state[17] === {round(exact)}")
        with open_page(browser, program.url) as other:
            other.wait("document.querySelector('#noise-motion').value === 'noisy'")


def test_faults_are_applied_counted_and_cleared(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.click("text=Fault injection")
        page.wait("document.querySelector('#faults').value.includes('seed')")
        page.page.fill("#faults", '[[rule]]\nname = "no"\ndo = "nak"\ncommand = "vm"\ndirection = "request"\n')
        page.page.click("#faults-set")
        page.wait("document.querySelector('#faults-counts').innerText.includes('nak 0')")
        with program.robot() as robot:
            with pytest.raises(Exception, match=r"(?i)refus|nak|error"):
                robot.drive(translation_in_s=5)
            page.page.click("#faults-count")
            page.wait("document.querySelector('#faults-counts').innerText.includes('nak 1')")
            page.page.click("#faults-clear")
            page.wait("document.querySelector('#faults-counts').innerText.includes('no faults')")
            robot.drive(translation_in_s=5)


def test_read_only_link_is_shown_and_copied(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        page.page.click("[popovertarget=share]")
        link = page.page.input_value("#share-link")
        page.page.click("#share-copy")
        page.wait("document.querySelector('#share-copy').innerText === 'Copied'")
        assert page.value("navigator.clipboard.readText()") == link
        assert link != program.url
        with open_page(browser, link) as other:
            other.wait("document.body.classList.contains('read-only')")
            assert not other.page.is_visible("[popovertarget=share]")
            assert other.value("nserver.watchToken") is None


def test_escape_and_space_stop(browser: Browser) -> None:
    moving, still = "nserver.scene.robots['1'].state[41] !== 0", "nserver.scene.robots['1'].state[41] === 0"
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        # A key on the page, in a text field, and in a list: each must stop.
        cases: list[tuple[Callable[[], object], str]] = [
            (lambda: page.page.click("#fit"), "Space"), (lambda: page.page.focus("#corners"), "Escape"),
            (lambda: page.page.select_option("#noise-motion", "ideal"), "Escape"),
        ]  # fmt: skip
        for prepare, key in cases:
            robot.drive(steering_rad_s=0.5)
            page.wait(moving)
            prepare()
            page.page.keyboard.press(key)
            page.wait(still)
            page.page.click("#release")
            page.wait("document.querySelector('#estop-banner').hidden")
        page.page.focus("#corners")
        page.page.keyboard.press("Space")
        # A space in a text field is text, no stop.
        assert page.page.input_value("#corners") == " "
        page.page.focus("#pad")
        page.page.keyboard.down("a")
        page.wait(moving)
        page.page.keyboard.press("Escape")
        page.wait(still)
        # A repeated key must not start the motion again after the stop.
        page.page.keyboard.down("a")  # as a pressed key repeats
        page.page.wait_for_timeout(300)
        assert page.value(still)
        page.page.keyboard.up("a")
        page.page.click("#release")
        page.wait("document.querySelector('#estop-banner').hidden")
        page.page.focus("#pad")
        page.page.keyboard.press("a", delay=200)
        page.wait(still)
        failing = """import('/page/estop.js').then((m) =>
            m.stop({ request: async () => ({ ok: false, error: 'not connected' }) }))"""
        # Without a connection the page must not claim that the robot was stopped.
        assert page.value(failing) == "NOT STOPPED — not connected"


BUTTONS = [f"JSON.stringify((({{x, width}}) => [x, width])(document.querySelector('#{name}').getBoundingClientRect()))"
           for name in ("undo", "redo", "save-world", "clear-world")]  # fmt: skip


def test_loading_world_can_be_undone_and_redone(browser: Browser, tmp_path: Path) -> None:
    file = tmp_path / "other.toml"
    # The obstacle's corners are in centimetres, with forms of numbers that only TOML has (1_00.0, +150).
    file.write_text(format_world(load_world("several_walls")) + '\n[[obstacle]]\nname = "far"\n'
                    "corners_cm = [[1_00.0, +150], [110, 150.], [110, 160]]\n".replace("150.]", "150.0]"))
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        assert page.page.is_disabled("#undo")
        before = [page.value(where) for where in BUTTONS]
        page.page.set_input_files("#load-world", file)
        page.wait("nserver.scene.world.name === 'several_walls'")
        assert page.value("Object.keys(nserver.scene.world.paths).length") > 0
        with page.page.expect_download() as saved:
            page.page.click("#save-world")
        saved.value.save_as(tmp_path / "saved.toml")
        assert load_world(tmp_path / "saved.toml").paths.keys() == load_world("several_walls").paths.keys()
        page.wait("document.querySelector('#undo').innerText === 'Undo: load other.toml'")
        assert [page.value(where) for where in BUTTONS] == before, "the buttons do not move"
        page.page.keyboard.press("Control+z")
        page.wait("nserver.scene.world.name === 'thesis_room'")
        page.page.keyboard.press("Control+Shift+z")
        page.wait("nserver.scene.world.name === 'several_walls'")
        before = page.value(f"JSON.stringify({OBSTACLES})")
        page.page.click("#clear-world")
        page.wait(f"{OBSTACLES}.length === 0")
        page.page.click("#undo")
        page.wait(f"JSON.stringify({OBSTACLES}) === {json.dumps(before)}")
        for wrong, words in (("hello", "broken.toml: is no TOML"), ("x = 1", "broken.toml: x: unknown key")):
            broken = tmp_path / "broken.toml"
            broken.write_text(wrong)
            page.page.set_input_files("#load-world", broken)
            page.wait(f"{NOTICE}.innerText.includes({json.dumps(words)})")
        page.page.click("#notice-close")
        assert not page.page.is_visible("#notice")


def test_obstacles_move_by_keys_and_errors_are_shown(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        page.page.fill("#corners", "60,60 70,60 70,70")
        page.page.press("#corners", "Enter")
        page.wait(f"{OBSTACLES}.length === 1")
        page.page.fill("#move-step", "2.5")
        page.page.focus("[aria-label='move right obstacle 1']")
        for count in (1, 2, 3):
            # After each press the focus must stay on the same button, although the list is drawn anew.
            page.page.keyboard.press("Enter")
            page.wait(f"{OBSTACLES}[0].corners[0][0] === {60 + 2.5 * count}")
            page.wait("document.activeElement.ariaLabel === 'move right obstacle 1'")
        for corners, words in (
            ("1,1", "3 to 10 corners, not 1"), ("0,0 1,1", "it would touch robot 1"),
            (" ".join(f"{k},{k * k}" for k in range(12)), "3 to 10 corners, not 12"),
            ("60,20 70,30 70,20 60,30", "may not cross"), ("60,20 61,20 62,20", "on one line"),
            ("-5,-5 5,-5 5,5", "it overlaps a robot"),
        ):  # fmt: skip
            page.page.fill("#corners", corners)
            page.page.press("#corners", "Enter")
            page.wait(f"{NOTICE}.innerText.includes({json.dumps(words)})")
        # In centimetres: 127 cm are 50 in.
        page.page.click("#units")
        page.page.fill("#corners", "127,127 152.4,127 152.4,152.4")
        page.page.press("#corners", "Enter")
        page.wait(f"{OBSTACLES}.some((thing) => thing.corners[0][0] === 50)")
        assert page.page.input_value("#move-step") == "6.35"
        page.wait("document.querySelector('#world-list').innerText.includes('127,127')")


def test_click_selects_robot_and_preferences_persist(browser: Browser) -> None:
    words = ("thesis_room", "--start", "20,30,0,0", "--start", "60,60,0,0")
    with nserver(*words) as program, open_page(browser, program.url) as page:
        page.page.mouse.click(*page.at(60, 60))
        page.wait("nserver.robot === '2'")
        for tool in ("turn", "place"):
            page.page.click(f"#tool-{tool}")
            page.page.mouse.click(*page.at(22, 33))
        page.page.wait_for_timeout(300)
        # Turning and placing need a drag; a click changes nothing.
        assert page.value("nserver.scene.robots['1'].actual") == [20, 30, 0, 0]
        page.page.click("#tool-pan")
        page.page.click("#follow")
        page.page.focus("#map")
        page.page.keyboard.press("ArrowLeft")
        page.wait("!nserver.map.following")
        page.page.click("#units")
        page.page.click("#window-robot > summary")
        page.wait("localStorage.getItem('nserver window robot') === 'false'")
        page.page.reload()
        page.wait("window.nserver && nserver.metric && !document.querySelector('#window-robot').open")


EXPRESSIONS: list[tuple[str, str, Any]] = [
    ("colours.js", "m.contrast('#ffffff', '#000000')", 21),
    ("colours.js", "m.contrast('#777777', '#ffffff') > 4.47 && m.contrast('#777777', '#ffffff') < 4.49", True),
    ("colours.js",
     "Object.keys(m.CLIENT_COLOURS).every((name) => [['#ffffff', '#15181d'], ['#12151a', '#e8ebf0']]"
     ".every(([paper, ink]) => m.contrast(m.clientColour(name, { paper, ink }), paper) >= 3))", True),
    ("colours.js", "m.clientColour('Red', { paper: '#ffffff', ink: '#15181d' })", "#ff0000"),
    ("estop.js", "m.bannerTexts({ 1: { held: null }, 2: {} }, 'viewer 1')", None),
    ("estop.js", "m.bannerTexts({ 1: { held: { by: 'viewer 1', ignored: 1 } } }, 'viewer 1')",
     {"state": "Stopped: no robot moves until Release. Stopped by you (viewer 1).",
      "ignored": "1 motion command ignored."}),
    ("estop.js",
     "m.bannerTexts({ 1: {}, 2: { held: { by: 'b', ignored: 2 } }, 3: { held: { by: 'c', ignored: 5 } } }, 'a')",
     {"state": "Stopped: robots 2, 3 do not move until Release. Stopped by b and c.",
      "ignored": "7 motion commands ignored."}),
    ("estop.js", "m.bannerTexts({ 1: {}, 2: { held: { by: 'b', ignored: 0 } } }, 'a')",
     {"state": "Stopped: robot 2 does not move until Release. Stopped by b.", "ignored": ""}),
    ("estop.js", "[m.robotsToRelease({ 1: { held: { by: 'a' } }, 2: { held: { by: 'b' } }, 3: {} }, 'a'), "
     "m.robotsToRelease({ 1: { held: { by: 'a' } } }, 'a'), m.robotsToRelease({ 1: { held: { by: 'b' } } }, 'a')]",
     [[1], [None], [None]]),
    ("geometry.js", "m.cornersError([[0, 0], [9, 0], [9, 9], [0, 9]])", ""),
    ("geometry.js", "m.wallsWithin({ walls: [[0, 0, 0, 9], [50, 0, 50, 9]], "
     "obstacles: [{ corners: [[3, 0], [4, 0], [3, 60]] }] }, 0, 0, 20).length", 4),
    ("geometry.js", "m.wallDistances([[4, -9, 4, 9], [8, -9, 8, 9], [-1, 3, 20, 3]], 1, 0, "
     "[0, Math.PI / 2, Math.PI, Math.atan2(4, 3)], 30).map((each) => Number(each.toFixed(6)))", [3, 3, 30, 3.75]),
    ("geometry.js", "m.isFree({ rooms: [{ corners: [[0, 0], [9, 0], [9, 9]] }], obstacles: [] }, 8, 2)", True),
    ("geometry.js", "m.isFree({ rooms: [{ corners: [[0, 0], [9, 0], [9, 9]] }], obstacles: [] }, 2, 8)", False),
    ("robot_windows.js",
     "[[255, 255], [20, 255], [100], [200, 3]].map((each) => m.polarRange(each, {max_in: 255, no_echo_in: 255}))",
     [30, 30, 120, 255]),
    ("robot_windows.js", "[[201, 20], [150, 0]].map((each) => m.polarRange(each, {max_in: 196, no_echo_in: 201}))",
     [30, 196]),
    ("scene.js", "[0, 49].map((each) => m.isEcho(each, {max_in: 50, no_echo_in: 0}))", [False, True]),
    ("scene.js", "[0, 49, 50].map((each) => m.shownRange(each, {max_in: 50, no_echo_in: 0}))", [50, 49, 50]),
    ("scene.js", "m.sonarReadings({sonars: [1.5, 2]}, undefined)", [1.5, 2]),
    ("scene.js", "m.updateShapes([[1, 'a'], [2, 'b']], { gone: [1], come: [[3, 'c']] })", [[2, "b"], [3, "c"]]),
    ("world_window.js", "[m.parseCorners('1,2 3,-4.5'), m.parseCorners('1,2 3'), m.parseCorners('1,2 3,x')]",
     [[[1, 2], [3, -4.5]], None, None]),
    ("traffic_window.js",
     "['get_bp', '-get_bp', 'state'].map((filter) => m.passes({ what: 'bumper', of: 'get_bp', who: 'x' }, filter))",
     [True, False, False]),
    ("time_window.js", "[m.countsText({}), m.countsText({ tcp: { no: { seen: 2, nak: 1 } } })]",
     ["no faults are active", "tcp, no: seen 2, nak 1"]),
    ("localization_window.js",
     "[[0, 9], [0, 31], [5, 200]].map((ends) => m.chartSpan(ends.map((time_s) => ({ time_s }))))", [15, 60, 120]),
    ("charts.js", "m.runsOf([[0, 1], [0.1, 2], [0.2, null], [0.3, 4], [3, 5]])",
     [[[0, 1], [0.1, 2]], [[0.3, 4]], [[3, 5]]]),
    ("charts.js", "m.runsOf([[0, null, 1], [1, 0, 1]])", [[[1, 0, 1]]]),
    ("localization_window.js",
     "[[null, 0], [{ received_ms: 9, latest: { trust: 'LOST', reason: 'r' } }, 1], [{ received_ms: 9 }, 7]]"
     ".flatMap(([own, age]) => [undefined, { state: 'starting', words: 'w', at_ms: 9 }, "
     "{ state: 'failed', words: 'w', at_ms: 9 }, { state: 'ended', words: 'w', at_ms: 9 }]"
     ".map((run) => m.healthOf(own, age, run)[0])).join()",
     "OFF,STARTING,FAILED,OFF,LOST,STARTING,FAILED,OLD,OLD,STARTING,FAILED,OLD"),
    ("localizer_controls.js",
     "(() => { let k = 0; const numbers = [0.1, 0.1, 0.5, 0.99, 0.6, 0.8, 0.25], world = { rooms: [], obstacles: [], "
     "walls: [[0, 0, 100, 0], [100, 0, 100, 100], [100, 100, 0, 100], [0, 100, 0, 0]] };"
     "return m.randomPose({ world, robots: { 1: { actual: [10, 10, 0, 0] } }, bodies: { 1: { radius_in: 9 } } }, '1', "
     "() => numbers[k++]).map(Math.round); })()", [60, 80, 2, 2]),
    ("menus.js", "m.linkWith({ origin: 'http://h:1', pathname: '/' }, 'a b')", "http://h:1/?token=a%20b"),
    ("localization_window.js",
     "m.errorsOf({ pose: [3, 4, 0.1], truth: [0, 0, 2 * Math.PI], cov: [1, 0, 0, 0, 4, 0, 0, 0, 0] }).turn.toFixed(3)",
     "5.730"),
    ("localization_window.js", "[0, 0.001, 0.126, 1].map(m.percent).join()", "0 %,under 1 %,13 %,100 %"),
]  # fmt: skip


def test_page_functions(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        for module, script, right in EXPRESSIONS:
            assert page.value(f"import('/page/{module}').then((m) => {script})") == right, script


def test_run_continues_after_reconnect_and_is_limited(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        found = page.value(
            """import('/page/export.js').then((m) => { const run = m.newRun();
            const picture = (frame, since) =>
              ({ type: 'picture', frame, since, time_s: frame, traces: {}, graphics: [] });
            m.recordMessage(run, picture(1, 0)); m.recordMessage(run, picture(2, 1), 10);
            m.recordMessage(run, { type: 'traffic' }); m.recordMessage(run, picture(9, 0), 10);
            const saved = run.messages.map((one) => one.frame), length = m.runLength(run);
            m.recordMessage(run, picture(10, 9), 10, { messages: 9, size: 25 });
            return [saved, length, run.base.frame, run.messages.length, run.size]; })"""
        )
        assert found == [[2, 9], "8 s", 2, 2, 20]


def test_svg_xor_equals_canvas(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page, program.robot() as robot:
        robot.draw_line(points_in=((60, 50), (80, 50)), mode=1)
        robot.draw_line(points_in=((70, 40), (70, 60)), mode=2)
        page.wait("nserver.scene.graphics.length === 2")
        page.value("(Object.assign(nserver.map.view, { x: 70, y: 50, scale: 4 }), nserver.map.requestRedraw(), true)")
        text = page.value("import('/page/export.js').then((m) => m.svgOf(nserver))")
        page.page.evaluate("['sonar', 'grid'].forEach((name) => document.getElementById(`layer-${name}`).click())")
        page.wait("(nserver.map.draw(), true)")
        # Three points: the crossing of both lines, and one on each line alone.
        read = """[[70, 50], [65, 50], [70, 45]].map(([x, y]) => { const [px, py] = nserver.map.screenOf(x, y);
              const [red, green, blue] = pen.getImageData(Math.floor(px), Math.floor(py), 1, 1).data;
              return red + green + blue; })"""
        shown = page.value(f"(() => {{ const pen = nserver.map.canvas.getContext('2d'); return {read}; }})()")
        # XOR: where the lines cross, the pixel has the colour of the paper again.
        assert shown[0] > max(shown[1:]) + 200
        drawn = page.value(
            """(async (text) => { const image = new Image();
            image.src = URL.createObjectURL(new Blob([text], { type: 'image/svg+xml' }));
            await image.decode(); const canvas = document.createElement('canvas');
            canvas.width = nserver.map.view.width; canvas.height = nserver.map.view.height;
            const pen = canvas.getContext('2d'); pen.drawImage(image, 0, 0);
            return READ; })(SVG)""".replace("READ", read).replace("SVG", json.dumps(text))
        )
        assert drawn[0] > max(drawn[1:]) + 200


def test_restarted_server_rejects_old_token(browser: Browser) -> None:
    with nserver("thesis_room") as program, browser.new_context() as context:
        page = context.new_page()
        page.goto(program.url)
        page.wait_for_selector("#link-state:text('live')")
        found = page.evaluate(
            """import('/page/link.js').then((m) => new Promise((done) => {
                const states = [], onMessage = () => {};
                const onState = (name) => { states.push(name); if (states.length === 2) done(states); };
                m.openLink('wrong', { onMessage, onState });
                }))"""
        )
        assert found == ["lost", "rejected"]


def test_lost_connection_is_shown(browser: Browser) -> None:
    with browser.new_context() as context:
        page = context.new_page()
        with nserver("thesis_room") as program:
            page.goto(program.url)
            page.wait_for_selector("#link-state:text('live')")
        page.wait_for_selector("#link-state:text('last message')")
        assert page.evaluate("document.body.classList.contains('lost')")
        page.click("#stop")
        page.wait_for_selector("#notice span:text('NOT STOPPED — not connected')")
