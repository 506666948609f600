"""Where there is room for one more robot: at a start of the world, or in rings of places around the starts.

What a simulation is set up from, whoever asks: command line or address. One value, checked once.
"""

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

GAP_IN: Final = 1.0
"""Between neighbours in a ring."""

MAX_RINGS: Final = 60
"""Around each start: 11,000 places. A world as wide as that has room for a thousand robots."""


class StartPoseAllocator:
    """Places for robots that come one after another; a place that was refused once is not asked for again.

    So robots may come meanwhile, but none may go or move.
    """

    def __init__(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._untried: dict[float, Iterator[StartPose]] = {}

    def next(self, radius_in: float) -> StartPose | None:
        """The first place where a robot of this radius touches nothing and nobody; None where there is none."""
        spatial_hash, world = self._simulation.spatial_hash, self._simulation.world
        for place in self._untried.setdefault(radius_in, self._places(2.0 * radius_in + GAP_IN)):
            here = place.x_in, place.y_in
            if not spatial_hash.touched(*here, radius_in) and world.clearance(*here) > radius_in:
                return place
        return None

    def _places(self, spacing_in: float) -> Iterator[StartPose]:
        """The starts, then rings around each, as far as the world goes."""
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
        """From a start to the farthest corner of a room; without rooms there is no end."""
        corners = [corner for room in self._simulation.world.rooms for corner in room.corners_in]
        return max((hypot(x - start.x_in, y - start.y_in) for x, y in corners), default=inf)


FIRST_ROBOT = 1
MAX_ROBOTS = 1000
"""That one command line or address puts into a world."""

MODEL_NAMES = tuple(MODELS)
"""The robots that can be simulated."""


Placement = tuple[str, StartPose | None]
"""A robot by its model, and where it starts; None: where there is room."""


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """World by name or file, robot by model, where it starts (None: where the world says), noise and seed.

    setup         how real: the name of a setup, or a file of one in TOML; "": as `noisy` says
    others        the robots with the numbers from 2 on
    model_file    models that override or add to those there are
    """

    world: str = DEFAULT_WORLD
    robot: str = "n150"
    start: StartPose | None = None
    seed: int = 0
    noisy: bool = False
    setup: str = ""
    others: tuple[Placement, ...] = ()
    model_file: Path | None = None

    def simulation(self) -> Simulation:
        """The simulation as set. Raises WorldFileError, AddressError (model, setup) or StartError, with the remedy."""
        models = load_models(self.model_file) if self.model_file else MODELS
        simulation = Simulation(load_world(self.world), seed=self.seed)
        setup = setup_named(self.setup or (NOISY.name if self.noisy else IDEAL.name))
        places = StartPoseAllocator(simulation)
        simulation.add_robot(FIRST_ROBOT, self.start, _model(models, self.robot), setup, powered=False)
        for robot_id, (name, start) in enumerate(self.others, start=FIRST_ROBOT + 1):
            model = _model(models, name)
            place = start or places.next(model.body.radius_in)
            if place is None:
                raise StartError(
                    f"no room for robot {robot_id} around the starts of {self.world}: take fewer robots or a larger "
                    "world, or give it a --start"
                )
            simulation.add_robot(robot_id, place, model, setup, powered=False)
        simulation.power_on()
        return simulation


def robot_placements(models: Sequence[str], starts: Sequence[str], count: int) -> list[Placement]:
    """Robots 1, 2, 3 ...: as many as there are models or starts, and `count` at least.

    The last model counts for the rest; who has no start gets a free one. Raises AddressError for a start that is none.
    """
    poses = [pose_from_text(text) for text in starts]
    number = max(len(models), len(poses), count)
    return list(zip_longest([*models, *[models[-1]] * (number - len(models))], poses))


def _model(models: Mapping[str, RobotModel], name: str) -> RobotModel:
    """The model of that name. Raises AddressError, naming the models there are."""
    try:
        return models[name.lower()]
    except KeyError:
        raise AddressError(f"no robot model {name!r}; there are {', '.join(models)}") from None


def pose_from_text(text: str) -> StartPose:
    """A pose from `X,Y,STEER,TURRET` in inches and degrees, the angles 0 where left out."""
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
