"""Search for poses in a process of its own, so that no update waits for it.

    robot's process      GlobalLocalizer --start(records)--> BackgroundSearch --queue--> worker
    worker               the range table, from the cache on disk or built once; then search() or alternatives()

The table of a map takes seconds to build and is stored in the user's cache folder by map, ring and sonar model, and
again when a search has computed more of it. In a simulation, whose time waits for its client, `waits` makes every
search answer at once, so that a run can be repeated exactly; on a robot the answer comes some updates later, and the
filter brings it up to date.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import PackageNotFoundError
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from threading import Thread
from typing import Final
from zipfile import BadZipFile

import numpy as np

from localization.filters import compiled, range_table
from localization.filters.base import Filter, LocalizationConfig
from localization.filters.belief import Belief, Floats
from localization.filters.global_localization import is_wide
from localization.filters.pose_search import EchoReplay, PendingSearch, SearchRequest, SearchResult, TableSearch
from localization.filters.range_table import RangeTable
from localization.filters.registry import FINDER, finder, update_for
from worlds.compiled import VARIABLE

CACHE_VERSION: Final = 3
"""Part of the name of every table; a change of the table's content needs another."""
MAX_CACHED: Final = 20
"""Tables kept on disk, the most recently used."""
SAMPLED_PLACES: Final = 48
"""Random places whose echoes stand for those of the whole map in `density`."""
REPORT_INTERVAL_S: Final = 2.0
"""Time between reports of a search that is waited for."""
COMPILED_WALLS: Final = 50
"""From so many walls on the worker compiles the formulas, once on a machine: in the background no update waits for it.
Among 1,285 walls a search takes half a minute in plain Python, and half a second compiled."""
NICENESS: Final = 10
"""The worker yields the processor to the robot's process."""


def cache_folder() -> Path:
    """Return the folder of stored tables: below XDG_CACHE_HOME, or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "nomad-nserver" / "range-tables"


class BackgroundSearch:
    """Search in a worker process, which starts with the first search; see the head of this file.

    Parameters
    ----------
    config
    waits
        True to wait for the answer of every search.
    report
        Called with `progress` every REPORT_INTERVAL_S of such a wait.
    folder
        Folder of stored tables. Default: `cache_folder`.
    """

    def __init__(self, config: LocalizationConfig, *, waits: bool, report: Callable[[str], None] = lambda _: None,
                 folder: Path | None = None) -> None:  # fmt: skip
        self._config, self._waits, self._report, self._folder = config, waits, report, folder or cache_folder()
        self._densities = range_table.reading_densities(
            *range_table.sampled_echoes(config.walls, config.body, config.sonar, config.clearance_in, SAMPLED_PLACES)
        )
        self._pool: ProcessPoolExecutor | None = None
        self._done: Synchronized[float] | None = None

    def close(self) -> None:
        """End the worker process, also in the middle of its work."""
        if self._pool:
            for process in self._pool._processes.values():
                process.terminate()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    @property
    def progress(self) -> str:
        """Fraction of the map that is prepared, in words; "" once it is."""
        done = self._done.value if self._done else 1.0
        return "" if done >= 1.0 else f"preparing the map, {done:.0%}"

    def density(self, reading_in: float) -> float:
        """Return the probability density of a reading from an unknown pose."""
        return float(self._densities[min(max(round(reading_in), 0), len(self._densities) - 1)])

    def prepare(self) -> None:
        """Start the worker and let it read or build the table."""
        if self._pool is None:
            context = multiprocessing.get_context("spawn")
            self._done = context.Value("d", 0.0)
            self._pool = ProcessPoolExecutor(1, context, _prepare, (self._config, self._folder, self._done))
            # Starts the worker; its initializer makes the table.
            self._pool.submit(int)

    def start(self, request: SearchRequest) -> PendingSearch:
        """Begin a search."""
        self.prepare()
        assert self._pool is not None
        future: Future[SearchResult] = self._pool.submit(_search, request)

        def pending() -> SearchResult | None:
            while self._waits:
                with suppress(TimeoutError):
                    return future.result(REPORT_INTERVAL_S)
                self._report(self.progress or "searching")
            return future.result() if future.done() else None

        return pending


def load_or_build(config: LocalizationConfig, folder: Path, progress: Callable[[float], None]) -> RangeTable:
    """Return the range table of a map from the cache, or build and store it; a cache that fails is not used."""
    path = table_path(config, folder)
    with suppress(OSError, ValueError, KeyError, BadZipFile), np.load(path, allow_pickle=False) as stored:
        path.touch()
        cell_in, (origin_in, number, codes, is_known) = float(stored["cell_in"]), (stored[name] for name in _STORED)
        expect = range_table.expectation(origin_in, cell_in, number, config.walls, config.body, config.sonar)
        return RangeTable(origin_in, cell_in, number, codes, is_known, expect)
    table = range_table.build_range_table(config.walls, config.body, config.sonar, config.clearance_in, progress)
    store(table, path)
    return table


def table_path(config: LocalizationConfig, folder: Path) -> Path:
    """Return the file of the table of a map: everything that decides the table is in its name."""
    walls = np.asarray(config.walls, dtype=np.float64)
    parts = (CACHE_VERSION, walls.tobytes(), config.body.sonar_ring_radius_in, config.sonar, config.clearance_in)
    return folder / f"{sha256(repr(parts).encode()).hexdigest()[:32]}.npz"


def store(table: RangeTable, path: Path) -> None:
    """Store a table as a whole, since another process may do the same, and remove the oldest; a failure is ignored."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".part", delete=False) as file:
            np.savez(file, cell_in=table.cell_in, **{name: getattr(table, name) for name in _STORED})
        Path(file.name).replace(path)
        for old in sorted(path.parent.glob("*.npz"), key=lambda table: -table.stat().st_mtime)[MAX_CACHED:]:
            old.unlink()


