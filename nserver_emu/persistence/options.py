"""Options beside --restore and --replay: what a file decides cannot be said again; beside a snapshot the pace can.

    --restore FILE                  FILE is there, or it is an error; it decides world, robots, seed and setup
    --replay FILE                   the same; it decides what snapshot it began with, too, and leaves no file behind
    --save FILE --restore FILE      a run that is kept: the first time there is no FILE, and it begins as the options
                                    say; from then on FILE decides, and they are passed over

Rules: wrong usage names the options and ends with 2, before anything starts. Said at all, an option of the pace has
the whole pace begin as the options say; else it goes on as the snapshot has it.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
from collections.abc import Iterable, Sequence
from typing import Final

from nclient.errors import NomadError
from nserver_emu.server.legacy_setup import read_setups
from worlds.io import DEFAULT_WORLD

log = logging.getLogger(__name__)

DECIDED: Final = ("robot", "robots", "model_file", "start", "seed", "setup", "noisy")
"""Options, by their names in the namespace, that a snapshot or a recording has decided."""
_WRITES: Final = ("save", "autosave", "record")

PACE: Final = ("speed", "paused", "lockstep")

_NOT_SAID: Final = "\0not said"


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str]) -> None:
    """Wrong usage where something is said that a snapshot or a recording decides. Does not come back then."""
    if options.replay is not None:
        _refuse_beside(parser, options, words, "replay", "recording", (*DECIDED, "restore"))
        if written := _long(said(parser, words, _WRITES)):
            parser.error(f"argument --replay: it compares and stops, and writes no file: leave out "
                         f"{', '.join(written)}")
    elif options.restore is not None and not _is_kept(options):
        _refuse_beside(parser, options, words, "restore", "snapshot", DECIDED)


def _refuse_beside(
    parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str], option: str, file: str,
    decided: Iterable[str],
) -> None:
    against = _long(said(parser, words, decided))
    if len(options.files) > len(options.setups):
        against.append(f"the world {options.world}")
    with contextlib.suppress(NomadError):  # whoever reads them for good says what is wrong with them
        if read_setups(options.setups).robot:
            against.append("the robot of a setup file")
    if against:
        parser.error(f"argument --{option}: the {file} has a world, robots, a seed and a setup of its own: leave out "
                     f"{', '.join(against)}")


def _long(names: Iterable[str]) -> list[str]:
    """Options as they are written, by their names in the namespace."""
    return [f"--{name.replace('_', '-')}" for name in names]


def settle(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Of a run that is kept: whether it begins, or goes on and what says how to begin counts no more."""
    if options.restore is None or not _is_kept(options):
        return
    if not os.path.lexists(options.restore):
        log.warning("%s: not there yet: the simulation begins, and is saved there", options.restore)
        options.restore = None
        return
    for name in DECIDED:
        setattr(options, name, parser.get_default(name))
    options.world = DEFAULT_WORLD
    log.info("goes on from %s, with the world, the robots, the seed and the setup that are in it", options.restore)


def _is_kept(options: argparse.Namespace) -> bool:
    """Whether what is restored is also where it is saved."""
    return options.save is not None and options.save.absolute() == options.restore.absolute()


def keeps_pace(parser: argparse.ArgumentParser, words: Sequence[str]) -> bool:
    """Whether a restored simulation goes on at the pace that it had."""
    return not said(parser, words, PACE)


def said(parser: argparse.ArgumentParser, words: Sequence[str], names: Iterable[str]) -> list[str]:
    """Those of these options that stand in a command line which the parser takes."""
    unsaid = {name: None if parser.get_default(name) is None else _NOT_SAID for name in names}
    read = vars(parser.parse_args(list(words), argparse.Namespace(**unsaid)))
    return [name for name in unsaid if read[name] != unsaid[name]]
