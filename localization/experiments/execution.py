"""Running experiments: in this process, in several processes, or on a Dask cluster; progress bar; cached results.

Work is a pure function of an item, both importable on the other side, so the numbers are the same wherever it runs.
Results arrive in any order. Local workers are forked from a process without threads that has imported what they need
(`preloaded`), so that this takes its second once.

The options shared by all experiments are here as well.
"""

from __future__ import annotations

import argparse
import json
import math
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed, wait
from contextlib import contextmanager
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Generic, TypeVar

import numpy as np

from localization.experiments import figure_trial
from localization.experiments.figure_trial import Figure, FigureResult, join_results, run, run_compiled
from nclient.common.arguments import Parser, add_flag, add_value, whole_number
from nclient.common.files import write_atomic
from nclient.errors import ExtraMissing, NomadError, OutputFileError, install_command
from worlds.compiled import is_compiled_for

if TYPE_CHECKING:
    from multiprocessing.context import BaseContext
    from multiprocessing.sharedctypes import Synchronized

Item = TypeVar("Item")
Result = TypeVar("Result")

CONNECT_TIMEOUT_S: Final = 10
"""Timeout of the connection to a cluster."""


class ClusterExtraMissing(ExtraMissing):
    """Dask distributed is required and not installed; the message names the extra."""


class ClusterError(NomadError, RuntimeError):
    """A cluster that is unreachable, has no workers, or has other code than this process."""


