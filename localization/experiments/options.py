"""Options that all commands of the experiments have, and the crew that they ask for."""

from __future__ import annotations

import argparse
import os
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final, TypeVar

from localization.experiments import crew
from localization.experiments.fingerprint import fingerprint

Item = TypeVar("Item")
Result = TypeVar("Result")

NO_PICTURES: Final = "--no-pictures"


def add_shared(parser: argparse.ArgumentParser, out: Path, unit: str) -> None:
    """--seeds, --jobs, --cluster, --out, --json, --no-pictures; `unit` is what one JSON object is about."""
    parser.add_argument("--seeds", type=positive, default=100, metavar="N", help=f"runs a {unit} (default 100)")
    add_work(parser)
    parser.add_argument("--out", type=Path, default=out, metavar="DIR", help=f"for PNG and numbers ({out})")
    parser.add_argument("--json", action="store_true", help=f"print JSON, an object a {unit}, alone on stdout")
    parser.add_argument(
        NO_PICTURES, dest="pictures", action="store_false", help="numbers only; needs no matplotlib"
    )


def add_work(parser: argparse.ArgumentParser) -> None:
    """--jobs, --cluster: who does the work."""
    who = parser.add_mutually_exclusive_group()
    who.add_argument(
        "--jobs", type=positive, default=cores(), metavar="N", help="processes; the numbers are the same (all cores)"
    )
    who.add_argument(
        "--cluster", metavar="ADDRESS", help="work on the Dask cluster whose scheduler is there, host:port (extra "
        "`cluster`); the numbers are the same"
    )


def crew_for(
    work: Callable[[Item], Result], options: argparse.Namespace
) -> Callable[[Sequence[Item]], Iterator[Result]]:
    """Who does this work with items, as the options of `add_work` say."""
    if options.cluster:
        return partial(crew.on_cluster, work, address=options.cluster, code=fingerprint)
    return partial(crew.here, work, jobs=options.jobs)


def positive(text: str) -> int:
    """A whole number of 1 or more."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"a whole number of 1 or more, not {text!r}")
    return int(text)


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
