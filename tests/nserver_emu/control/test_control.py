"""Control commands: each has its effect; an invalid request changes nothing and names what is valid."""

from __future__ import annotations

import asyncio
import json
import math
import os
import sys
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from fuzz.messages import FakeServer
from nclient.faults.plan import Direction, Drop, Plan, Rule, plan_text
from nserver_emu.control import snapshot
from nserver_emu.control.commands import BY_NAME, answer_line, answer_line_in_thread
from nserver_emu.server.handlers.runtime_settings import read_world_file
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.serial_session import FaultController
from nserver_emu.server.server_state import SimulationClock
from tests.nserver_emu.server.wire_client import ORIGIN, simulation
from worlds.io import parse_world
from worlds.world import World

PLAN = Plan((Rule("it", (Drop(),), commands=("gs",)),), seed=4)


class RecordingServer(FakeServer):
    """A daemon without a socket, that records its calls."""

    def __init__(self, pace: SimulationClock | None = None) -> None:
        self.emulator = Emulator(simulation(seed=5), clock=pace)
        self.faults = FaultController(lambda: 0.0)
        self.changes: list[dict[str, Any]] = []
        self.paces: list[tuple[float | None, bool]] = []

    def step(self, dt_s: float) -> None:
        self.emulator.simulation.step(dt_s)

    def record_clock(self) -> None:
        self.paces.append((self.emulator.clock.factor, self.emulator.clock.paused))

    def record_change(self, change: Mapping[str, Any]) -> None:
        self.changes.append(dict(change))

    def send(self, request: object) -> dict[str, Any]:
        line = request if isinstance(request, bytes) else json.dumps(request).encode()
        # One line out for each line in, whatever it contains.
        answer = answer_line(self, line)
        assert answer.endswith(b"\n")
        assert answer.count(b"\n") == 1
        whole: dict[str, Any] = json.loads(answer)
        return whole

    def request(self, command: str, argument: object = None) -> dict[str, Any]:
        answer = self.send({"command": command, "argument": argument})
        assert answer["ok"], answer
        result: dict[str, Any] = answer["said"]
        return result


def test_a_look_at_everything() -> None:
    server = RecordingServer()
    robot = server.emulator.simulation.robots[1]
    robot.set_velocities(10.0, 0.0, 0.0)
    server.step(1.0)
    result = server.request("status")
    assert (result["world"], result["seed"], result["time_s"], result["speed"], result["paused"]) == (
        "thesis_room", 5, 1.0, 1.0, False,
    )  # fmt: skip
    (status,) = result["robots"]
    assert (status["number"], status["model"], status["moving"], status["bumpers"]) == (1, "n150", True, 0)
    assert (status["x_in"], status["y_in"]) == pytest.approx((robot.actual.x_in, robot.actual.y_in), abs=1e-3)
    assert status["x_in"] > ORIGIN.x_in
    assert status["steering_deg"] == pytest.approx(math.degrees(robot.actual.steering_rad), abs=0.01)
    assert result["lines"] == {"nserver": "127.0.0.1:7019", "serial:1": "/tmp/robot"}
    assert result["connections"][0]["name"] == "127.0.0.1:1"
    assert result["faults"] == {"rules": 0, "struck": {}}


def test_time_is_the_owners() -> None:
    server = RecordingServer()
    assert server.request("pause") == {"time_s": 0.0, "speed": 1.0, "paused": True, "lockstep_s": None}
    assert server.request("step", "0.5")["time_s"] == 0.5
    assert server.request("step", 0.25)["time_s"] == 0.75
    assert server.request("resume")["paused"] is False
    assert server.request("speed", "10")["speed"] == 10.0
    assert server.request("speed", "max")["speed"] == "max"
    # Pause, two steps and resume, then two speeds: the clock is recorded each time.
    assert server.paces == [(1.0, True)] * 3 + [(1.0, False), (10.0, False), (None, False)]


def test_in_lockstep_there_is_no_speed() -> None:
    server = RecordingServer(SimulationClock(lockstep_s=0.1))
    answer = server.send({"command": "speed", "argument": "2"})
    assert (answer["ok"], "start nserver without --lockstep" in answer["error"]) == (False, True)
    assert server.request("pause")["lockstep_s"] == 0.1