def run_locally(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
    """Yield results of work on this machine with `jobs` processes; with one job in this process."""
    # In this process: no start of workers, and tracebacks stay readable.
    if jobs == 1 or len(items) <= 1:
        yield from map(work, items)
        return
    with ProcessPoolExecutor(min(jobs, len(items)), _worker_context()) as workers:
        yield from _completed(workers, work, items)


def _completed(workers: Executor, work: Callable[[Item], Result], items: Sequence[Item]) -> Iterator[Result]:
    """Yield results as they arrive; after an error or Ctrl-C the items that wait are cancelled."""
    futures = [workers.submit(work, item) for item in items]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        workers.shutdown(wait=True, cancel_futures=True)


def _worker_context() -> BaseContext:
    """Return the way to start workers; where there is no fork server each imports what it needs."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["localization.experiments.preloaded"])
    return context


def on_cluster(work: Callable[[Item], Result], items: Sequence[Item], address: str,
               code: Callable[[], object]) -> Iterator[Result]:
    """Yield results of work on a Dask cluster.

    Parameters
    ----------
    work : callable
    items : sequence
    address : str
        Scheduler, host:port.
    code : callable
        Returns a hash of the code that a process would run, which must be the same on all workers.

    Raises
    ------
    ClusterExtraMissing, ClusterError
    """
    try:
        # Imported here because Dask is optional.
        from distributed import Client, as_completed
    except ImportError as error:
        message = f"a cluster needs Dask distributed: {install_command('cluster')}; or use --jobs"
        raise ClusterExtraMissing(message) from error
    try:
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, ValueError) as error:
        raise ClusterError(f"no Dask scheduler answers at {address}: {error}") from error
    with client:
        # Other code would give other numbers without any error, so it is checked first.
        _check_workers(client.run(code), address, code())
        # pure=False: equal items are run again, not taken from the cluster's memory.
        futures = client.map(work, items, pure=False)
        for _, result in as_completed(futures, with_results=True):
            yield result


def _check_workers(codes: Mapping[str, object], address: str, own: object) -> None:
    """Raise ClusterError unless there are workers and all have the same code as this process."""
    if not codes:
        raise ClusterError(f"the scheduler at {address} has no workers: start some with `dask worker {address}`")
    others = sorted(worker for worker, theirs in codes.items() if theirs != own)
    if others:
        raise ClusterError(f"different code, numpy or numba on {', '.join(others)}: install the same versions there")


Tally = Callable[[int], None]
"""Called with the amount of work done so far."""


@contextmanager
def progress(total: int, title: str, unit: str) -> Iterator[Tally]:
    """Show a progress bar from 0 to `total` on stderr; show nothing there without tqdm or a terminal."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield lambda _: None
        return
    with tqdm(total=total, desc=title, unit=f" {unit}", unit_scale=True, disable=None) as bar:

        def advance(done: int) -> None:
            # tqdm takes increments, and the amount of work is an estimate that may be exceeded.
            bar.update(min(done, total) - bar.n)

        yield advance


class ResultCache(Generic[Item, Result]):
    """Results of runs on disk, one JSON file each, computed by code with a given hash.

    A file is named by a digest of everything that decides its numbers, including the code's hash, so that no outdated
    result is read.

    Parameters
    ----------
    folder : Path
    code : str
        Hash of the code, see `code_hash`.
    result : type
        Dataclass of a result.
    key : callable
        Returns for a run the beginning of its file name, and a value whose repr contains everything that decides its
        numbers.
    """

    def __init__(self, folder: Path, code: str, result: Callable[..., Result],
                 key: Callable[[Item], tuple[str, object]]) -> None:
        self._folder, self._code, self._result, self._key = folder, code, result, key

    def path(self, item: Item) -> Path:
        """Return the path of a run's result."""
        # 64 bits of the digest make file names short and collisions practically impossible.
        name, decided_by = self._key(item)
        return self._folder / f"{name}_{sha256(repr((self._code, decided_by)).encode()).hexdigest()[:16]}.json"

    def get(self, item: Item) -> Result | None:
        """Return the cached result of a run, None if there is none."""
        try:
            return self._result(**json.loads(self.path(item).read_text(encoding="utf-8")))
        except FileNotFoundError:
            return None

    def put(self, item: Item, result: Result) -> None:
        """Store a result; the file is written as a whole. Raises OutputFileError."""
        self._folder.mkdir(parents=True, exist_ok=True)
        write_atomic(self.path(item), json.dumps(asdict(result)) + "\n", OutputFileError)  # type: ignore[call-overload]


def run_cached(items: Sequence[Item], cache: ResultCache[Item, Result],
               work: Callable[[Sequence[Item]], Iterator[tuple[Item, Result]]], tally: Tally,
               is_current: Callable[[Item], bool] = lambda _: True) -> dict[Item, Result]:  # fmt: skip
    """Return the results of all runs in order, from the cache (if `is_current`) or by `work`; store each at once."""
    cached = {item: result for item in items if (result := cache.get(item)) is not None and is_current(item)}
    results = dict(cached)
    tally(len(results))
    for item, result in work([item for item in items if item not in cached]):
        cache.put(item, result)
        results[item] = result
        tally(len(results))
    # Results arrive in any order; summaries need that of the runs.
    return {item: results[item] for item in items}


CODE: Final = ("localization", "nclient", "nserver_emu", "worlds")
"""Packages that decide the results of experiments."""
SUFFIXES: Final = (".py", ".toml")


def code_hash() -> str:
    """Return a digest of the project's code and worlds and of numpy's version."""
    # numpy's version is included: other versions may round differently.
    digest = sha256(np.__version__.encode())
    # Sorted, because the order of files in a folder differs between file systems.
    for name, content in sorted(_sources().items()):
        digest.update(f"{name}\0{sha256(content).hexdigest()}\n".encode())
    return digest.hexdigest()


def _sources() -> dict[str, bytes]:
    """Return the content of all source files by name."""
    return {
        f"{package}/{path.relative_to(folder).as_posix()}": path.read_bytes()
        for package in CODE
        for folder in map(Path, import_module(package).__path__)
        for path in folder.rglob("*")
        if path.suffix in SUFFIXES
    }


_MAX_BATCH: Final = 125
"""Seeds per batch: larger batches are not faster and need about 0.5 MB per seed."""

_COMPILED_BATCH: Final = 10
"""Seeds per batch of a thread: their histories stay near the processor, and the progress bar moves."""

_CLUSTER_BATCH: Final = 25
"""Seeds per batch on a cluster: a few seconds of work, so that the slowest worker delays little."""

_MIN_BATCH: Final = 8
"""Seeds per batch at least: a step of all takes as long as one of a single robot, most of it for the calls of numpy."""

# Interval at which the parent reads the workers' counter for its progress bar.
_POLL_INTERVAL_S: Final = 0.2


class _StepCounter:
    """Step counter shared by a worker process with its parent; set when the worker starts."""

    steps: ClassVar[Synchronized[int] | None] = None


def split_seeds(seeds: Sequence[int], jobs: int) -> list[Sequence[int]]:
    """Return the seeds in batches of equal size: one per job, within _MIN_BATCH and _MAX_BATCH."""
    used = max(1, min(jobs, len(seeds) // _MIN_BATCH))
    size = max(1, min(_MAX_BATCH, math.ceil(len(seeds) / used)))
    return [seeds[first : first + size] for first in range(0, len(seeds), size)]


def drive_batch(figure: Figure, seeds: Sequence[int], tick: Tally = lambda _: None, *,
                is_compiled: bool = False) -> FigureResult:
    """Simulate a figure once per seed and return what summary and pictures need.

    `tick` is called with the steps done: after each step, in machine code at the end.
    """
    setup = figure_trial.figure_setup(figure)
    if not is_compiled:
        return figure_trial.figure_result(run(setup, seeds, tick), figure.filtered)
    runs = run_compiled(setup, seeds)
    tick(int(runs.steps.sum()))
    return figure_trial.figure_result(runs, figure.filtered)


def _is_compiled(figure: Figure, seeds: Sequence[int]) -> bool:
    """Return True if steps are taken in machine code: decided for all parts of the work, so that results agree."""
    return figure.filtered and is_compiled_for(len(seeds)) and find_spec("numba") is not None


def drive(figure: Figure, seeds: Sequence[int], jobs: int, report: Tally = lambda _: None) -> FigureResult:
    """Drive a figure with all seeds, in `jobs` processes, or threads of machine code; one job stays in this process."""
    tick = _counting(report)
    # 1. Machine code, which releases the interpreter lock.
    if _is_compiled(figure, seeds):
        return _drive_compiled(figure, seeds, jobs, tick)
    # 2. One batch after another in this process.
    parts = split_seeds(seeds, jobs)
    if len(parts) == 1 or jobs == 1:
        return join_results([drive_batch(figure, part, tick) for part in parts])
    # 3. Batches in workers, which count their steps in shared memory.
    context = _worker_context()
    counter = context.Value("q", 0)
    with ProcessPoolExecutor(min(jobs, len(parts)), context, _set_counter, (counter,)) as workers:
        futures = [workers.submit(drive_batch, figure, part, _count_steps) for part in parts]
        # 4. Show their progress until all are done; the results are joined in the order of the seeds.
        waiting = set(futures)
        while waiting:
            waiting = wait(waiting, timeout=_POLL_INTERVAL_S).not_done
            report(counter.value)
        return join_results([future.result() for future in futures])


def _drive_compiled(figure: Figure, seeds: Sequence[int], jobs: int, tick: Tally) -> FigureResult:
    """Drive a figure with all seeds in machine code, in `jobs` threads."""
    parts = [seeds[first : first + _COMPILED_BATCH] for first in range(0, len(seeds), _COMPILED_BATCH)]
    with ThreadPoolExecutor(min(jobs, len(parts))) as workers:
        return _joined(_completed(workers, partial(drive_batch, figure, is_compiled=True), parts), tick)


def _joined(parts: Iterable[FigureResult], tick: Tally) -> FigureResult:
    """Return the results of batches, which arrive in any order, in the order of the seeds."""
    done = []
    for part in parts:
        done.append(part)
        tick(sum(result.steps for result in part.results))
    return join_results(sorted(done, key=lambda part: part.results[0].seed))


def drive_on_cluster(figure: Figure, seeds: Sequence[int], address: str,
                     report: Tally = lambda _: None) -> FigureResult:
    """Drive a figure with all seeds on a Dask cluster, in parts of equal length."""
    is_compiled = _is_compiled(figure, seeds)
    parts = [seeds[first : first + _CLUSTER_BATCH] for first in range(0, len(seeds), _CLUSTER_BATCH)]
    work = partial(drive_batch, figure, is_compiled=is_compiled)
    results = on_cluster(work, parts, address, _compiled_code if is_compiled else code_hash)
    return _joined(results, _counting(report))


def _compiled_code() -> tuple[str, bool]:
    """Return what workers must have in common to take steps in machine code: the code, and numba."""
    return code_hash(), find_spec("numba") is not None


def _counting(report: Tally) -> Tally:
    """Return a tick that reports the sum of its arguments."""
    done = 0

    def tick(steps: int) -> None:
        nonlocal done
        done += steps
        report(done)

    return tick


def _set_counter(counter: Synchronized[int]) -> None:
    _StepCounter.steps = counter


def _count_steps(steps: int) -> None:
    """Count steps of a worker for its parent."""
    if _StepCounter.steps is not None:
        with _StepCounter.steps.get_lock():
            _StepCounter.steps.value += steps


Column = tuple[str, str, str]
"""Title, key and format of a column of numbers."""


def text_table(lines: Sequence[Sequence[str]]) -> str:
    """Return lines of cells as text, right-aligned, each column as wide as its widest cell."""
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join("  ".join(map(str.rjust, line, widths)) for line in lines)


def table_of(names: Mapping[str, str], columns: Iterable[Column], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return rows as a text table: first the columns of `names` (title: key), then numbers; "-" for None."""
    columns = list(columns)
    lines = [[*names, *(title for title, _, _ in columns)]]
    for row in rows:
        numbers = ["-" if row[key] is None else format(row[key], form) for _, key, form in columns]
        lines.append([*(str(row[key]) for key in names.values()), *numbers])
    return text_table(lines)


def write_results(options: argparse.Namespace, name: str, values: Sequence[object], text: str,
                  more: object = None) -> None:
    """Write values, or `more`, to a JSON file in the folder of --out; print the values as text, or as JSON for --json.

    Other words go to stderr with --json.
    """
    written = options.out / name
    written.write_text(json.dumps(more or values, indent=1) + "\n", encoding="utf-8")
    print(json.dumps(values) if options.json else text, flush=True)
    print(f"written: {written}", file=sys.stderr if options.json else sys.stdout, flush=True)


def parser_of(command: str, example: str, description: str) -> Parser:
    """Return the parser of a command; `example` has some of its arguments."""
    prog = f"python -m localization.experiments {command}"
    return Parser(prog=prog, description=description, epilog=f"example: {prog} {example}")


NO_PICTURES: Final = "--no-pictures"


def add_shared(parser: argparse.ArgumentParser, out: Path, unit: str) -> None:
    """Add --seeds, --jobs, --cluster, --out, --json, --no-pictures; `unit` names the subject of one JSON object."""
    add_value(parser, "--seeds", "N", positive, f"number of runs per {unit} (default: 100)", 100)
    add_execution_options(parser)
    add_output(parser, out, unit)
    parser.add_argument(NO_PICTURES, dest="pictures", action="store_false",
                        help="write no pictures; matplotlib is not needed")


def add_output(parser: argparse.ArgumentParser, out: Path, unit: str) -> None:
    """Add --out and --json; `unit` names the subject of one JSON object."""
    add_value(parser, "--out", "DIR", Path, "write results to this folder", out)
    add_flag(parser, "--json", f"print only JSON on stdout, one object per {unit}")


def add_choice(parser: argparse.ArgumentParser, option: str, names: Iterable[str], default: object, what: str) -> None:
    """Add an option that takes one of `names`, or several if its default is a list."""
    names = list(names)
    shown = "all" if default == names else " ".join(default) if isinstance(default, list) else default
    choices = ", ".join(names).replace("%", "%%")
    parser.add_argument(option, nargs="+" if isinstance(default, list) else None, choices=names, default=default,
                        metavar="NAME", help=f"{what}: {choices} (default: {shown})")  # fmt: skip


def add_execution_options(parser: argparse.ArgumentParser) -> None:
    """Add --jobs and --cluster."""
    group = parser.add_mutually_exclusive_group()
    add_value(group, "--jobs", "N", positive,
              "run this number of processes; the results do not depend on it (default: all cores)", cores())
    group.add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="run on the Dask cluster with this scheduler, host:port (extra `cluster`); the results are the same",
    )


def executor_for(work: Callable[[Item], Result],
                 options: argparse.Namespace) -> Callable[[Sequence[Item]], Iterator[Result]]:
    """Return the executor of work selected by the options of `add_execution_options`."""
    if options.cluster:
        return partial(on_cluster, work, address=options.cluster, code=code_hash)
    return partial(run_locally, work, jobs=options.jobs)


positive: Final = whole_number("the number", 1)


def cores() -> int:
    """Return the number of cores this process may use."""
    # Not on macOS and Windows. A process may be restricted to fewer cores than the machine has.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
