"""Options beside --restore: what a snapshot decides cannot be said again, and the pace can.

Rules: wrong usage names the options and ends with 2, before anything starts. Said at all, an option of the pace has
the whole pace begin as the options say; else it goes on as the snapshot has it.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterable, Sequence
from typing import Final

from nclient.errors import NomadError
from nserver_emu.server.setup_files import read_setups

DECIDED: Final = ("robot", "robots", "model_file", "start", "seed", "setup", "noisy")
"""Options, by their names in the namespace, that a snapshot has decided."""

PACE: Final = ("speed", "paused", "lockstep")

_NOT_SAID: Final = "\0not said"


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str]) -> None:
    """Wrong usage where a snapshot is restored and something is said that it decides. Does not come back then."""
    if options.restore is None:
        return
    against = [f"--{name.replace('_', '-')}" for name in said(parser, words, DECIDED)]
    if len(options.files) > len(options.setups):
        against.append(f"the world {options.world}")
    with contextlib.suppress(NomadError):  # whoever reads them for good says what is wrong with them
        if read_setups(options.setups).robot:
            against.append("the robot of a setup file")
    if against:
        parser.error(f"argument --restore: the snapshot has a world, robots, a seed and a setup of its own: leave out "
                     f"{', '.join(against)}")


def keeps_pace(parser: argparse.ArgumentParser, words: Sequence[str]) -> bool:
    """Whether a restored simulation goes on at the pace that it had."""
    return not said(parser, words, PACE)


def said(parser: argparse.ArgumentParser, words: Sequence[str], names: Iterable[str]) -> list[str]:
    """Those of these options that stand in a command line which the parser takes."""
    unsaid = {name: None if parser.get_default(name) is None else _NOT_SAID for name in names}
    read = vars(parser.parse_args(list(words), argparse.Namespace(**unsaid)))
    return [name for name in unsaid if read[name] != unsaid[name]]
