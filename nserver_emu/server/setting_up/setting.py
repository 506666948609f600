"""What a simulation is set up from, whoever asks: command line or address. One value, checked once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from nclient.errors import AddressError, StartError
from nserver_emu.server.setting_up.places import FreePlaces
from nserver_emu.simulation.model_files import load_models
from nserver_emu.simulation.models import MODELS, RobotModel
from nserver_emu.simulation.setup import IDEAL, NOISY
from nserver_emu.simulation.setup_toml import setup_named
from nserver_emu.simulation.simulation import Simulation
from worlds.files import DEFAULT_WORLD, load_world
from worlds.tables import FARTHEST_IN
from worlds.world import StartPose

FIRST_ROBOT = 1
MOST_ROBOTS = 1000
"""That one command line or address puts into a world."""

READY_MODELS = tuple(MODELS)
"""The robots that can be simulated."""


Placed = tuple[str, StartPose | None]
"""A robot by its model, and where it starts; None: where there is room."""


@dataclass(frozen=True, slots=True)
class Setting:
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
    others: tuple[Placed, ...] = ()
    model_file: Path | None = None

    def simulation(self) -> Simulation:
        """The simulation as set. Raises WorldFileError, AddressError (model, setup) or StartError, with the remedy."""
        models = load_models(self.model_file) if self.model_file else MODELS
        simulation = Simulation(load_world(self.world), seed=self.seed)
        setup = setup_named(self.setup or (NOISY.name if self.noisy else IDEAL.name))
        places = FreePlaces(simulation)
        simulation.add_robot(FIRST_ROBOT, self.start, _model(models, self.robot), setup, awake=False)
        for robot_id, (name, start) in enumerate(self.others, start=FIRST_ROBOT + 1):
            model = _model(models, name)
            place = start or places.next(model.body.radius_in)
            if place is None:
                raise StartError(
                    f"no room for robot {robot_id} around the starts of {self.world}: take fewer robots or a larger "
                    "world, or give it a --start"
                )
            simulation.add_robot(robot_id, place, model, setup, awake=False)
        simulation.wake()
        return simulation


def placed(models: Sequence[str], starts: Sequence[str], count: int) -> list[Placed]:
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
    if not 2 <= len(numbers) <= 4 or not all(abs(number) <= FARTHEST_IN for number in numbers):
        raise AddressError(f"a start is X,Y,STEER,TURRET in inches and degrees, such as 10,20,90,0, none beyond "
                           f"{FARTHEST_IN:g}; got {text!r}")
    x, y, steering, turret = (*numbers, *[0.0] * (4 - len(numbers)))
    return StartPose(x, y, math.radians(steering), math.radians(turret))
