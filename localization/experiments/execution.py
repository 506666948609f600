"""Who does the work: this process, processes beside it, or the workers of a Dask cluster. The work is the same.

Rules: knows processes and nothing of filters. Work is a pure function of an item, both found by import on the other
side; results come as they are done, in any order, so an item must be found in its result. Local workers are spawned,
not forked: a fork would copy a process that has threads (the progress bar's).

A progress bar on stderr, where tqdm (extra `plot`) is there to draw it.

Rules: nothing is worked out here; who works tells how much is done so far.

Results on disk, a JSON file each: what is there already is not worked out again.

A file is named by a digest of all that decides its numbers, the code's fingerprint among it: nothing stale is ever
read, and a change leaves old files alone. Rules: files only. A file is whole: one cut short is never taken for a
result.

What this process would run: so that numbers kept or made elsewhere are known to be the ones it would make itself.

Rules: reads the files of the packages, imports none of them.

The seeds of a figure shared out among processes.

Rules: knows processes and nothing of filters; a part of the work is a pure function of figure and seeds (`drive_part`),
so that any number of processes, here or elsewhere, gives the same numbers. Workers are spawned, not forked: a
fork would copy a process that has threads (the progress bar's).
"""

from __future__ import annotations

import json
import math
import multiprocessing
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed, wait
from contextlib import contextmanager
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, TypeVar

import numpy as np

from localization.experiments.figure_trial import Figure, figure_setup, run
from localization.experiments.results import FigureResult, figure_result, join_results
from nclient.common.files import write_atomic
from nclient.errors import ExtraMissing, NomadError, OutputFileError

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE_S: Final = 10
"""How long a cluster may take to answer at first."""


class ClusterExtraMissing(ExtraMissing):
    """A cluster was asked for and distributed is not installed; the message names the extra."""


class ClusterError(NomadError, RuntimeError):
    """A cluster that cannot do the work: not there, without workers, or with other code than this process."""


def run_locally(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """On this machine, so many processes at a time; one job stays in this process."""
    if jobs == 1 or len(items) <= 1:
        yield from map(work, items)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(items)), context) as workers:
        futures = [workers.submit(work, item) for item in items]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            workers.shutdown(wait=True, cancel_futures=True)


