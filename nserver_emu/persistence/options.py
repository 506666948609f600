"""Rules for options beside --restore and --replay, whose files decide world, robots, seed and setup.

    --restore FILE                  FILE must exist; options that it decides are refused
    --replay FILE                   the same; it decides the snapshot as well, and no file is written
    --save FILE --restore FILE      a persistent run: without FILE it starts as the options say, later FILE decides and
                                    they are ignored

Wrong usage names the options and exits with 2 before anything starts. If any option of the simulation's clock is given,
all of the clock is as the options say; otherwise it is as in the snapshot.
"""

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
"""Options, by their names in the namespace, that a snapshot or a recording decides."""

_WRITES: Final = ("save", "autosave", "record")

CLOCK: Final = ("speed", "paused", "lockstep")
"""Options of the simulation's clock."""

_NOT_GIVEN: Final = "\0not given"


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str]) -> None:
    """Exit with a usage error if an option is given that a snapshot or a recording decides."""
    if options.replay is not None:
        _check_beside(parser, options, words, "replay", "recording", (*DECIDED, "restore"))
        if written := _as_written(given_options(parser, words, _WRITES)):
            parser.error(f"argument --replay: it compares and stops, and writes no file: leave out "
                         f"{', '.join(written)}")
    elif options.restore is not None and not _is_persistent(options):
        _check_beside(parser, options, words, "restore", "snapshot", DECIDED)


def _check_beside(
    parser: argparse.ArgumentParser, options: argparse.Namespace, words: Sequence[str], option: str, file: str,
    decided: Iterable[str],
) -> None:  # fmt: skip
    # Options, worlds and old setup files that the file decides.
    conflicts = _as_written(given_options(parser, words, decided))
    if len(options.files) > len(options.setups):
        conflicts.append(f"the world {options.world}")
    with contextlib.suppress(NomadError):  # reported when the files are read for the simulation
        if read_setups(options.setups).robot:
            conflicts.append("the robot of a setup file")
    if conflicts:
        parser.error(f"argument --{option}: the {file} has a world, robots, a seed and a setup of its own: leave out "
                     f"{', '.join(conflicts)}")


def _as_written(names: Iterable[str]) -> list[str]:
    """Return options as users write them, by their names in the namespace."""
    return [f"--{name.replace('_', '-')}" for name in names]


def resolve_restore(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Decide whether a persistent run starts or continues; if it continues, reset the options that its file decides."""
    # Only a run that is restored from the file it saves to.
    if options.restore is None or not _is_persistent(options):
        return
    if not os.path.lexists(options.restore):
        log.warning("%s: not there yet: the simulation begins, and is saved there", options.restore)
        options.restore = None
        return
    # The file decides: options that say how to start have no effect any more.
    for name in DECIDED:
        setattr(options, name, parser.get_default(name))
    options.world = DEFAULT_WORLD
    log.info("goes on from %s, with the world, the robots, the seed and the setup that are in it", options.restore)


def _is_persistent(options: argparse.Namespace) -> bool:
    """Return True if the file to restore from is also the file to save to."""
    return options.save is not None and options.save.absolute() == options.restore.absolute()


def keeps_pace(parser: argparse.ArgumentParser, words: Sequence[str]) -> bool:
    """Return True if a restored simulation continues with the clock of its snapshot."""
    return not given_options(parser, words, CLOCK)


def given_options(parser: argparse.ArgumentParser, words: Sequence[str], names: Iterable[str]) -> list[str]:
    """Return the options among `names` that a valid command line contains."""
    # Parse again with a sentinel in place of each default: options that keep it were not given.
    defaults = {name: None if parser.get_default(name) is None else _NOT_GIVEN for name in names}
    parsed = vars(parser.parse_args(list(words), argparse.Namespace(**defaults)))
    return [name for name in defaults if parsed[name] != defaults[name]]
