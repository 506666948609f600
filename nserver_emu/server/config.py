r"""The configuration of a simulation from a command line or an address, and free start poses for its robots.

Reader of the original's robot.setup and world.setup.

    [section]            ; a comment
    key = value value \
          value          a backslash at the end joins the next line

Keys are case-sensitive, the last of two entries applies, unknown keys are ignored. No sample of either file survives;
documented are [server] port, [robot] type, [laser] calibration (8 numbers) and offset (2). The meaning of the laser's
ten numbers is not documented: they are checked and have no effect, which `unused` reports. New files use TOML.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from math import cos, hypot, inf, sin, sqrt, tau
from pathlib import Path
from typing import Final

import numpy as np

from nclient.common.files import read_binary
from nclient.errors import AddressError, SetupFileError, StartError
from nclient.protocol.types import get_model
from nserver_emu.simulation.models import MODELS, RobotModel, load_models
from nserver_emu.simulation.noise import IDEAL, NOISY, setup_named
from nserver_emu.simulation.simulation import Simulation
from worlds.io import DEFAULT_WORLD, load_world
from worlds.schema import MAX_COORDINATE_IN
from worlds.world import StartPose

CALIBRATION_NUMBERS: Final = 8
OFFSET_NUMBERS: Final = 2
MAX_BYTES: Final = 1 << 20
"""More than any handwritten setup; a larger file is something else."""


@dataclass(frozen=True, slots=True)
class LegacySetup:
    """Settings of old setup files; None where a file has none. The laser's numbers have no effect."""

    port: int | None = None
    robot: str | None = None
    laser_calibration: tuple[float, ...] | None = None
    laser_offset: tuple[float, ...] | None = None

    @property
    def unused(self) -> tuple[str, ...]:
        """Keys that are present and have no effect."""
        given = {"[laser] calibration": self.laser_calibration, "[laser] offset": self.laser_offset}
        return tuple(key for key, numbers in given.items() if numbers is not None)


@dataclass(slots=True)
class Entry:
    """The values of a key, and its line number."""

    line: int
    words: list[str] = field(default_factory=list)


def read_setups(paths: Iterable[Path]) -> LegacySetup:
    """Read setup files; later ones override earlier ones. Raises SetupFileError."""
    setup = LegacySetup()
    for path in paths:
        text = read_binary(path, MAX_BYTES, SetupFileError).decode("latin-1")
        setup = _with_entries(setup, parse_setup(text, str(path)), str(path))
    return setup


def parse_setup(text: str, file: str = "setup") -> Mapping[tuple[str, str], Entry]:
    """Parse a setup file into entries by section and key; `file` is its name in errors. Raises SetupFileError."""
    entries: dict[tuple[str, str], Entry] = {}
    section = ""
    for number, line in _joined(text):
        content = line.partition(";")[0].strip()
        if not content:
            continue
        if content.startswith("["):
            if not content.endswith("]"):
                raise SetupFileError(f"{file}, line {number}: expected [section], found {content!r}")
            section = content[1:-1].strip()
            continue
        key, sign, value = content.partition("=")
        if not sign or not key.strip():
            raise SetupFileError(f"{file}, line {number}: expected key = value, found {content!r}")
        entries[section, key.strip()] = Entry(number, value.split())
    return entries


def _joined(text: str) -> Iterator[tuple[int, str]]:
    """Yield line numbers and lines without comments; lines that end in a backslash are joined with the next."""
    whole, first = "", 0
    for number, line in enumerate(text.splitlines(), start=1):
        first = first or number
        content = line.partition(";")[0].rstrip()
        if content.endswith("\\"):
            whole += content[:-1] + " "
            continue
        yield first, whole + content
        whole, first = "", 0
    if whole:
        yield first, whole


def _with_entries(setup: LegacySetup, entries: Mapping[tuple[str, str], Entry], file: str) -> LegacySetup:
    """Return the setup with the settings of one more file."""
    if entry := entries.get(("server", "port")):
        setup = replace(setup, port=_port(entry, file))
    if entry := entries.get(("robot", "type")):
        setup = replace(setup, robot=_robot(entry, file))
    if entry := entries.get(("laser", "calibration")):
        setup = replace(setup, laser_calibration=_numbers(entry, CALIBRATION_NUMBERS, file, "calibration"))
    if entry := entries.get(("laser", "offset")):
        setup = replace(setup, laser_offset=_numbers(entry, OFFSET_NUMBERS, file, "offset"))
    return setup


