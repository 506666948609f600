"""Who does the work: this process, processes beside it, or the workers of a Dask cluster. The work is the same.

Rules: knows processes and nothing of filters. Work is a pure function of an item, both found by import on the other
side; results come as they are done, in any order, so an item must be found in its result. Local workers are spawned,
not forked: a fork would copy a process that has threads (the progress bar's).
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Final, TypeVar

from nclient.errors import ExtraMissing, NomadError

Item = TypeVar("Item")
Result = TypeVar("Result")

PATIENCE_S: Final = 10
"""How long a cluster may take to answer at first."""


class ClusterExtraMissing(ExtraMissing):
    """A cluster was asked for and distributed is not installed; the message names the extra."""


class ClusterError(NomadError, RuntimeError):
    """A cluster that cannot do the work: not there, without workers, or with other code than this process."""


def here(work: Callable[[Item], Result], items: Sequence[Item], jobs: int) -> Iterator[Result]:
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
