"""`nomad state`: text and JSON, once or repeatedly, without stopping a robot."""

from __future__ import annotations

import json
import sys

import pytest

from nclient.cli import main, robot
from tests.nclient.scripted_server import ScriptedServer, robot_on


@pytest.mark.long
def test_all_parts_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["state", "sim:thesis_room"]) == 0
    reported = capsys.readouterr().out
    assert reported.startswith("pose        x 0.0 in")
    assert reported.count("pose") == 1


@pytest.mark.long
def test_parts_again_and_again(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["state", "sim:thesis_room", "--watch", "--every", "0", "--count", "3", "clock"]) == 0
    clocks = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()]
    assert len(clocks) == 3
    assert clocks == sorted(set(clocks))


@pytest.mark.long
def test_time_of_a_simulation_passes_between_two_states(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("time.sleep", lambda _: None)
    assert main.main(["state", "sim:thesis_room", "--every", "0.5", "--count", "2", "clock"]) == 0
    first, second = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()]
    # The pause of 0.5 s is simulated time, and the query itself advances the clock by 1 ms.
    assert second - first == pytest.approx(0.501)


@pytest.mark.long
@pytest.mark.parametrize(("words", "looks"), [
    (["--count", "3"], 3), (["--every", "0", "--count", "2"], 2), (["--watch", "--count", "1"], 1), ([], 1),
])
def test_every_and_count_imply_watch(
    words: list[str], looks: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    slept: list[float] = []
    monkeypatch.setattr("time.sleep", slept.append)
    assert main.main(["state", "sim:thesis_room", "clock", *words]) == 0
    assert capsys.readouterr().out.count("clock") == looks
    # A pause between two states, and none after the last one.
    assert slept == [0.0 if "--every" in words else robot.EVERY_S] * (looks - 1)


@pytest.mark.long
def test_an_interval_alone_is_to_watch(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    slept: list[float] = []

    def twice(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", twice)
    assert main.main(["state", "sim:thesis_room", "clock", "--every", "0.5"]) == 0
    assert capsys.readouterr().out.count("clock") == 2
    assert slept == [0.5, 0.5]


def test_objects_for_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["state", "sim:thesis_room?robot=scout", "--json"]) == 0
    (line,) = capsys.readouterr().out.splitlines()
    assert json.loads(line)["model"] == "scout"


@pytest.mark.parametrize(("words", "reported"), [
    (["sim:", "sonars"], "no part 'sonars' of the state; there are pose, "),
    (["thesis_room"], "an address begins with one of nserver:, replay:, robotd:, serial:, serial+rfc2217:, "
     "serial+socket:, sim:"),
    (["sim:", "nserver://lab"], "one robot at a time, not sim: and nserver://lab"),
])
def test_words_that_are_neither(words: list[str], reported: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["state", *words]) == 2
    assert reported in capsys.readouterr().err


@pytest.mark.parametrize("count", ["0", "-1", "x"])
def test_a_count_is_a_number(count: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["state", "sim:", f"--count={count}"])
    assert "1 or more" in capsys.readouterr().err


def test_on_a_terminal_it_stays_in_its_place(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    slept: list[float] = []
    server = ScriptedServer()
    robot.watch(robot_on(server), ["error"], 2, 0.5, as_json=False, sleep=slept.append)
    # ESC [H moves the cursor home, ESC [J clears the screen below it.
    assert capsys.readouterr().out == "\x1b[H\x1b[Jerror       none\n" * 2
    assert slept == [0.5]
    assert server.names() == ["gs", "gs"]


def test_ctrl_c_is_how_watching_ends(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def interrupt(_: float) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", interrupt)
    assert main.main(["state", "sim:thesis_room", "clock", "--watch"]) == 0
    assert capsys.readouterr().out.count("clock") == 1
