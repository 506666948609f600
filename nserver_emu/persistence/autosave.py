"""The file of --save: written at the end, at SIGUSR1, and every so many seconds of real time (--autosave).

    loop: the simulation as text ──> thread: file, disk, name          the loop does not wait for a disk

Rules: an older state never takes the place of a newer one. A disk that refuses costs nobody his robot: it is said once,
with the remedy, tried again each time, and said when it works again.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import itertools
import logging
import threading
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from nclient.errors import SnapshotError
from nserver_emu.persistence import snapshot
from nserver_emu.server.handlers.table import Emulator

log = logging.getLogger(__name__)

LEAST_S, MOST_S = 1.0, 86_400.0
_ENDING: Final = "saving"


def add_options(parser: argparse.ArgumentParser) -> None:
    """--save, --autosave."""
    parser.add_argument("--save", type=Path, metavar="FILE", help="save the simulation at the end and at SIGUSR1")
    parser.add_argument("--autosave", type=_seconds, metavar="SECONDS",
                        help="and every so many seconds of real time: what was killed goes on from there by --restore")


def refuse(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Wrong usage that only both together show."""
    if options.autosave is not None and options.save is None:
        parser.error("--autosave needs a file: add --save FILE")


class SaveFile:
    """See the head of this file."""

    def __init__(self, emulator: Emulator, path: Path) -> None:
        self._emulator, self._path = emulator, path
        self._numbers = itertools.count(1)
        self._written = 0
        self._lock = threading.Lock()
        self._failing = False

    def save(self) -> None:
        """Now. Raises SnapshotError where it cannot be written."""
        self._write(next(self._numbers), snapshot.dumps(self._emulator))

    async def save_aside(self) -> None:
        """The state of now, while the loop goes on; what goes wrong is logged."""
        number, text = next(self._numbers), snapshot.dumps(self._emulator)
        try:
            await asyncio.to_thread(self._write, number, text)
        except SnapshotError as error:
            if not self._failing:
                log.error("not saved: %s; the run goes on, and it is tried again each time", error)
            self._failing = True
        else:
            if self._failing:
                log.warning("%s: saved again", self._path)
            self._failing = False

    def _write(self, number: int, text: str) -> None:
        with self._lock:
            if number > self._written:
                snapshot.write(text, self._path, _ENDING)
                self._written = number


@contextlib.asynccontextmanager
async def autosaved(file: SaveFile | None, every_s: float | None) -> AsyncIterator[None]:
    """Save every so many seconds while it lasts; None: not."""
    saving = asyncio.create_task(_save_again_and_again(file, every_s)) if file and every_s else None
    try:
        yield
    finally:
        if saving is not None:
            saving.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await saving


async def _save_again_and_again(file: SaveFile, every_s: float) -> None:
    while True:
        await asyncio.sleep(every_s)
        await file.save_aside()


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not LEAST_S <= seconds <= MOST_S:
        raise argparse.ArgumentTypeError(f"seconds from {LEAST_S:g} to {MOST_S:g}, not {text!r}")
    return seconds
