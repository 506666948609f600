"""What may follow `nserver ctl`, as a tree of parsers: for completion, which is made from parsers.

    status      faults ─ show, set FILE, clear ...      noise WORD ...      world ─ show, set WORLD | FILE

Rules: made from the table of commands and from ctl's own options. It reads nothing: what is typed is ctl's to judge.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from nserver_emu.ctl import WORDS, add_options
from nserver_emu.server.control.control import COMMANDS, MAX_SPEED, ControlCommand
from nserver_emu.simulation.setup import SETUPS
from nserver_emu.simulation.setup_parts import PARTS

_FILES: Final = frozenset({"FILE", "WORLD"})
"""Arguments that may name a file."""
_OFFERED: Final[Mapping[str, Iterable[str]]] = MappingProxyType({
    "noise": [f"{part}={setup}" for part in PARTS for setup in SETUPS], "speed": [MAX_SPEED],
})  # fmt: skip
"""Words that an argument may be, by the command."""


def add_commands(parser: argparse.ArgumentParser) -> None:
    """ctl's options, and every command as a subcommand with them."""
    add_options(parser)
    places = {"": parser.add_subparsers()}
    for row in COMMANDS:
        group, _, name = row.name.rpartition(" ")
        if group not in places:
            above = _add(places[""], group, _about(group))
            places[group] = above.add_subparsers()
        _add_argument(_add(places[group], name, row.about), row)


def _add(place: Any, name: str, about: str) -> argparse.ArgumentParser:
    command: argparse.ArgumentParser = place.add_parser(name, help=about)
    add_options(command)
    return command


def _about(group: str) -> str:
    """The commands of a group, by their second words."""
    return ", ".join(row.name.rpartition(" ")[2] for row in COMMANDS if row.name.startswith(f"{group} "))


def _add_argument(command: argparse.ArgumentParser, row: ControlCommand) -> None:
    if row.argument:
        command.add_argument(
            "argument", metavar=row.argument, nargs="*" if row.argument == WORDS else None,
            choices=_OFFERED.get(row.name), type=Path if row.argument in _FILES else str,
        )  # fmt: skip
