"""`nomad challenge`: scores, refused commands, and programs that fail or do not end."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

import pytest

from nclient.cli.main import main
from nclient.protocol.commands import Call
from nserver_emu.nomad_commands import CHALLENGES, REFUSED_CALLS, Referee, _run_program, score
from nserver_emu.server.config import SimulationConfig
from nserver_emu.server.inprocess import InProcess
from nserver_emu.server.server_state import SimulationClock
from nserver_emu.server.session import REFUSED, ConnectionContext
from worlds.io import load_world
from worlds.robots import N150

DRIVE = """
import sys, os
from nclient import connect
assert os.environ["NOMAD_ADDRESS"] == os.environ["NOMAD_ROBOT"] == sys.argv[1]
with connect() as robot:
    x, y = map(float, os.environ["NOMAD_GOAL"].split(","))
    start = os.environ["NOMAD_START"].split(",")
    robot.move(translation_in=40)
    robot.wait_until_still()
"""


def play(tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, *words: str) -> dict[str, Any]:
    program = tmp_path / "program.py"
    program.write_text(text, encoding="utf-8")
    assert main(["challenge", "thesis_room", str(program), "--json", "--seed", "3", "--runs", "1", *words]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    return found


@pytest.fixture
def referee() -> Referee:
    config = SimulationConfig(world="thesis_room", noisy=True)
    emulator = Referee(config.simulation(), clock=SimulationClock(lockstep_s=0.1))
    emulator.watch(10.0)
    return emulator


@pytest.mark.parametrize(
    ("error_in", "time_s", "bumps", "points"),
    # 50 points for the fraction of the distance covered, 50 for precision, 0 from 24 in on; minus 0.1 per second and
    # 5 per contact.
    [
        (0.0, 0.0, 0, 100.0),
        (100.0, 0.0, 0, 0.0),
        (12.0, 0.0, 0, 50 * 0.88 + 25),
        (0.0, 100.0, 0, 90.0),
        (0.0, 0.0, 3, 85.0),
        (150.0, 50.0, 9, 0.0),
    ],
)
def test_score(error_in: float, time_s: float, bumps: int, points: float) -> None:
    assert score(error_in, 100.0, time_s, bumps) == pytest.approx(points)


@pytest.mark.parametrize("name", CHALLENGES)
def test_goal_is_free_and_a_standing_robot_scores_nothing(name: str) -> None:
    world, task = load_world(name), CHALLENGES[name]
    start = world.starts[task.start]
    assert world.clearance(*task.goal_in) > N150.radius_in + 2
    assert world.clearance(start.x_in, start.y_in) > N150.radius_in
    distance = ((start.x_in - task.goal_in[0]) ** 2 + (start.y_in - task.goal_in[1]) ** 2) ** 0.5
    assert distance > 24
    assert score(distance, distance, task.limit_s, 0) == 0.0


def test_referee_refuses_the_truth(referee: Referee) -> None:
    context = ConnectionContext(robot_id=1)
    for name in sorted(REFUSED_CALLS):
        reply = referee.answer(Call(name, (1,) * 8), context)
        assert getattr(reply, "values", None) == (REFUSED,), name


def test_referee_counts_contacts_that_begin(referee: Referee) -> None:
    robot = referee.simulation.robots[1]
    # Backward into the wall, forward, backward again: two contacts, each counted once.
    for speed in (-20.0, 20.0, -20.0):
        robot.set_velocities(speed, 0.0, 0.0)
        for _ in range(30 if speed < 0 else 10):
            referee.pass_time(0.1)
    assert referee.bumps == 2


def test_time_ends_at_the_limit(referee: Referee) -> None:
    session = InProcess(referee)
    # 15 s are offered, the limit is 10.
    for _ in range(150):
        referee.pass_time(0.1)
    assert referee.over.is_set()
    assert referee.simulation.time_s == pytest.approx(10.0)
    session.close()


@pytest.mark.long
def test_program_drives_a_hidden_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = play(tmp_path, capsys, DRIVE)
    (run,) = found["runs"]
    assert run["ended"] == "finished"
    assert run["bumps"] == 0
    assert 70 < run["error_in"] < 113
    assert found["score"] == run["score"] > 0


@pytest.mark.long
def test_standing_and_failing_programs_have_a_score(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    standing = play(tmp_path, capsys, "")
    assert (standing["score"], standing["runs"][0]["ended"]) == (0.0, "finished")
    failing = play(tmp_path, capsys, "raise SystemExit(7)")
    # A program that fails scores like one that stands.
    assert (failing["score"], failing["runs"][0]["ended"]) == (0.0, "exit code 7")


@pytest.mark.long
def test_program_without_end_is_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = play(tmp_path, capsys, "import time\ntime.sleep(1000)", "--timeout", "0.5")
    assert found["runs"][0]["ended"] == "timeout"


async def test_time_stands_still_when_a_program_is_ended() -> None:
    over = asyncio.Event()
    assert await _run_program(["sleep", "100"], dict(os.environ), over, 0.01) == "timeout"
    assert over.is_set()


def test_program_that_is_missing_or_not_executable(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "text").write_text("")
    (tmp_path / "script").write_text("no first line")
    (tmp_path / "script").chmod(0o755)
    for name, word in (("none.py", "no such file"), ("text", "executed"), ("script", "#!")):
        assert main(["challenge", "corridor", str(tmp_path / name)]) == 2
        assert word in capsys.readouterr().err
