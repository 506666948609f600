"""Readers of files written by people: worlds, setups, models, calibrations, fault plans, missions, old setups.

Each is read from a file, as the programs do, so that invalid encodings are tested too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from fuzz.mutation import any_of, mutate_bytes, word_mutator
from fuzz.reader import Reader, input_file
from localization.navigation.mission_steps import load_mission
from nclient.errors import FaultPlanError, MissionFileError, SetupFileError, WorldFileError
from nclient.faults.plan import KINDS, load_plan, parse_plan, plan_text
from nserver_emu.server.config import read_setups
from nserver_emu.simulation.models import load_models
from nserver_emu.simulation.noise import KEYS, load_setup
from worlds.io import SHIPPED, load_world
from worlds.robots import IDEAL_CALIBRATION, format_calibration, load_calibration

_DOCS = Path(__file__).parents[1] / "docs"
_TOML = (b"=", b"\n", b"[[", b"]]", b"[", b"]", b",", b"#", b".", b'"""', b"'''", b'"', b"0", b"-", b"1e3", b"true",
         b"\\")

_SETUP = b"""base = "measured"
name = "room 12"
ramps = true
[sonar]
model = "ray"
dead = [3, 11]
std_share = 0.02
[odometry]
scales = [1.01, 1.0, 1.0]
slip_in = 0.1
[motion]
alpha1 = 0.5
"""
_MODEL = b"""[[model]]
name = "wide"
like = "scout"
radius_cm = 30
track_cm = 40
bumpers = 6
compass = true
[model.right]
top_speed_in = 30
speed_in = 10
[[model]]
name = "n150"
[model.odometry]
way_scale = 1.01
[model.sonar]
turned_deg = 2
[model.steering]
top_speed_deg = 50
acceleration_deg = 30
"""
_WORLD = b"""[[wall]]
points_cm = [[0, 0], [100, 0], [100, 50]]
[[obstacle]]
name = "box"
corners_m = [[2, 2], [2.5, 2], [2.5, 2.5]]
[[start]]
x_in = -20
y_in = -20
steering_deg = 90
"""
_OLD_SETUP = b"""; the robot
[server]
port = 7019
[robot]
type = N200
[laser]
calibration = 1.0 2 3 4 \\
   5 6 7 8 ; eight
offset = 0 -1.5
"""
_STEPS = b"""fence_cm = [[0, 0], [9, 0], [9, 9]]
[[step]]
do = "turn"
by_deg = 90
[[step]]
do = "wait_for"
touching = true
time_limit_s = 5
[[step]]
do = "note"
words = "here"
[[step]]
do = "follow"
points_m = [[1, 1], [2, 2]]
[[step]]
do = "look"
for_s = 2
"""


def _world(data: bytes) -> None:
    load_world(input_file(data, ".toml")).clearance(0.0, 0.0)


def _plan(data: bytes) -> None:
    plan = load_plan(input_file(data, ".toml"))
    if parse_plan(plan_text(plan)) != plan:
        raise AssertionError("writing and reading changed the plan")


def _docs(pattern: str) -> Iterator[bytes]:
    """Return the examples of the documentation without comments, so that editing those does not change the inputs."""
    return (re.sub(rb"#[^\n]*", b"", path.read_bytes()) for path in sorted(_DOCS.glob(pattern)))


def _calibration() -> list[bytes]:
    return [format_calibration("n150", IDEAL_CALIBRATION, "faultless").encode(), _MODEL]


def _toml(
    name: str, description: str, read: Callable[[bytes], object], error: type[Exception],
    seeds: Callable[[], Iterable[bytes]], *words: str,
) -> Reader:  # fmt: skip
    # Keywords are inserted more often than bytes are changed: most byte changes are syntax errors.
    own = (*_TOML, *(word.encode() for word in words))
    words_first = any_of(word_mutator(*own), word_mutator(*own), mutate_bytes)
    return Reader(name, description, read, (error,), seeds, words_first)


_LENGTHS = tuple(f"{name}_{unit}" for name in ("corners", "points", "x", "y") for unit in ("in", "cm", "m"))

READERS = (
    _toml("worlds", "world files", _world, WorldFileError,
          lambda: [_WORLD, *(path.read_bytes() for path in sorted(SHIPPED.glob("*.toml")))],
          "[[room]]\n", "[[wall]]\n", "[[obstacle]]\n", "[[start]]\n", "[[path]]\n", "name", "title", "figure",
          "steering_deg", "turret_deg", *_LENGTHS),
    _toml("setups", "setup files", lambda data: load_setup(input_file(data, ".toml")), WorldFileError,
          lambda: [_SETUP, b'base = "worn"\n[infrared]\n', b'[sonar]\nmodel = "polaroid"\ncone_deg = 25\n'],
          *(f"{key.name} = " for key in KEYS), *(f"[{key.table}]\n" for key in KEYS if key.table), "polaroid", "worn"),
    _toml("models", "model files", lambda data: load_models(input_file(data, ".toml")), WorldFileError,
          lambda: [_MODEL, *_calibration()],
          "[[model]]\n", "[model.translation]\n", "[model.left]\n", "[model.spread]\n", "[model.odometry]\n", "like",
          "radius_in", "track_m", "sonar_ring_radius_in", "bumpers", "compass", "speed_in", "top_acceleration_deg"),
    _toml("calibrations", "calibrations in model files",
          lambda data: load_calibration(input_file(data, ".toml"), "n150"), WorldFileError, _calibration,
          "[[model]]\n", "[model.spread]\n", "offsets_in", "turned_deg", "drift_rad_in"),
    _toml("fault_plans", "fault plans", _plan, FaultPlanError, lambda: _docs("*.toml"),
          "[[rule]]\n", *(f'do = "{kind}"\n' for kind in KINDS), "every", "percent", "first", "at", "from_s", "until_s",
          "line", "command", "direction", "seed"),
    _toml("missions", "mission files", lambda data: load_mission(input_file(data, ".toml")), MissionFileError,
          lambda: [_STEPS, *_docs("missions/*.toml")],
          "[[step]]\n", 'do = "dock"\n', 'do = "patrol"\n', "time_limit_s", "retries", "rounds", "to_in", "within_in",
          "known_to_in", "heading_deg", "on_lost", "lost_s", "fence_in"),
    Reader("old_setups", "robot.setup and world.setup", lambda data: read_setups([input_file(data, ".setup")]),
           (SetupFileError,), lambda: [_OLD_SETUP, b"[robot]\ntype = scout\n"],
           any_of(word_mutator(b"[server]\n", b"port", b"[laser]\n", b"\\\n", b";", b"offset", b"calibration"),
                  mutate_bytes), max_size=1024),
)  # fmt: skip
