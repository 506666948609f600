"""Rules for options beside --restore and --replay, whose files decide world, robots, seed and setup.

    --restore FILE                  FILE must exist; options that it decides are refused
    --replay FILE                   the same; it decides the snapshot as well, and no file is written
    --save FILE --restore FILE      a persistent run: without FILE it starts as the options say, later FILE decides and
                                    they are ignored

Wrong usage names the options and exits with 2 before anything starts. If any option of the simulation's clock is given,
all of the clock is as the options say; otherwise it is as in the snapshot.

The file of --save: written at the end, at SIGUSR1, and at intervals of real time (--autosave).

    event loop: simulation to text --> thread: write, flush, rename          the loop does not wait for the disk

An older state never replaces a newer one. A failing disk does not stop the run: the first failure is logged, every
later save is attempted, and the first success is logged again.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import logging
import os
import threading
from collections.abc import AsyncIterator, Iterable, Sequence
from pathlib import Path
from typing import Final

from nclient.common.arguments import number
from nclient.errors import NomadError, SnapshotError
from nserver_emu.control import snapshot
from nserver_emu.server.handlers.table import Emulator
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
    if options.autosave is not None and options.save is None:
        parser.error("--autosave needs a file: add --save FILE")
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


MIN_INTERVAL_S, MAX_INTERVAL_S = 1.0, 86_400.0
_ENDING: Final = "saving"
"""Ending of the temporary file."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add --save and --autosave."""
    parser.add_argument("--save", type=Path, metavar="FILE",
                        help="save the simulation to FILE at the end and at SIGUSR1")
    interval = number(f"seconds from {MIN_INTERVAL_S:g} to {MAX_INTERVAL_S:g}", MIN_INTERVAL_S, MAX_INTERVAL_S)
    parser.add_argument("--autosave", type=interval, metavar="SECONDS",
                        help="also save at this interval of real time, so that --restore can continue a killed run")


class SaveFile:
    """A file to which the state of an emulator is saved repeatedly."""

    def __init__(self, emulator: Emulator, path: Path) -> None:
        self._emulator, self._path = emulator, path
        self._numbers = itertools.count(1)
        self._written = 0
        self._lock = threading.Lock()
        self._failing = False

    def save(self) -> None:
        """Save the current state. Raises SnapshotError if the file cannot be written."""
        self._write(next(self._numbers), snapshot.dumps(self._emulator))

    async def save_in_thread(self) -> None:
        """Save the current state without blocking the event loop; log failures."""
        number, text = next(self._numbers), snapshot.dumps(self._emulator)
        try:
            await asyncio.to_thread(self._write, number, text)
        except SnapshotError as error:
            # Only the first failure of a series is logged.
            if not self._failing:
                log.error("not saved: %s; the run goes on, and it is tried again each time", error)
            self._failing = True
        else:
            if self._failing:
                log.warning("%s: saved again", self._path)
            self._failing = False

    def _write(self, number: int, text: str) -> None:
        # Threads may finish in another order than they were started.
        with self._lock:
            if number > self._written:
                snapshot.write(text, self._path, _ENDING)
                self._written = number


@contextlib.asynccontextmanager
async def autosaved(file: SaveFile | None, interval_s: float | None) -> AsyncIterator[None]:
    """Save at an interval while the context is open; without a file or an interval, do nothing."""
    # Cancelled at the end: the final save is the caller's.
    saving = asyncio.create_task(_save_repeatedly(file, interval_s)) if file and interval_s else None
    try:
        yield
    finally:
        if saving is not None:
            saving.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await saving


async def _save_repeatedly(file: SaveFile, interval_s: float) -> None:
    while True:
        await asyncio.sleep(interval_s)
        await file.save_in_thread()