def _port(entry: Entry, file: str) -> int:
    word = entry.words[0] if len(entry.words) == 1 else ""
    if not (word.isascii() and word.isdecimal()) or len(word) > 5 or int(word) > 0xFFFF:
        raise SetupFileError(f"{file}, line {entry.line}: port is a number 0 to 65535, not {' '.join(entry.words)!r}")
    return int(word)


def _robot(entry: Entry, file: str) -> str:
    try:
        return get_model(" ".join(entry.words)).name
    except AddressError as error:
        raise SetupFileError(f"{file}, line {entry.line}: {error}") from None


def _numbers(entry: Entry, count: int, file: str, key: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(word) for word in entry.words)
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        raise SetupFileError(f"{file}, line {entry.line}: {key} is {count} numbers, not {' '.join(entry.words)!r}")
    return numbers


# Distance between neighbours in a ring.
GAP_IN: Final = 1.0
# Distance that a robot can drive ahead from its start, where the world has room for that: old programs drive at once.
ROOM_AHEAD_IN: Final = 24.0
# Rings around each start: 11,000 poses, enough for a thousand robots in a world of that size.
MAX_RINGS: Final = 60


class StartPoseAllocator:
    """Allocator of free poses: the starts of the world, then rings of poses around them.

    Poses where a robot has ROOM_AHEAD_IN before it, and takes none of another robot's, come first; then the others. A
    pose found occupied is not tried again; robots may be added meanwhile, but none may be removed or move.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._untried: dict[float, Iterator[StartPose]] = {}
        # Free poses without room ahead, by radius.
        self._cramped: dict[float, deque[StartPose]] = {}

    def next(self, radius_in: float) -> StartPose | None:
        """Return the first pose where a robot of this radius touches nothing, None if there is none."""
        cramped = self._cramped.setdefault(radius_in, deque())
        for pose in self._untried.setdefault(radius_in, self._candidates(2.0 * radius_in + GAP_IN)):
            if not self._is_free(pose, radius_in):
                continue
            if has_room_ahead(self._simulation, pose, radius_in):
                return pose
            cramped.append(pose)
        while cramped:
            if self._is_free(pose := cramped.popleft(), radius_in):
                return pose
        return None

    def _is_free(self, pose: StartPose, radius_in: float) -> bool:
        """Return True if a robot touches nothing there."""
        position = pose.x_in, pose.y_in
        return (not self._simulation.spatial_hash.touched(*position, radius_in)
                and self._simulation.world.clearance(*position) > radius_in
                and not self._simulation.touched_walker(*position, radius_in))

    def _candidates(self, spacing_in: float) -> Iterator[StartPose]:
        """Return the starts, then rings around each to the farthest corner of a room."""
        starts = self._simulation.world.starts
        yield from starts
        reach_in = {start: self._reach_in(start) for start in starts}
        for ring in range(1, MAX_RINGS + 1):
            for start in (start for start in starts if ring * spacing_in <= reach_in[start]):
                for number in range(6 * ring):
                    angle = tau * number / (6 * ring)
                    x = start.x_in + ring * spacing_in * cos(angle)
                    y = start.y_in + ring * spacing_in * sin(angle)
                    yield StartPose(x, y, start.steering_rad, start.turret_rad)

    def _reach_in(self, start: StartPose) -> float:
        """Return the distance from a start to the farthest corner of a room, infinity without rooms."""
        corners = [corner for room in self._simulation.world.rooms for corner in room.corners_in]
        return max((hypot(x - start.x_in, y - start.y_in) for x, y in corners), default=inf)


def has_room_ahead(simulation: Simulation, pose: StartPose, radius_in: float, own: int | None = None) -> bool:
    """Return True if a robot can drive ROOM_AHEAD_IN straight ahead, and stands in no other robot's path.

    `own` is its number if it stands there already.
    """
    # 1. Walls: the clearance at points half a radius apart.
    cosine, sine = cos(pose.steering_rad), sin(pose.steering_rad)
    distances = np.arange(0.0, ROOM_AHEAD_IN + radius_in / 2.0, radius_in / 2.0).clip(max=ROOM_AHEAD_IN)
    ahead = np.column_stack((pose.x_in + distances * cosine, pose.y_in + distances * sine))
    if (simulation.world.clearances(ahead) <= radius_in).any():
        return False
    # 2. Robots nearby: neither may stand in the other's path.
    near = simulation.spatial_hash.touched(pose.x_in, pose.y_in, radius_in + ROOM_AHEAD_IN)
    for number, (x, y, radius) in near:
        if number == own:
            continue
        reach_in, dx, dy = radius + radius_in, x - pose.x_in, y - pose.y_in
        if _is_in_path(dx, dy, pose.steering_rad, reach_in):
            return False
        if _is_in_path(-dx, -dy, simulation.robots[number].actual.steering_rad, reach_in):
            return False
    return True


def _is_in_path(dx_in: float, dy_in: float, heading_rad: float, reach_in: float) -> bool:
    """Return True if a robot touches another at (dx, dy) within ROOM_AHEAD_IN; `reach_in` is the sum of their radii."""
    along = dx_in * cos(heading_rad) + dy_in * sin(heading_rad)
    across = dy_in * cos(heading_rad) - dx_in * sin(heading_rad)
    return along > 0.0 and abs(across) < reach_in and along - sqrt(reach_in**2 - across**2) < ROOM_AHEAD_IN


FIRST_ROBOT = 1
# Robots that one command line or address can create.
MAX_ROBOTS = 1000
# Models that exist without a model file.
MODEL_NAMES = tuple(MODELS)

# Model name and start pose of a robot; None for a free pose.
Placement = tuple[str, StartPose | None]


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """The configuration of a simulation. Field names are keys in recordings."""

    # Name or file of the world.
    world: str = DEFAULT_WORLD
    robot: str = "n150"
    # None: the first start of the world.
    start: StartPose | None = None
    seed: int = 0
    noisy: bool = False
    # Name or TOML file of the noise models; empty: as `noisy` says.
    setup: str = ""
    # Robots from number 2.
    others: tuple[Placement, ...] = ()
    # Models that override or extend the built-in ones.
    model_file: Path | None = None

    def simulation(self) -> Simulation:
        """Create the simulation. Raise WorldFileError, AddressError (model, setup) or StartError, with the remedy."""
        models = load_models(self.model_file) if self.model_file else MODELS
        simulation = Simulation(load_world(self.world), seed=self.seed)
        setup = setup_named(self.setup or (NOISY.name if self.noisy else IDEAL.name))
        # Robots sleep until all are placed: none measures a world without the others.
        poses = StartPoseAllocator(simulation)
        simulation.add_robot(FIRST_ROBOT, self.start, _model(models, self.robot), setup, powered=False)
        for robot_id, (name, start) in enumerate(self.others, start=FIRST_ROBOT + 1):
            model = _model(models, name)
            pose = start or poses.next(model.body.radius_in)
            if pose is None:
                raise StartError(f"no room for robot {robot_id} around the starts of {self.world}: take fewer robots "
                                 "or a larger world, or give it a --start")
            simulation.add_robot(robot_id, pose, model, setup, powered=False)
        simulation.power_on()
        return simulation


def robot_placements(models: Sequence[str], starts: Sequence[str], count: int) -> list[Placement]:
    """Return model and start of robots 1, 2, 3 ...: as many as there are models or starts, at least `count`.

    Further robots have the last model and a free start pose. Raises AddressError for an invalid start.
    """
    poses = [pose_from_text(text) for text in starts]
    number = max(len(models), len(poses), count)
    return list(zip_longest([*models, *[models[-1]] * (number - len(models))], poses))


def _model(models: Mapping[str, RobotModel], name: str) -> RobotModel:
    """Return the model of a name. Raise AddressError with the available models."""
    try:
        return models[name.lower()]
    except KeyError:
        raise AddressError(f"no robot model {name!r}; there are {', '.join(models)}") from None


def pose_from_text(text: str) -> StartPose:
    """Parse `X,Y,STEER,TURRET` in inches and degrees; omitted angles are 0. Raise AddressError."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 4 or not all(abs(number) <= MAX_COORDINATE_IN for number in numbers):
        raise AddressError(f"a start is X,Y,STEER,TURRET in inches and degrees, such as 10,20,90,0, none beyond "
                           f"{MAX_COORDINATE_IN:g}; got {text!r}")
    x, y, steering, turret = (*numbers, *[0.0] * (4 - len(numbers)))
    return StartPose(x, y, math.radians(steering), math.radians(turret))
