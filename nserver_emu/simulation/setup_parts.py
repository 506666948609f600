"""The parts of a setup that can be switched while a robot runs: how its sensors err, and how its motion strays.

    sensors    sonar, infrared, compass        motion    motion, odometry

Rules: ramps and the robot's clock are no noise and stay as they are. A part is called after the first named setup that
has it so, or after the setup that the robot began with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any, Final

from nserver_emu.simulation.individual import setup_of
from nserver_emu.simulation.models import RobotModel
from nserver_emu.simulation.setup import SETUPS, RobotSetup

PARTS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType({
    "sensors": ("sonar", "infrared", "compass"), "motion": ("motion", "odometry"),
})  # fmt: skip
"""The fields of RobotSetup that each part is made of."""


def part_choices(part: str, model: RobotModel, began: RobotSetup) -> dict[str, RobotSetup]:
    """What a part can be switched to, by name: the named setups that differ in it, and the one begun with; all with
    what this model errs by itself (individual)."""
    choices: dict[str, RobotSetup] = {}
    for setup in (*(setup_of(model, named) for named in SETUPS.values()), began):
        if all(_fields(part, setup) != _fields(part, other) for other in choices.values()):
            choices[setup.name if setup.name not in choices else f"{setup.name} as begun"] = setup
    return choices


def part_name(part: str, setup: RobotSetup, model: RobotModel, began: RobotSetup) -> str:
    """What a part of a setup is called; the setup's own name for one that is none of the choices."""
    wanted = _fields(part, setup)
    choices = part_choices(part, model, began).items()
    return next((name for name, choice in choices if _fields(part, choice) == wanted), setup.name)


def with_part(setup: RobotSetup, part: str, source: RobotSetup) -> RobotSetup:
    """The setup with a part as another one has it."""
    return replace(setup, **_fields(part, source))


def _fields(part: str, setup: RobotSetup) -> dict[str, Any]:
    return {field: getattr(setup, field) for field in PARTS[part]}