def test_a_plan_comes_into_force_counts_and_goes() -> None:
    server = RecordingServer()
    assert server.request("faults set", {"text": plan_text(PLAN), "file": "p.toml"}) == {"rules": 1}
    assert server.faults.plan == PLAN
    assert server.request("faults show") == {"plan": plan_text(PLAN)}
    server.faults.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 0.0)
    # One frame on the serial line has matched the rule, none on the other.
    counts = {"nserver": {"it": {"seen": 0, "drop": 0}}, "serial:1": {"it": {"seen": 1, "drop": 1}}}
    assert server.request("faults counts") == {"counts": counts}
    assert server.request("status")["faults"] == {"rules": 1, "struck": {"drop": 1}}
    assert server.request("faults reset") == {"counts": counts}
    assert server.request("status")["faults"] == {"rules": 1, "struck": {}}
    server.faults.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 0.0)
    assert server.request("faults clear") == {"counts": counts}
    assert server.request("faults counts") == {"counts": {}}


def test_noise_is_changed_returned_and_recorded() -> None:
    server = RecordingServer()
    assert server.request("noise", "sensors=measured") == {"noise": {"1": {"sensors": "measured", "motion": "ideal"}}}
    assert server.request("noise", {"motion": "noisy", "robot": 1})["noise"]["1"]["motion"] == "noisy"
    assert server.request("status")["robots"][0]["noise"] == {"sensors": "measured", "motion": "noisy"}
    for wrong in (7, "loud", {"sensors": "loud"}):
        assert "noise: " in server.send({"command": "noise", "argument": wrong})["error"]
    # Only what was valid is recorded, in the form in which it was requested.
    assert server.changes == [{"noise": {"sensors": "measured"}}, {"noise": {"motion": "noisy", "robot": 1}}]


def test_the_world_is_shown_and_another_put_in_its_place() -> None:
    server = RecordingServer()
    text = server.request("world show")["text"]
    assert parse_world(text, "", "").name == "thesis_room"
    changed = {"text": text.replace("thesis_room", "mine"), "file": "x.toml"}
    assert server.request("world set", changed) == {"world": "mine"}
    assert server.request("status")["world"] == "mine"
    for wrong in ("name", {"file": "x"}, {"text": text, "file": 3}):
        error = server.send({"command": "world set", "argument": wrong})["error"]
        assert "world set: the text of a world file" in error
    broken = {"command": "world set", "argument": {"text": "]", "file": "x.toml"}}
    assert "x.toml: is no TOML" in server.send(broken)["error"]
    # A world that was shown is recorded too: its text restores exactly it.
    assert server.changes == [{"shown": True}, {"world": changed}]


def test_the_simulation_is_saved(tmp_path: Path) -> None:
    server = RecordingServer()
    server.step(2.0)
    path = tmp_path / "now.json"
    assert server.request("save", str(path)) == {"saved": str(path)}
    again = Emulator(simulation())
    snapshot.restore(again, path)
    assert again.simulation.time_s == 2.0


def test_help_lists_every_command() -> None:
    commands = RecordingServer().request("help")["commands"]
    assert list(commands) == list(BY_NAME)
    assert commands["speed"][0] == "X"


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (b"what", 'a request is a line such as {"command"'),
        (b"[]", "a request is a line"),
        (b'"x"', "a request is a line"),
        (b"{}", "a request is a line"),
        # Deeper than Python's recursion limit.
        (b"[" * 100_000, "a request is a line"),
        ({"command": "puase"}, "no command 'puase'; there are status, .*; did you mean pause?"),
        ({"command": 5}, "no command 5"),
        ({"command": "speed"}, "speed requires X"),
        ({"command": "speed", "argument": "fast"}, "speed: max, or a number from 0.1 to 999, not 'fast'"),
        ({"command": "speed", "argument": 1000}, "from 0.1 to 999, not 1000"),
        ({"command": "speed", "argument": True}, "not True"),
        ({"command": "speed", "argument": [1]}, "not [1]"),
        # An integer that does not fit into a float; its text is cut in the message.
        ({"command": "speed", "argument": 10**400}, "from 0.1 to 999, not 1000"),
        ({"command": "step", "argument": -(10**400)}, "step: seconds from 0 to 60, not -1000"),
        ({"command": "step", "argument": 61}, "step: seconds from 0 to 60, not 61"),
        ({"command": "save", "argument": 5}, "save: the name of a file, not 5"),
        ({"command": "save", "argument": "/nowhere/at/all"}, "cannot be written"),
        ({"command": "save", "argument": "a\0b"}, "cannot be written: embedded null byte"),
        ({"command": "faults set", "argument": "x"}, "faults set: the text of a plan"),
        ({"command": "faults set", "argument": {}}, "faults set: the text of a plan"),
        ({"command": "faults set", "argument": {"text": "x", "file": "p.toml"}}, "p.toml: is no TOML"),
        ({"command": "faults set", "argument": {"text": "[[rule]]\ndo='nak'\nline='serial:2'"}}, "no serial:2"),
    ],
)
def test_an_invalid_request_changes_nothing(request_: object, words: str) -> None:
    server = RecordingServer()
    before = server.request("status")
    answer = server.send(request_)
    assert answer["ok"] is False
    for part in words.split(".*"):
        assert part in answer["error"]
    assert server.request("status") == before


