"""A class in a browser: the teacher's page, a student's page, the list of robots, labels that do not overlap."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from nclient import RobotHeld
from tests.integration.viewer.browsing import nserver, open_page

HELD = "Object.keys(nserver.scene.robots).filter((id) => nserver.scene.robots[id].held).join()"


def row(number: int) -> str:
    return f"document.querySelector('.robots tbody tr:nth-child({number})').innerText"


def test_teacher_and_student(browser: Browser, tmp_path: Path) -> None:
    path = tmp_path / "students.csv"
    path.write_text("name\nAda\nBob\nGrace\n")
    with nserver("--class", str(path)) as program, program.robot(2) as robot:
        written = (tmp_path / "students.links.csv").read_text()
        links = {row["name"]: row["page"] for row in csv.DictReader(written.splitlines())}
        with open_page(browser, program.url) as teacher, open_page(browser, links["Bob"]) as student:
            assert teacher.value("nserver.scene.world.name") == "arena"
            # 1. The list has names, programs and health; a click selects the robot.
            for text in ("2 Bob", "stands", "127.0.0.1:"):
                teacher.wait(f"{row(2)}.includes('{text}')")
            assert "none" in teacher.value(row(1))
            teacher.page.click(".robots tbody tr:nth-child(3) .name")
            assert teacher.value("nserver.robot") == "3"
            # 2. The student's page has its robot selected, stops and releases it, and acts on no other.
            student.wait("nserver.robot === '2' && nserver.scene.bodies['2']")
            assert student.page.input_value("#robot-choice") == "2"
            for hidden in ("#stop-all", "#task-world", "#robots-reset", "#localizer-noise"):
                assert not student.page.is_visible(hidden)
            assert teacher.page.is_visible("#robots-reset")
            student.page.select_option("#robot-choice", "1")
            student.page.focus("#map")
            student.page.keyboard.press("Escape")
            student.wait(f"{HELD} === '2'")
            with pytest.raises(RobotHeld, match="Bob"):
                robot.drive(translation_in_s=5)
            teacher.wait(f"{row(2)}.includes('stopped by Bob') && {row(2)}.includes('1 commands refused')")
            student.page.click("#release")
            student.wait(f"{HELD} === ''")
            student.value("nserver.link.request({do: 'drive', robot: 1, args: [50, 0, 0]})"
                          ".then((answer) => nserver.notice(answer.error))")
            student.wait("document.querySelector('#notice').innerText.includes('robot 2 only')")
            # 3. The teacher stops all, which a student cannot release, resets one and releases all.
            robot.drive(translation_in_s=10)
            teacher.wait(f"{row(2)}.includes('moves')")
            teacher.page.click("#robots-stop")
            student.wait(f"{HELD} === '1,2,3'")
            student.page.click("#release")
            student.wait("document.querySelector('#notice').innerText.includes('who may release it')")
            start = teacher.value("nserver.scene.world.starts[1]")
            teacher.page.click("[aria-label='Reset 2 Bob']")
            teacher.wait(f"Math.hypot(nserver.scene.robots['2'].actual[0] - {start[0]}, "
                         f"nserver.scene.robots['2'].actual[1] - {start[1]}) < 0.1")
            teacher.page.click("#robots-release")
            teacher.wait(f"{HELD} === ''")


def test_list_and_labels_of_thirty_robots(browser: Browser) -> None:
    with nserver("arena", "--robots", "30") as program, open_page(browser, program.url) as page:
        page.wait("document.querySelectorAll('.robots tbody tr').length === 30")
        assert page.page.is_visible("#window-robots")
        # Labels do not overlap each other, on the map as it is and at other zooms.
        overlaps = """(async () => {
            const { placeLabels } = await import('/page/draw.js'), { toScreen } = await import('/page/geometry.js');
            const found = [];
            for (const zoom of [0.15, 0.4, 1, 3]) {
              const view = { ...nserver.map.view, scale: nserver.map.view.scale * zoom };
              const circles = Object.entries(nserver.scene.robots).map(([id, { actual: [x, y] }]) => ({ id,
                at: toScreen(view, x, y), radius: nserver.scene.bodies[id].radius_in * view.scale }));
              const names = Object.fromEntries(circles.map(({ id }) => [id, `Student ${id}`]));
              const boxes = placeLabels(circles, names, view.width).map(({ box }) => box);
              boxes.forEach(([l, t, r, b], k) => boxes.slice(k + 1).forEach(([left, top, right, bottom]) => {
                if (l < right && left < r && t < bottom && top < b) found.push(zoom); }));
              if (boxes.length !== 30) found.push('missing');
            }
            return found; })()"""
        assert page.value(overlaps) == []
    with nserver("thesis_room") as program, open_page(browser, program.url) as page:
        assert not page.page.is_visible("#window-robots")
