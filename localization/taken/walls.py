"""Which walls are taken for true: what --map says, else what a command knows of itself, else a sim: address's world.

Rules: values; the address is read as text, and the walls from their file.
"""

from __future__ import annotations

import argparse

from localization.taken.body import SIMULATION
from nclient.address import parsed
from nclient.connect import address_or_default
from nclient.schemes import Wanted, opening_of
from worlds.files import DEFAULT_WORLD, load_world
from worlds.world import World


def add_map(parser: argparse.ArgumentParser, known: str = "") -> None:
    """The option; `known` is where else the command may have its walls from, for its help."""
    parser.add_argument("--map", "--world", metavar="WORLD",
                        help=f"the walls: a shipped world or a TOML file (default: {known}the world of a sim: address)")
    parser.set_defaults(refuse=parser.error)


def world_of(options: argparse.Namespace, known: str = "") -> World:
    """The world, of options with an `address` (None: the default's); where none is told that is wrong usage. Raises
    WorldFileError where it cannot be read, AddressError where the address is none."""
    there = parsed(address_or_default(options.address))
    told = options.map or known
    if not told and there.scheme == SIMULATION:
        told = there.text.partition(":")[2].partition("?")[0] or DEFAULT_WORLD
    if not told:
        opening_of(there.text, Wanted())
        options.refuse("which walls are there? --map WORLD, a shipped world or a TOML file")
    return load_world(told)
