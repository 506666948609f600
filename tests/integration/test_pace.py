"""The same program runs at the same pace on `sim:` and over TCP."""

from __future__ import annotations

import math
import re
import sys
from itertools import pairwise

import pytest

from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.robot import Robot
from tests.docs.pages import ROOT
from tests.programs.forked import Forked

SECONDS = 6


def run_example(name: str, address: str, monkeypatch: pytest.MonkeyPatch) -> tuple[float, float]:
    """Run SECONDS of an example; return inches driven and calls, each per second of the robot's time."""
    places: list[tuple[float, float, float]] = []
    execute = Robot.execute

    def observe(robot: Robot, call: Call) -> Reply:
        reply = execute(robot, call)
        # What passes the time is a call on sim:, and a pause over TCP.
        if call.name != "sim_control":
            places.append((robot.state.clock_s or 0.0, robot.state.x_in, robot.state.y_in))
        return reply

    text = (ROOT / "examples" / name).read_text(encoding="utf-8")
    text, count = re.subn(r"clock_s \+ \d+", f"clock_s + {SECONDS}", text)
    assert count == 1
    with monkeypatch.context() as patched:
        patched.setattr(Robot, "execute", observe)
        patched.setattr(sys, "argv", [name, address])
        exec(text, {})
    duration_s = places[-1][0] - places[0][0]
    driven_in = sum(math.hypot(x - x0, y - y0) for (_, x0, y0), (_, x, y) in pairwise(places))
    return driven_in / duration_s, len(places) / duration_s


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "world", "seed", "start"),
    [("wander.py", "flat", 4, "63,94,0,0"), ("wall_follower.py", "several_walls", 1, "20,20,0,0")],
)
def test_example_drives_as_far_with_as_many_calls(
    name: str, world: str, seed: int, start: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    speed, rate = run_example(name, f"sim:{world}?noisy=1&seed={seed}&start={start}", monkeypatch)
    assert speed > 2.0
    assert rate == pytest.approx(20, abs=1)
    with Forked("nserver", world, "--noisy", "--seed", str(seed), "--start", start, "--port", "0") as process:
        port = process.stdout.readline().rpartition(":")[2].strip()
        speed_over_tcp, rate_over_tcp = run_example(name, f"nserver://127.0.0.1:{port}/1", monkeypatch)
        process.terminate()
    assert speed_over_tcp == pytest.approx(speed, rel=0.15)
    # A pause that the machine makes longer leaves fewer calls, never more.
    assert 0.5 * rate < rate_over_tcp < rate + 1
