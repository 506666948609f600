"""Whose body a robot has: what its address says of it, else what --body says.

Rules: pure; an address tells by `model=`, a sim: address by `robot=` or, without it, that it is an n150. Where both
speak they must agree: sizes, sonars and turret of another robot make every estimate wrong.

What --sonars left out comes to: what the robot is, where that can be known; else a guess that is said and doubted.

    sim:                as its setup hears: exact rays (ideal, noisy, worn) or a real ring's cones (measured)
    other simulations   rays, for a server does not tell its setup: a guess, said aloud, doubted by what is heard
    robots              cones

Rules: values and words; a setup is read from the address and its file alone. Whether readings fit is live.fit's to
say.

Which walls are taken for true: what --map says, else what a command knows of itself, else a sim: address's world.

Rules: values; the address is read as text, and the walls from their file.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from localization.live.localizer import Consistency, Echo
from nclient.connect import address_or_default
from nclient.errors import AddressError, WorldFileError
from nclient.url import parse_address, split_address
from worlds.io import DEFAULT_WORLD, load_world
from worlds.schema import parse_toml, read_text
from worlds.world import World

SIMULATION: Final = "sim"


def resolve_robot_model(option: str | None, model: str, address: str | None) -> str:
    """The name of the body: the option's, where the address does not tell; else `model`, as the address has it.

    `address` None: the default's. Raises AddressError where they contradict.
    """
    there = split_address(address_or_default(address))
    told = there.scheme == SIMULATION or "model" in there.options
    if option is None or (told and option == model):
        return model
    if told:
        raise AddressError(f"--body {option}: the robot at {there.text} is of model {model}; leave --body out")
    return option


FEWEST: Final = 30
"""Of fewer readings chance alone makes a bad fit."""


class Taken(NamedTuple):
    """For what the sonars are taken, and whether that is a guess."""

    rays: bool
    guessed: bool

    def line(self) -> str:
        """The guess in words; "" where somebody said it, or it is a robot's."""
        if not (self.rays and self.guessed):
            return ""
        return "sonars are taken for exact rays, this being a simulation (of setup measured: --sonars cones)"


AS_CONES: Final = Taken(rays=False, guessed=False)
RING_SETUPS: Final = ("measured",)
"""The named setups whose sonars hear like a real ring."""
RING_MODEL: Final = "polaroid"
"""What a setup's file calls such sonars."""


def taken(option: str | None, simulated: bool, address: str | None = None) -> Taken:
    """By the option `--sonars` (rays, cones or left out), what is at the other end, and its address (None: the
    default's)."""
    if option is not None:
        return Taken(option == "rays", guessed=False)
    told = sonar_model_of_address(address_or_default(address))
    return Taken(simulated, guessed=True) if told is None else Taken(told, guessed=False)


def sonar_model_of_address(address: str) -> bool | None:
    """Whether an address says that sonars are exact rays; None where it says nothing of it."""
    there = split_address(address)
    if there.scheme != SIMULATION:
        return None
    setup = there.options.get("setup", "")
    if not setup.endswith(".toml"):
        return setup not in RING_SETUPS
    try:
        values = parse_toml(read_text(Path(setup)), setup)
    except WorldFileError:
        return None
    sonar = values.get("sonar", {})
    model = sonar.get("model") if isinstance(sonar, dict) else None
    return values.get("base") not in RING_SETUPS if model is None else model != RING_MODEL


def hint(sonars: Taken, echoes: Iterable[Echo]) -> str:
    """What to say where the guess does not fit what was heard; "" where it does, or was none."""
    if not sonars.line():
        return ""
    fit = Consistency(sonars.rays)
    fit.add(echoes)
    return "" if fit.is_good or fit.used + fit.refused < FEWEST else fit.line()


def add_map_option(parser: argparse.ArgumentParser, known: str = "") -> None:
    """The option; `known` is where else the command may have its walls from, for its help."""
    parser.add_argument("--map", "--world", metavar="WORLD",
                        help=f"the walls: a shipped world or a TOML file (default: {known}the world of a sim: address)")
    parser.set_defaults(refuse=parser.error)


def resolve_world(options: argparse.Namespace, known: str = "") -> World:
    """The world, of options with an `address` (None: the default's); where none is told that is wrong usage. Raises
    WorldFileError where it cannot be read, AddressError where the address is none."""
    there = split_address(address_or_default(options.address))
    told = options.map or known
    if not told and there.scheme == SIMULATION:
        told = there.text.partition(":")[2].partition("?")[0] or DEFAULT_WORLD
    if not told:
        parse_address(there.text)
        options.refuse("which walls are there? --map WORLD, a shipped world or a TOML file")
    return load_world(told)
