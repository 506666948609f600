"""Pages of the course and of the challenge: their commands run, their tables match the code."""

from __future__ import annotations

import json
import re

from docs.generate import course
from nserver_emu.nomad_commands import CHALLENGES, REFUSED_CALLS
from tests.docs.pages import DOCS, ROOT, command_lines, run


def test_commands_of_the_course_page() -> None:
    # The same command twice: as a table, and with --json.
    table, as_json = command_lines("course.md")
    assert "5 of 5 points" in run(table, ROOT)
    found = json.loads(run(as_json, ROOT))
    assert found["seed"] == 7
    assert [each["points"] == each["of"] for each in found["submissions"]] == [True, True]


def test_course_page_and_site_have_all_notebooks() -> None:
    for page in ("course.md", "index.md"):
        text = (DOCS / page).read_text(encoding="utf-8")
        assert sorted(set(re.findall(r"course/(\d\d-[\w-]+)", text))) == list(course.NAMES)


def test_command_of_the_challenge_page() -> None:
    (command,) = command_lines("challenge.md")
    # The score of the shown run begins with 9: between 90 and 99, with a deterministic simulation.
    line, summary = run(command, ROOT).splitlines()
    assert line.startswith("run 1: score  9")
    (result,) = json.loads(summary)["runs"]
    assert (result["bumps"], result["ended"]) == (0, "finished")
    assert result["score"] > 90


def test_tables_of_the_challenge_page() -> None:
    text = (DOCS / "challenge.md").read_text(encoding="utf-8")
    for name, task in CHALLENGES.items():
        x, y = task.goal_in
        assert re.search(rf"\| `{name}` \| .* \| {x:g}, {y:g}\b.* \| {task.limit_s:g} s \|", text)
    named = set(re.findall(r"`(\w+)`", text.partition("are refused")[2].partition(")")[0]))
    assert named <= REFUSED_CALLS
