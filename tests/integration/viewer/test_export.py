"""Exports: PNG, SVG, and a run that replays from one file without a server."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from playwright.sync_api import Browser

from tests.integration.viewer.browsing import OpenPage, nserver, open_page


def save_from_menu(page: OpenPage, button: str, file: Path) -> Path:
    """Save the download of a button in the menu Save."""
    page.page.click("[popovertarget=save]")
    with page.page.expect_download() as saved:
        page.page.click(button)
    saved.value.save_as(file)
    return file


def test_map_as_png_and_svg(browser: Browser, tmp_path: Path) -> None:
    with nserver("thesis_room", "--robot", "n200") as program, open_page(browser, program.url) as page:
        with program.robot() as robot:
            robot.draw_line(points_in=((70, 60), (90, 60)), mode=18)
        page.wait("nserver.scene.graphics.length === 1")
        png = save_from_menu(page, "#save-png", tmp_path / "map.png").read_bytes()
        assert png.startswith(b"\x89PNG\r\n")
        drawing = ElementTree.parse(save_from_menu(page, "#save-svg", tmp_path / "map.svg")).getroot()
        x, y = page.value("nserver.map.screenOf(0, 0)")
    paths = [part.attrib for part in drawing.iter("{http://www.w3.org/2000/svg}path")]
    assert any(part.get("stroke") == "#ff0000" for part in paths)
    assert any(part["d"].startswith("M") and "A" in part["d"] for part in paths)
    ends = [tuple(map(float, part["d"][1:].split("L")[0].split())) for part in paths if part["d"].count("L") == 1]
    assert any(end == pytest.approx((x, y), abs=0.02) for end in ends)


def test_svg_arcs_equal_canvas_arcs(browser: Browser) -> None:
    script = """import('/page/svg.js').then((m) => { const pen = new m.SvgPen(100, 100);
        pen.beginPath(); pen.arc(50, 50, 10, %s, %s, %s); return pen.path; })"""
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        assert page.value(script % (0, "Math.PI / 2", "false")) == "M60 50A10 10 0 0 1 50 60"
        assert page.value(script % (0, "-Math.PI / 2", "true")) == "M60 50A10 10 0 0 0 50 40"
        assert page.value(script % (0, "2 * Math.PI", "false")) == "M60 50A10 10 0 0 1 40 50A10 10 0 0 1 60 50"
        whole = """import('/page/svg.js').then((m) => { const p = new m.SvgPen(9, 9); p.fillText('<&', 1, 2);
            return String(p); })"""
        assert "&lt;&amp;" in page.value(whole)
        with pytest.raises(Exception, match="images"):
            page.value("import('/page/svg.js').then((m) => new m.SvgPen(1, 1).drawImage())")


def test_saved_run_replays_without_server(browser: Browser, tmp_path: Path) -> None:
    with nserver("thesis_room", "--start", "20,30,0,0") as program, open_page(browser, program.url) as page:
        with program.robot() as robot:
            robot.move(translation_in=20)
            robot.wait_until_still(timeout_s=20)
        page.wait("nserver.scene.robots['1'].state[34] === 400")
        file = save_from_menu(page, "#save-run", tmp_path / "run.html")
    text = file.read_text()
    assert program.url.rpartition("=")[2] not in text
    with open_page(browser, file.as_uri()) as page:
        page.page.context.set_offline(True)
        page.wait("nserver.scene.robots['1'].state[34] === 200")
        assert "saved run" in page.page.inner_text("#link-state")
        assert not page.page.is_visible("#stop")
        page.value("nserver.link.seek(nserver.link.last)")
        page.wait("nserver.scene.robots['1'].state[34] === 400")
        trace = page.value("nserver.scene.traces['1'].actual.points")
        assert trace[:2] == [20, 30]
        page.page.select_option("#replay-rate", "2")
        page.page.click("#replay-play")
        page.wait("nserver.scene.robots['1'].state[34] < 400")
        page.wait("document.querySelector('#replay-play').innerText === 'Play'")
        assert page.value("nserver.scene.robots['1'].state[34]") == 400
        assert page.value("nserver.scene.traces['1'].actual.points") == trace
        page.wait("document.querySelector('#window-robot').innerText.includes('40.0 in')")


def test_old_pictures_are_merged_into_first(browser: Browser) -> None:
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        found = page.value(
            """import('/page/export.js').then((m) => { const trace = (gone, ...points) => ({ gone, points });
            return m.mergePictures(
            { since: 0, frame: 1, world: 'w', beams: { 1: [[3, 1, 1, 0], [4, 1, 1, 0]] },
              traces: { 1: { actual: trace(1, 1, 2), encoder: trace(0) } } },
            { since: 1, frame: 2, beams: { 1: [[4], [5, 2, 2, 0]] },
              traces: { 1: { actual: trace(2, 3, 4), encoder: trace(1, 5, 6) },
              2: { actual: trace(1, 7, 8), encoder: trace(0) } } }); })"""
        )
        assert found["traces"]["1"] == {
            "actual": {"gone": 2, "points": [1, 2, 3, 4]}, "encoder": {"gone": 1, "points": [5, 6]},
        }  # fmt: skip
        assert (found["since"], found["frame"], found["world"]) == (0, 2, "w")
        assert found["traces"]["2"]["actual"]["points"] == [7, 8]
        assert found["beams"] == {"1": [[3, 1, 1, 0], [5, 2, 2, 0]]}