def test_robots_are_stopped_for_good_and_released() -> None:
    server = RecordingServer()
    server.emulator.simulation.robots[1].set_velocities(10.0, 0.0, 0.0)
    assert server.request("stop") == {"held": {"1": {"by": "nserver ctl", "ignored": 0}}}
    assert server.emulator.simulation.robots[1].is_still((0, 1, 2))
    assert server.request("status")["robots"][0]["held"] == {"by": "nserver ctl", "ignored": 0}
    assert server.request("release", "1") == {"held": {}}
    assert server.request("stop", 1)["held"]
    assert server.request("release")["held"] == {}
    assert server.request("status")["robots"][0]["held"] is None
    # A number without robot, a word, a float and a list.
    for wrong in ("7", "all", 1.0, [1]):
        error = server.send({"command": "stop", "argument": wrong})["error"]
        assert error == f"stop: no robot {wrong}; there are 1"
    assert server.request("status")["robots"][0]["held"] is None


def test_an_obstacle_is_moved_by_its_corners() -> None:
    server = RecordingServer()
    server.emulator.simulation.change_world(parse_world(WITH_OBSTACLE, "w", "w"))
    wanted = {"corners": [[60, 60], [70, 60], [70, 70]], "by": [1, 2]}
    assert server.request("obstacle", wanted)["is"] == [[61, 62], [71, 62], [71, 72]]
    assert server.emulator.simulation.world.obstacles[0].corners_in[0] == (61.0, 62.0)
    # By its new corners; without "by" it is removed.
    assert server.request("obstacle", '{"corners": [[61, 62], [71, 62], [71, 72]]}')["obstacles"] == 0
    assert len(server.changes) == 2
    for wrong in (3, "{", [1]):
        assert "obstacle: such as" in server.send({"command": "obstacle", "argument": wrong})["error"]
    assert len(server.changes) == 2


WITH_OBSTACLE = """
[[room]]
corners_in = [[-50, -50], [90, -50], [90, 90], [-50, 90]]
[[obstacle]]
corners_in = [[60, 60], [70, 60], [70, 70]]
"""


# A pipe would block, a device would lose the snapshot.
@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, lambda path: path.symlink_to("/dev/null")])
def test_save_refuses_what_is_no_regular_file(tmp_path: Path, make: Callable[[Path], object]) -> None:
    make(tmp_path / "other")
    answer = RecordingServer().send({"command": "save", "argument": str(tmp_path / "other")})
    assert not answer["ok"]
    assert f"{tmp_path / 'other'}: cannot be written" in answer["error"]
    assert "regular" in answer["error"]


async def test_a_world_is_read_while_the_event_loop_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    may_go_on = threading.Event()

    def read_slowly(text: str, file: str) -> World:
        assert may_go_on.wait(20.0)
        return read_world_file(text, file)

    monkeypatch.setattr("nserver_emu.server.handlers.runtime_settings.read_world_file", read_slowly)
    server, interval = RecordingServer(), sys.getswitchinterval()
    argument = {"text": "[[room]]\ncorners_in = [[-50, -50], [90, -50], [90, 90], [-50, 90]]", "file": "new.toml"}
    request = json.dumps({"command": "world set", "argument": argument}).encode()
    asyncio.get_running_loop().call_later(0.05, may_go_on.set)
    answer = json.loads(await answer_line_in_thread(server, request))
    # The event loop was running meanwhile, as the timer that lets the thread continue shows.
    assert answer == {"ok": True, "said": {"world": "new"}}
    assert server.emulator.simulation.world.name == "new"
    assert server.changes == [{"world": argument}]
    # The interval at which Python switches threads is restored.
    assert sys.getswitchinterval() == pytest.approx(interval)


@pytest.mark.parametrize("argument", [None, {"text": 5}, {"text": "[[room", "file": "bad.toml"}])
async def test_a_wrong_world_is_refused_by_name(argument: object) -> None:
    server = RecordingServer()
    before = server.emulator.simulation.world
    answer = json.loads(
        await answer_line_in_thread(server, json.dumps({"command": "world set", "argument": argument}).encode())
    )
    assert not answer["ok"]
    assert "world set" in answer["error"] or "bad.toml" in answer["error"]
    assert server.emulator.simulation.world is before
    assert json.loads(await answer_line_in_thread(server, b'{"command": "status"}'))["ok"]
