"""`go`, `mission` and `localize` with `--publish`: the messages, and a missing viewer that ends them at once."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from nclient.cli.main import main
from nserver_emu.viewer.messages import parse_estimate
from tests.localization.viewer_stub import page_that

SIM = "sim:thesis_room?noisy=1&seed=1"


@contextmanager
def a_page() -> Iterator[tuple[str, list[Any]]]:
    """A page that takes what it is reported as the daemon's does, and soon sets a path-point; its address and that."""
    output: list[Any] = []

    def taken(message: Any) -> tuple[int, str]:
        # Validate like the server, which rejects invalid estimates.
        output.append(parse_estimate(json.dumps(message)))
        # The third answer has a new goal: 8 instead of 7.
        return 200, json.dumps({"waypoints": [[15, 10]], "set": 7 if len(output) < 3 else 8})

    with page_that(taken) as (url, _):
        yield url, output


@pytest.mark.long
def test_go_publishes_goal_estimate_and_truth_each_period() -> None:
    with a_page() as (url, output):
        assert main(["go", SIM, "--to", "20,12,90", "--speed", "8", "--publish", url]) == 0
    # Only the first message begins a run.
    assert [one["began"] for one in output[:2]] == [True, False]
    assert len(output) > 20
    assert {one["trust"] for one in output} == {"OK"}
    # The goal of the command line, not the page's.
    assert output[-1]["waypoints"] == [[20, 12]]
    assert output[-1]["robot"] == 1
    x, y, heading = output[-1]["pose"]
    assert (x, y, heading) == (pytest.approx(20, abs=1), pytest.approx(12, abs=1), pytest.approx(math.pi / 2, abs=0.1))
    # Truth and estimate are of the same instant, else they would be some tenths of an inch apart.
    off = [math.dist(one["pose"][:2], one["truth"][:2]) for one in output]
    assert 0 < max(off) < 2, "the truth is that of the estimate's own instant"
    assert any(echo["refusal"] == "none" for one in output for echo in one["echoes"])


@pytest.mark.parametrize("command", [("go", "--to", "-20,30"), ("localize", "--waypoints", "-20,30")])
def test_no_truth_is_published_or_reported_on_a_map_with_a_frame_of_its_own(
    command: Sequence[str], learned: str, capsys: pytest.CaptureFixture[str]
) -> None:
    address = "sim:several_walls?noisy=1&seed=1&start=5,5,0"
    words = ("--map", learned, "--start", "0,0,90", "--json")
    with page_that(lambda _: (200, '{"waypoints": null, "set": 0}')) as (url, received):
        assert main([command[0], address, *command[1:], *words, "--publish", url]) == 0
    assert len(received) > 10
    assert {parse_estimate(json.dumps(message))["truth"] for _, message in received} == {None}
    report = json.loads(capsys.readouterr().out)
    assert (report["truth"] is None) == (command[0] == "go")
    # On the map of the world both have one.
    assert main([command[0], address, command[1], "30,20", "--map", "several_walls", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["truth"] is not None


def test_localize_that_stays_needs_no_path_point_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    with a_page() as (url, output):
        words = ["--map", "thesis_room", "--stay", "--time-limit", "9", "--publish", url]
        assert main(["localize", SIM, *words]) == 0
    assert output[0]["waypoints"] == []
    assert output[-1]["waypoints"] == [[15, 10]]
    assert "1 of 1 waypoints reached" in capsys.readouterr().out


@pytest.mark.long
def test_a_mission_shows_as_well(tmp_path: Path) -> None:
    file = tmp_path / "m.toml"
    file.write_text('map = "thesis_room"\n[[step]]\ndo = "turn"\nby_deg = 30\n')
    with a_page() as (url, output):
        assert main(["mission", str(file), SIM, "--publish", url]) == 0
    assert output[-1]["pose"][2] == pytest.approx(output[-1]["truth"][2], abs=0.05)
    assert output[-1]["odometry"][2] == pytest.approx(math.radians(30), abs=0.05)
    assert output[-1]["waypoints"] == []


def test_missing_viewer_is_reported_before_any_motion(capsys: pytest.CaptureFixture[str]) -> None:
    with a_page() as (url, _):
        pass
    assert main(["go", SIM, "--to", "20,12", "--publish", url]) == 1
    shown = capsys.readouterr()
    assert "cannot publish to 127.0.0.1:" in shown.err
    assert "go_to" not in shown.out
    assert main(["go", SIM, "--to", "20,12", "--publish", "nowhere"]) != 0
    assert "is not the address of a page" in capsys.readouterr().err
