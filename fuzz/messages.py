"""Readers of JSON messages: of the viewer page, of publishing localizers, and of the control socket in both directions.

A control line that succeeds replaces the server, so that each line starts from the same state. Lines that contain
`save`, or escapes that could encode it, are skipped: nothing is written to disk.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any, get_args

import msgspec

from fuzz.mutation import any_of, mutate_bytes, mutate_json
from fuzz.reader import Reader
from localization.live.run import parse_answer
from nclient.errors import ControlError
from nserver_emu.control.cli import format_result, parse_response
from nserver_emu.control.commands import COMMANDS, answer_line
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.inprocess import open_address
from nserver_emu.server.serial_session import FaultController
from nserver_emu.viewer.messages import Call, Control, InvalidMessage, parse_estimate, parse_message

_PLAN = 'seed = 1\n[[rule]]\ndo = "drop"\nevery = 10\n'
_WORLD = "[[wall]]\npoints_in = [[-90, -90], [90, -90]]\n"
_ARGUMENTS: dict[str, list[Any]] = {
    "faults set": [{"text": _PLAN, "file": "plan"}], "world set": [{"text": _WORLD, "file": "w.toml"}],
    "noise": ["sensors=measured motion=ideal robot=1", {"sensors": "ideal"}], "speed": ["10", "max", 0.5],
    "step": ["0.1", 1], "stop": [None, 1, "1"], "release": [None, 1],
    "obstacle": ['{"corners": [[0, 0], [9, 0], [9, 9]], "by": [1, 0]}', {"corners": [[0, 0], [1, 1], [2, 0]]}],
}  # fmt: skip


class FakeServer(Daemon):
    """A server without sockets, as far as control commands use it."""

    def __init__(self) -> None:
        self.emulator = open_address("sim:several_walls?robot=scout").emulator
        self.emulator.clock.lockstep_s = None
        self.faults = FaultController(lambda: 0.0)

    def step(self, dt_s: float) -> None:
        """Advance by at most 0.1 s: a longer step repeats short ones and tests no other code."""
        self.emulator.simulation.step(min(dt_s, 0.1))

    def record_clock(self) -> None:
        pass

    def record_change(self, change: Mapping[str, Any]) -> None:
        json.dumps(change)

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


_server = functools.lru_cache(maxsize=1)(FakeServer)


def _control(data: bytes) -> None:
    """Every line has an answer of one line; a rejected line changes nothing."""
    # Do not let the server write files.
    if b"save" in data or b"\\u" in data:
        return
    answer = answer_line(_server(), data)
    if answer.count(b"\n") != 1:
        raise AssertionError("the answer is not one line")
    # A command that succeeded may have changed the server: use a new one for the next line.
    if json.loads(answer)["ok"]:
        _server.cache_clear()


def _message(data: bytes) -> None:
    json.dumps(msgspec.to_builtins(parse_message(data.decode())), allow_nan=False)


def _published(data: bytes) -> None:
    json.dumps(parse_estimate(data.decode()), allow_nan=False)


def _answer(data: bytes) -> None:
    """Format an answer as `nserver ctl` prints it."""
    "\n".join(format_result(parse_response(data))).encode()


def _utf8_only(read: Callable[[bytes], None]) -> Callable[[bytes], None]:
    """Skip inputs that are not UTF-8: the libraries reject them before the reader."""

    def read_utf8(data: bytes) -> None:
        try:
            data.decode()
        except UnicodeDecodeError:
            return
        read(data)

    return read_utf8


# Valid inputs


def _control_seeds() -> list[bytes]:
    return [
        json.dumps({"command": row.name, "argument": argument}).encode()
        for row in COMMANDS if row.name != "save" for argument in _ARGUMENTS.get(row.name, [None])
    ]  # fmt: skip


def _answer_seeds() -> list[bytes]:
    """Return the answers of a server to valid commands and to an invalid one."""
    return [answer_line(FakeServer(), line) for line in (*_control_seeds(), b'{"command": "speed", "argument": "no"}')]


def _message_seeds() -> list[bytes]:
    message: list[dict[str, Any]] = [
        {"do": "seen", "frame": 3}, {"do": "watch", "traffic": True, "laser": False, "robot": 1},
        {"do": "drive", "id": 1, "robot": 1, "args": [1, 2, 3]}, {"do": "stop", "id": 2}, {"do": "release", "id": 3},
        {"do": "click", "robot": 1, "pose": [1, 2, 3, 4]},
        {"do": "waypoints", "robot": 1, "points": [[1.5, 2], [3, 4]]},
        *({"do": "call", "id": 1, "robot": 1, "call": call, "args": [1, 2]} for call in sorted(get_args(Call))),
        *({"do": "control", "id": 1, "command": name, "argument": None} for name in sorted(get_args(Control))),
    ]  # fmt: skip
    return [json.dumps(each).encode() for each in message]


def _published_seeds() -> list[bytes]:
    echo = {"sonar": 3, "reading_in": 20.5, "refusal": "gate", "innovation_in": 0.5, "nis": 3.1}
    message = {
        "robot": 1, "clock_s": 3.5, "pose": [1.0, 2.0, 0.5], "turret": 0.1, "odometry": [1.0, 2.0, 0.5],
        "cov": [[1.0, 0.1, 0.0], [0.1, 1.0, 0.0], [0.0, 0.0, 0.1]], "truth": None, "echoes": [echo, echo],
        "waypoints": [[1, 2], [3, 4]], "passed": 1, "began": True, "trust": "OK", "reason": "", "places": [],
    }  # fmt: skip
    lost = {"trust": "LOST", "reason": "two poses look alike", "places": [
        {"pose": [1.0, 2.0, 0.5], "share": 0.5}, {"pose": [9.0, 2.0, 3.5], "share": 0.25}]}  # fmt: skip
    with_truth = {"truth": [0.0, 0.0, 0.0], "echoes": []}
    return [json.dumps(each).encode() for each in (message, message | with_truth, message | lost)]


_TREE = any_of(mutate_json, mutate_json, mutate_json, mutate_bytes)

READERS = (
    Reader("viewer_messages", "messages from the viewer page", _utf8_only(_message), (InvalidMessage,), _message_seeds,
           _TREE),
    Reader("published", "messages from publishing localizers", _utf8_only(_published), (InvalidMessage,),
           _published_seeds, _TREE),
    Reader("publish_answers", "answers to published messages", parse_answer, (ValueError,),
           lambda: [b'{"waypoints": [[1, 2], [3.5, 4]], "set": 2}', b'{"waypoints": null, "set": 0}'], _TREE,
           max_size=1024),
    Reader("control_answers", "answers to nserver ctl", _answer, (ControlError,), _answer_seeds, _TREE,
           max_size=8192),
    Reader("control_lines", "lines to the control socket", _control, (), _control_seeds, _TREE, max_size=2048),
)  # fmt: skip
