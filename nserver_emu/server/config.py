"""The configuration of a simulation from a command line or an address, and free start poses for its robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from math import cos, hypot, inf, sin, tau
from pathlib import Path
from typing import Final

from nclient.errors import AddressError, StartError
from nserver_emu.simulation.models import MODELS, RobotModel, load_models
from nserver_emu.simulation.noise import IDEAL, NOISY, setup_named
from nserver_emu.simulation.simulation import Simulation
from worlds.io import DEFAULT_WORLD, load_world
from worlds.schema import MAX_COORDINATE_IN
from worlds.world import StartPose

# Distance between neighbours in a ring.
GAP_IN: Final = 1.0
# Rings around each start: 11,000 poses, enough for a thousand robots in a world of that size.
MAX_RINGS: Final = 60


class StartPoseAllocator:
    """Allocator of free poses: the starts of the world, then rings of poses around them.

    A pose found occupied is not tried again; robots may be added meanwhile, but none may be removed or move.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._untried: dict[float, Iterator[StartPose]] = {}

    def next(self, radius_in: float) -> StartPose | None:
        """Return the first pose where a robot of this radius touches nothing, None if there is none."""
        spatial_hash, world = self._simulation.spatial_hash, self._simulation.world
        for pose in self._untried.setdefault(radius_in, self._candidates(2.0 * radius_in + GAP_IN)):
            position = pose.x_in, pose.y_in
            if not spatial_hash.touched(*position, radius_in) and world.clearance(*position) > radius_in:
                return pose
        return None

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
                raise StartError(
                    f"no room for robot {robot_id} around the starts of {self.world}: take fewer robots or a larger "
                    "world, or give it a --start"
                )
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
