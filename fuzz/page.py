"""Readers of what comes from the page, from who publishes to it, and at the control socket, from either end.

Rules: what a control line changes lasts for that line: the daemon it was said to is made anew. Nothing is saved: a line
with save in it is left out, and one that could spell it otherwise.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from fuzz.mutating import bytes_changed, either, tree_changed
from fuzz.reader import Reader
from localization.live.publish import waypoints_in
from nclient.errors import ControlError
from nserver_emu.control.cli import said_in, shown
from nserver_emu.control.commands import COMMANDS, answer_line
from nserver_emu.server.inprocess import open_address
from nserver_emu.server.link import FaultController
from nserver_emu.viewer.localization import published
from nserver_emu.viewer.messages import CALLS, CONTROLS, BadMessage, from_page

_PLAN = 'seed = 1\n[[rule]]\ndo = "drop"\nevery = 10\n'
_WORLD = "[[wall]]\npoints_in = [[-90, -90], [90, -90]]\n"
_ARGUMENTS: dict[str, list[Any]] = {
    "faults set": [{"text": _PLAN, "file": "plan"}], "world set": [{"text": _WORLD, "file": "w.toml"}],
    "noise": ["sensors=measured motion=ideal robot=1", {"sensors": "ideal"}], "speed": ["10", "max", 0.5],
    "step": ["0.1", 1], "stop": [None, 1, "1"], "release": [None, 1],
    "obstacle": ['{"corners": [[0, 0], [9, 0], [9, 9]], "by": [1, 0]}', {"corners": [[0, 0], [1, 1], [2, 0]]}],
}  # fmt: skip


class House:
    """A daemon without a socket (nserver_emu.control.commands.Served)."""

    def __init__(self) -> None:
        self.emulator = open_address("sim:several_walls?robot=scout").emulator
        self.emulator.clock.lockstep_s = None
        self.faults = FaultController(lambda: 0.0)

    def step(self, dt_s: float) -> None:
        """A longer step is the shortest one again and again: this one shows as much."""
        self.emulator.simulation.step(min(dt_s, 0.1))

    def paced(self) -> None:
        pass

    def changed(self, what: Mapping[str, Any]) -> None:
        json.dumps(what)

    def hold(self, robot_ids: Iterable[int], by: str) -> None:
        for robot_id in robot_ids:
            self.emulator.hold(robot_id, by)

    def release(self, robot_ids: Iterable[int]) -> None:
        for robot_id in robot_ids:
            self.emulator.estop.release(robot_id)

    def lines(self) -> Mapping[str, str]:
        return {"nserver": "127.0.0.1:7019", "serial:1": "/tmp/robot"}

    def connected_clients(self) -> list[dict[str, Any]]:
        return [{"name": "127.0.0.1:1", "robot": 1, "waiting": False, "refused": 0}]


_house = functools.lru_cache(maxsize=1)(House)


def _control(data: bytes) -> None:
    """Every line has an answer, a line too; one that is refused changes nothing."""
    if b"save" in data or b"\\u" in data:
        return
    answer = answer_line(_house(), data)
    if answer.count(b"\n") != 1:
        raise AssertionError("an answer is one line")
    if json.loads(answer)["ok"]:
        _house.cache_clear()


def _message(data: bytes) -> None:
    json.dumps(from_page(data.decode()), allow_nan=False)


def _published(data: bytes) -> None:
    json.dumps(published(data.decode()), allow_nan=False)


def _answer(data: bytes) -> None:
    """What `nserver ctl` makes of an answer can be printed."""
    "\n".join(shown(said_in(data))).encode()


def _text(read: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """A websocket's text and a body decoded as such are UTF-8 already, or never get here."""

    def reads(data: bytes) -> None:
        try:
            data.decode()
        except UnicodeDecodeError:
            return
        read(data)

    return reads


# seeds


def _control_seeds() -> list[bytes]:
    return [
        json.dumps({"command": row.name, "argument": argument}).encode()
        for row in COMMANDS if row.name != "save" for argument in _ARGUMENTS.get(row.name, [None])
    ]  # fmt: skip


def _answer_seeds() -> list[bytes]:
    """What a daemon answers to each command, well and ill said."""
    return [answer_line(House(), line) for line in (*_control_seeds(), b'{"command": "speed", "argument": "no"}')]


def _message_seeds() -> list[bytes]:
    said: list[dict[str, Any]] = [
        {"do": "seen", "frame": 3}, {"do": "watch", "traffic": True, "laser": False, "robot": 1},
        {"do": "drive", "id": 1, "robot": 1, "args": [1, 2, 3]}, {"do": "stop", "id": 2}, {"do": "release", "id": 3},
        {"do": "click", "robot": 1, "pose": [1, 2, 3, 4]},
        {"do": "waypoints", "robot": 1, "points": [[1.5, 2], [3, 4]]},
        *({"do": "call", "id": 1, "robot": 1, "call": call, "args": [1, 2]} for call in sorted(CALLS)),
        *({"do": "control", "id": 1, "command": name, "argument": None} for name in sorted(CONTROLS)),
    ]  # fmt: skip
    return [json.dumps(each).encode() for each in said]


def _published_seeds() -> list[bytes]:
    echo = {"sonar": 3, "reading_in": 20.5, "refusal": "gate", "innovation_in": 0.5, "nis": 3.1}
    said = {
        "robot": 1, "clock_s": 3.5, "pose": [1.0, 2.0, 0.5], "turret": 0.1, "odometry": [1.0, 2.0, 0.5],
        "cov": [[1.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 0.1]], "truth": None, "echoes": [echo, echo],
        "waypoints": [[1, 2], [3, 4]], "passed": 1, "began": True, "trust": "OK", "reason": "", "places": [],
    }  # fmt: skip
    lost = {"trust": "LOST", "reason": "two places are alike", "places": [
        {"pose": [1.0, 2.0, 0.5], "share": 0.5}, {"pose": [9.0, 2.0, 3.5], "share": 0.25}]}  # fmt: skip
    return [json.dumps(each).encode() for each in (said, said | {"truth": [0.0, 0.0, 0.0], "echoes": []}, said | lost)]


_TREE = either(tree_changed, tree_changed, tree_changed, bytes_changed)

READERS = (
    Reader("viewer_messages", "what a page says", _text(_message), (BadMessage,), _message_seeds, _TREE),
    Reader("published", "what a localizer publishes", _text(_published), (BadMessage,), _published_seeds, _TREE),
    Reader("publish_answers", "what a page answers to it", waypoints_in, (ValueError,),
           lambda: [b'{"waypoints": [[1, 2], [3.5, 4]], "set": 2}', b'{"waypoints": null, "set": 0}'], _TREE,
           longest=1024),
    Reader("control_answers", "what nserver ctl is answered", _answer, (ControlError,), _answer_seeds, _TREE,
           longest=8192),
    Reader("control_lines", "lines at the control socket", _control, (), _control_seeds, _TREE, longest=2048),
)  # fmt: skip
