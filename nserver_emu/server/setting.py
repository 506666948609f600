"""What a simulation is set up from, whoever asks: command line or address. One value, checked once."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nclient.errors import AddressError
from nclient.protocol.models import model_named
from nserver_emu.simulation.models import MODELS
from nserver_emu.simulation.setup import IDEAL, NOISY
from nserver_emu.simulation.simulation import Simulation
from worlds.files import load_world
from worlds.world import StartPose

DEFAULT_WORLD = "thesis_room"
FIRST_ROBOT = 1
READY_MODELS = tuple(MODELS)
"""The robots that can be simulated."""


@dataclass(frozen=True, slots=True)
class Setting:
    """World by name or file, robot by model, where it starts (None: where the world says), noise and seed."""

    world: str = DEFAULT_WORLD
    robot: str = "n150"
    start: StartPose | None = None
    seed: int = 0
    noisy: bool = False

    def simulation(self) -> Simulation:
        """The simulation as set. Raises WorldFileError, AddressError (model) or StartError, naming the remedy."""
        model = model_named(self.robot)
        simulation = Simulation(load_world(self.world), seed=self.seed)
        setup = NOISY if self.noisy else IDEAL
        simulation.add_robot(FIRST_ROBOT, self.start, MODELS[model.name], setup)
        return simulation


def pose_from_text(text: str) -> StartPose:
    """A pose from `X,Y,STEER,TURRET` in inches and degrees, the angles 0 where left out."""
    parts = text.split(",")
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if not 2 <= len(numbers) <= 4 or not all(math.isfinite(number) for number in numbers):
        raise AddressError(f"a start is X,Y,STEER,TURRET in inches and degrees, such as 10,20,90,0; got {text!r}")
    x, y, steering, turret = (*numbers, *[0.0] * (4 - len(numbers)))
    return StartPose(x, y, math.radians(steering), math.radians(turret))
