"""Every program in examples/ runs, in this process on simulated time; tests/clib runs those in C."""

from __future__ import annotations

import re
import runpy
import shlex
import sys
from pathlib import Path

import pytest

from tests.clib.test_examples import C_PRINTS
from tests.docs.pages import ROOT, command_lines

EXAMPLES = ROOT / "examples"
PRINTS = {
    "class_client.py": r"nearest thing ahead \d+ in",
    "compare_filters.py": r"ekf +RMSE 0\.\d.*\niekf .*\nukf ",
    # Noise has a fixed seed or a limited size, so that each pattern fixes the digits that are certain.
    "corridor_challenge.py": r"the filter says (79|80)\.\d, (79|80)\.\d in",
    "first.py": r"encoders: 2[34]\.\d.*\ntruth: +2[345]\.\d",
    "gym_policy.py": r"goal reached in \d+ of 20 episodes\nsim:.*: (reached|not reached) after \d+\.\d s",
    "map_and_go.py": r"arrived at (89|90)\.\d, 5[45]\.\d in ± 0\.\d+ in, OK",
    "record_and_replay.py": r"live: +(.*)\nreplayed: \1\n",
    "square.py": r"the robot is [2-9]\.\d in from its start; the encoders say 0\.\d in",
    "two_robots.py": r"sim:thesis_room: (1\d|2[0-4]) in before the wall.*\nsim:hall: (1\d|2[0-4]) in before",
    "wall_follower.py": r"\d\d\d steps along walls, (1[6-9]|2[0-6])\.\d in away",
    "wander.py": r"\d+ turns, now at .* bumpers free",
}
"""What each program prints; own_filter.py is run by test_own_filter_page.py."""


def test_there_are_ten_and_each_is_run() -> None:
    files = {path.name for path in EXAMPLES.iterdir() if path.suffix in (".py", ".c")}
    # A new example fails here until its output is entered above.
    assert files == {*PRINTS, *C_PRINTS, "own_filter.py"}
    assert len(files) >= 10


def test_page_shows_every_example_and_how_to_run_it() -> None:
    page = (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
    for name in (*PRINTS, *C_PRINTS, "own_filter.py"):
        assert f"`{name}`" in page, name
    commands = [line for line in command_lines("examples.md") if "examples/" in line]
    assert {word for line in commands for word in re.findall(r"examples/(\S+)", line)} <= {path.name for path in
                                                                                       EXAMPLES.iterdir()}  # fmt: skip


def test_example_takes_an_address(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    command = next(line for line in command_lines("examples.md") if "wander.py" in line)
    _, _, address = shlex.split(command)
    monkeypatch.setattr(sys, "argv", ["wander.py", address])
    # __main__: the guarded part of the program is executed as well.
    runpy.run_path(str(EXAMPLES / "wander.py"), run_name="__main__")
    assert re.search(PRINTS["wander.py"], capsys.readouterr().out)


@pytest.mark.parametrize("name", PRINTS)
def test_example_runs(
    name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(tmp_path / "drive.log")] if name == "record_and_replay.py" else []
    monkeypatch.setattr(sys, "argv", [name, *words])
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    assert re.search(PRINTS[name], capsys.readouterr().out)
