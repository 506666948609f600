"""The file of --save: written at the end, at SIGUSR1, and at intervals of real time (--autosave).

    event loop: simulation to text --> thread: write, flush, rename          the loop does not wait for the disk

An older state never replaces a newer one. A failing disk does not stop the run: the first failure is logged, every
later save is attempted, and the first success is logged again.
"""

import argparse
import asyncio
import contextlib
import itertools
import logging
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from nclient.common.arguments import number
from nclient.errors import SnapshotError
from nserver_emu.persistence import snapshot
from nserver_emu.server.handlers.table import Emulator

log = logging.getLogger(__name__)

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


def check_options(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Exit with a usage error for --autosave without --save."""
    if options.autosave is not None and options.save is None:
        parser.error("--autosave needs a file: add --save FILE")


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