_STORED: Final = ("origin_in", "number", "codes", "is_known")
"""Arrays of a table."""


def cached_search(config: LocalizationConfig, folder: Path | None = None,
                  progress: Callable[[float], None] = lambda _: None) -> TableSearch:
    """Return a search in this process whose table comes from the cache on disk."""
    folder = folder or cache_folder()
    path = table_path(config, folder)
    return TableSearch(lambda: load_or_build(config, folder, progress),
                       update_for(config.walls, config.body, config.sonar, config.gate), config.odometry,
                       lambda table: store(table, path))


@contextmanager
def filter_on_robot(
    method: str, config: LocalizationConfig, belief: Belief | None, parameter_stds: tuple[float, ...] = (), *,
    waits: bool, report: Callable[[str], None] = lambda _: None, alike: Sequence[Floats] = (),
) -> Iterator[str | Filter]:  # fmt: skip
    """Provide a method for a Localizer: of `finder` the filter with a background search, of others the name.

    Without a belief the search begins at once. See BackgroundSearch for `waits` and `report`,
    and GlobalLocalizer for `alike`.
    """
    if method != FINDER:
        yield method
        return
    # A daemonic process of multiprocessing may have no children: it searches by itself.
    if multiprocessing.current_process().daemon:
        yield finder(config, belief, parameter_stds, alike=alike)
        return
    with closing(BackgroundSearch(config, waits=waits, report=report)) as poses:
        if belief is None or is_wide(belief):
            poses.prepare()
        yield finder(config, belief, parameter_stds, poses, alike)


@dataclass
class _Worker:
    """State of the worker process."""

    search: TableSearch | None = None


_WORKER: Final = _Worker()


def _prepare(config: LocalizationConfig, folder: Path, done: Synchronized[float]) -> None:
    """Make the search of a worker."""
    os.nice(NICENESS)
    # Where SciPy is installed, numba loads all of its linear algebra, 18 MB that no compiled formula calls. Nothing
    # else in this process uses it.
    sys.modules.setdefault("scipy", None)  # type: ignore[arg-type]
    if len(np.asarray(config.walls)) >= COMPILED_WALLS:
        os.environ.setdefault(VARIABLE, "always")
        _compile_apart(config)

    def progress(fraction: float) -> None:
        done.value = min(fraction, 0.999)

    _WORKER.search = cached_search(config, folder, progress)
    assert _WORKER.search.table
    done.value = 1.0


def _compile_apart(config: LocalizationConfig) -> None:
    """Compile the formulas, unless they are on disk, in a process that ends: numba returns none of its 250 MB."""
    direct = update_for(config.walls, config.body, config.sonar, config.gate).direct
    # Without numba there is nothing to compile.
    with suppress(PackageNotFoundError):
        if direct and compiled.is_wanted(direct.update) and not compiled.is_on_disk(direct.update):
            compiler = multiprocessing.get_context("spawn").Process(target=_compile, args=(config,))
            compiler.start()
            compiler.join()


def _compile(config: LocalizationConfig) -> None:
    """Compile the formulas; end with the process that waits for this one."""
    Thread(target=_end_with_parent, daemon=True).start()
    EchoReplay(update_for(config.walls, config.body, config.sonar, config.gate), config.odometry).load()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _search(request: SearchRequest) -> SearchResult:
    assert _WORKER.search is not None
    found = _WORKER.search.start(request)()
    assert found is not None
    return found