def on_cluster(
    work: Callable[[Item], Result], items: Sequence[Item], address: str, code: Callable[[], object]
) -> Iterator[Result]:
    """On the workers of the Dask scheduler at an address (host:port). `code` tells what a process would run: it must be
    the same everywhere. Raises ClusterExtraMissing, ClusterError."""
    try:
        from distributed import Client, as_completed
    except ImportError as error:
        message = "a cluster needs Dask distributed: pip install 'nomad-nserver[cluster]', or work here with --jobs"
        raise ClusterExtraMissing(message) from error
    try:
        client = Client(address, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        _check(client.run(code), address, code())
        futures = client.map(work, items, pure=False)
        for _, result in as_completed(futures, with_results=True):
            yield result


def _check(codes: Mapping[str, object], address: str, mine: object) -> None:
    """Whether there are workers, and all would run what this process would."""
    if not codes:
        raise ClusterError(f"the scheduler at {address} has no workers: start some with `dask worker {address}`")
    others = sorted(worker for worker, theirs in codes.items() if theirs != mine)
    if others:
        raise ClusterError(f"other code or another numpy than here on {', '.join(others)}: install the same there")


Tally = Callable[[int], None]
"""Told how much is done so far."""


@contextmanager
def progress(total: int, title: str, unit: str) -> Iterator[Tally]:
    """A bar from nothing to `total`; nothing where tqdm is missing."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda _: None
        return
    with tqdm(total=total, desc=title, unit=f" {unit}", unit_scale=True, file=sys.stderr) as bar:

        def advance(done: int) -> None:
            bar.update(min(done, total) - bar.n)

        yield advance


class ResultCache:
    """A folder of results that code of that fingerprint made."""

    def __init__(self, folder: Path, code: str) -> None:
        self._folder, self._code = folder, code

    def path(self, name: str, decided_by: tuple[object, ...]) -> Path:
        """Where the result of that name is kept; `decided_by`: what decides its numbers, told by its repr."""
        key = sha256(repr((self._code, *decided_by)).encode())
        return self._folder / f"{name}_{key.hexdigest()[:16]}.json"

    @staticmethod
    def get(path: Path) -> dict[str, Any] | None:
        """What is kept there, None where nothing is."""
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        found: dict[str, Any] = json.loads(text)
        return found

    def put(self, path: Path, result: Mapping[str, Any]) -> None:
        """Keep a result there. Raises OutputFileError where that cannot be."""
        self._folder.mkdir(parents=True, exist_ok=True)
        write_atomic(path, json.dumps(result) + "\n", OutputFileError)


CODE: Final = ("localization", "nclient", "nserver_emu", "worlds")
"""The packages an experiment runs through."""
SUFFIXES: Final = (".py", ".toml")


def code_hash() -> str:
    """What this process would run: a digest of the project's code and worlds, and of numpy's version."""
    digest = sha256(np.__version__.encode())
    for name, content in sorted(_sources().items()):
        digest.update(f"{name}\0{sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def _sources() -> dict[str, bytes]:
    """Every file of the packages, by its name in them."""
    return {
        f"{package}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for package in CODE
        for folder in _folders(package)
        for path in folder.rglob("*")
        if path.suffix in SUFFIXES
    }


def _folders(package: str) -> Iterator[Path]:
    spec = find_spec(package)
    assert spec is not None
    return map(Path, spec.submodule_search_locations or ())


if TYPE_CHECKING:
    from multiprocessing.sharedctypes import Synchronized

_LARGEST_PART: Final = 125
"""Seeds at once: larger batches save nothing and keep some 0.5 MB a seed."""

_CLUSTER_PART: Final = 25
"""Seeds at once on a cluster: some seconds of work, so that none waits long for the slowest."""

_LOOK_EVERY_S: Final = 0.2


class _Odometer:
    """The steps this worker process shares with its parent; set when the worker starts."""

    steps: ClassVar[Synchronized[int] | None] = None


def parts_of(seeds: Sequence[int], jobs: int) -> list[Sequence[int]]:
    """The seeds cut into runs of equal length: one for each job, or more where that is beyond the largest part."""
    size = max(1, min(_LARGEST_PART, math.ceil(len(seeds) / jobs)))
    return [seeds[first : first + size] for first in range(0, len(seeds), size)]


def drive_part(figure: Figure, seeds: Sequence[int], tick: Tally = lambda _: None) -> FigureResult:
    """Drive a figure once with each seed and keep what the summary and the pictures need; `tick` per step."""
    return figure_result(run(figure_setup(figure), seeds, tick), figure.filtered)


def drive(figure: Figure, seeds: Sequence[int], jobs: int, report: Tally = lambda _: None) -> FigureResult:
    """Drive a figure with all seeds, `jobs` processes at a time; one job stays in this process."""
    parts = parts_of(seeds, jobs)
    if len(parts) == 1 or jobs == 1:
        tick = _counting(report)
        return join_results([drive_part(figure, part, tick) for part in parts])
    context = multiprocessing.get_context("spawn")
    odometer = context.Value("q", 0)
    with ProcessPoolExecutor(min(jobs, len(parts)), context, _adopt, (odometer,)) as workers:
        futures = [workers.submit(_drive_part_counting, figure, part) for part in parts]
        waiting = set(futures)
        while waiting:
            waiting = wait(waiting, timeout=_LOOK_EVERY_S).not_done
            report(odometer.value)
        return join_results([future.result() for future in futures])


def drive_on_cluster(
    figure: Figure, seeds: Sequence[int], address: str, report: Tally = lambda _: None
) -> FigureResult:
    """Drive a figure with all seeds on a Dask cluster, in parts of equal length."""
    items = [(figure, seeds[first : first + _CLUSTER_PART]) for first in range(0, len(seeds), _CLUSTER_PART)]
    parts = []
    tick = _counting(report)
    for part in on_cluster(_drive_item, items, address, code_hash):
        parts.append(part)
        tick(sum(result.steps for result in part.results))
    return join_results(sorted(parts, key=lambda part: part.results[0].seed))


def _drive_item(item: tuple[Figure, Sequence[int]]) -> FigureResult:
    return drive_part(*item)


def _counting(report: Tally) -> Tally:
    """A tick that adds up and reports the sum."""
    done = 0

    def tick(steps: int) -> None:
        nonlocal done
        done += steps
        report(done)

    return tick


def _adopt(odometer: Synchronized[int]) -> None:
    _Odometer.steps = odometer


def _drive_part_counting(figure: Figure, seeds: Sequence[int]) -> FigureResult:
    """In a worker: as `drive_part`, telling the parent about the steps."""
    return drive_part(figure, seeds, _tell_parent)


def _tell_parent(steps: int) -> None:
    if _Odometer.steps is not None:
        with _Odometer.steps.get_lock():
            _Odometer.steps.value += steps
