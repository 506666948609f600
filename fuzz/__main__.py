"""Fuzz all readers, or those named. See docs/fuzzing.md.

The packages are imported once, under atheris's instrumentation; each reader then runs in forked processes. The exit
code is 1 if an input was a finding or memory grew.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

if TYPE_CHECKING:
    from fuzz.reader import Reader
    from fuzz.runner import Status

PACKAGES: Final = ("nclient", "nserver_emu", "localization", "worlds")
RUNS: Final = 10_000_000
MAX_GROWTH_KB: Final = 100_000
"""Tables of libFuzzer take some ten thousand."""
MAX_GROWTH_OBJECTS: Final = 20_000
"""A leak of a tenth of an object per input would be a hundred times as many in a long run."""
_MAX_SHOWN: Final = 2000
"""Bytes of a finding in the report: enough to reproduce it if only the report is left."""
_MIN_S: Final = 0.2
_OK, _FOUND, _USAGE, _INTERRUPTED = 0, 1, 2, 130


class Limits(NamedTuple):
    """Limits of the run of one reader, its corpus, and whether coverage guides it."""

    runs: float
    seconds: float
    corpus: Path
    is_guided: bool


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    readers = _load_readers(instrumented=not (options.again or options.list or options.blind))
    for name in options.readers:
        if name not in readers:
            parser.error(f"unknown reader {name!r}; choose from {', '.join(readers)}")
    if options.list:
        for reader in readers.values():
            print(f"{reader.name:16}  {reader.description}")
        return _OK
    if options.again:
        return _run_again(readers, options.again)
    chosen = [readers[name] for name in options.readers or readers]
    runs, seconds = (options.runs, float("inf")) if options.seconds is None else (float("inf"), options.seconds)
    limits = Limits(runs, seconds / len(chosen), options.corpus, not options.blind)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return _FOUND if _run_all(chosen, limits, options.jobs) else _OK
    except KeyboardInterrupt:
        print(f"interrupted; the corpus in {options.corpus} remains for the next run", file=sys.stderr)
        return _INTERRUPTED


def default_corpus() -> Path:
    """Return the folder of the grown corpus: nomad-fuzz in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "nomad-fuzz"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/fuzz",
        description="Run mutated inputs through the readers of the project. A reader must return a value or raise a "
        "documented error, quickly and without memory growth; other inputs are stored in fuzz/found.",
    )
    parser.add_argument("readers", nargs="*", metavar="READER", help="only these readers (default: all; see --list)")
    parser.add_argument("--runs", type=_whole, default=RUNS, metavar="N",
                        help="inputs per reader (default: %(default)s)")  # fmt: skip
    parser.add_argument("--seconds", type=_seconds, metavar="S",
                        help="instead of --runs: S seconds shared by all readers")  # fmt: skip
    parser.add_argument("--blind", action="store_true",
                        help="mutate at random, without coverage: faster, and without atheris")  # fmt: skip
    parser.add_argument("--jobs", type=_whole, default=os.cpu_count() or 1, metavar="N",
                        help="readers in parallel (default: number of cores)")  # fmt: skip
    parser.add_argument("--corpus", type=Path, default=default_corpus(), metavar="DIR",
                        help="store inputs that reach new code in DIR/READER, and start from those there "
                        "(default: nomad-fuzz in the user's cache)")  # fmt: skip
    parser.add_argument("--list", action="store_true", help="list the readers and exit")
    parser.add_argument("--again", type=Path, metavar="FILE",
                        help="run one input again, such as fuzz/found/worlds-1a2b3c")  # fmt: skip
    return parser


def _whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not int(text[:18]) > 0:
        raise argparse.ArgumentTypeError(f"must be a whole number above 0, not {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    with contextlib.suppress(ValueError):
        if 0.0 < float(text) < 1e9:
            return float(text)
    raise argparse.ArgumentTypeError(f"must be a number of seconds above 0, not {text!r}")


def _load_readers(*, instrumented: bool) -> dict[str, Reader]:
    if not instrumented:
        from fuzz.readers import READERS

        return READERS
    try:
        import atheris
    except ImportError:
        raise SystemExit("scripts/fuzz needs atheris (Linux, Python 3.11 to 3.13): pip install -e '.[dev]'; "
                         "or use --blind") from None  # fmt: skip
    with contextlib.redirect_stderr(io.StringIO()), atheris.instrument_imports(include=list(PACKAGES)):
        from fuzz.readers import READERS

    return READERS


def _run_again(readers: dict[str, Reader], path: Path) -> int:
    """Run one input; an undocumented exception is shown with its traceback."""
    reader = readers.get(path.name.partition("-")[0]) or readers.get(path.absolute().parent.name)
    if reader is None:
        print(f"{path}: the name of the file or of its folder must be that of a reader: {', '.join(readers)}",
              file=sys.stderr)  # fmt: skip
        return _USAGE
    errors = ", ".join(error.__name__ for error in reader.errors)
    print("accepted" if reader.accepts(path.read_bytes()) else f"rejected as documented: {errors}")
    return _OK


def _run_all(readers: list[Reader], limits: Limits, jobs: int) -> bool:
    """Run all readers, some in parallel. Return True if there was a finding."""
    from fuzz.reader import input_folder
    from fuzz.runner import FOUND, shared_status

    # Create shared resources before forking: the folder for inputs, and the figures of each reader.
    input_folder()
    for log in FOUND.glob(".*.log"):
        log.unlink()
    print(f"{'reader':16} {'executions':>11} {'/s':>7} {'accepted':>8} {'slowest':>8} {'RSS MB':>13} {'objects':>8}")
    waiting, running, has_findings, started_s = list(readers), dict[int, "Reader"](), False, time.time()
    statuses = {reader.name: shared_status() for reader in readers}
    try:
        while waiting or running:
            # 1. Start readers up to the number of jobs.
            while waiting and len(running) < jobs:
                reader = waiting.pop(0)
                running[_fork(_supervise, reader, statuses[reader.name], limits)] = reader
            # 2. Report the next one that ends.
            pid, exit_status = os.wait()
            reader = running.pop(pid)
            has_findings |= _report(reader, statuses[reader.name], exit_status, started_s)
    finally:
        for pid, reader in running.items():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            print(_row(reader, statuses[reader.name]))
    return has_findings


def _supervise(reader: Reader, status: Status, limits: Limits) -> int:
    """Run a reader in one process after another until it is done. Return the exit code of the last one."""
    from fuzz.runner import GUIDED_INPUTS

    os.setpgid(0, 0)  # one process group per reader, so that an interrupt can end all of its processes
    started_s = time.monotonic()
    while True:
        remaining = limits.runs - status.executions
        seconds = limits.seconds - (time.monotonic() - started_s)
        if remaining <= 0 or (status.executions and seconds < _MIN_S):
            return 0
        # Guided processes are restarted, because atheris accumulates memory.
        inputs = min(remaining, GUIDED_INPUTS) if limits.is_guided else remaining
        _, exit_status = os.waitpid(_fork(_run, reader, status, limits, inputs, max(seconds, _MIN_S)), 0)
        if exit_status:
            return os.waitstatus_to_exitcode(exit_status) & 0xFF


def _run(reader: Reader, status: Status, limits: Limits, inputs: float, seconds: float) -> int:
    from fuzz.runner import Run

    run = Run(reader, status, limits.corpus / reader.name, inputs, seconds, is_guided=limits.is_guided)
    if limits.is_guided:
        run.guided()
    run.blind()
    return 0


def _fork(function: Callable[..., int], *arguments: Any) -> int:
    """Call a function in a forked process, which exits with its result. Return the process id."""
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        code = _FOUND
        try:
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            code = function(*arguments)
        except BaseException:  # noqa: BLE001 anything that ends the process is reported
            traceback.print_exc()
        finally:
            os._exit(code)
    return pid


def _report(reader: Reader, status: Status, exit_status: int, started_s: float) -> bool:
    """Print the result of a reader. Return True if there was a finding."""
    print(_row(reader, status), flush=True)
    lines = list(_findings(reader, status, exit_status, started_s))
    for line in lines:
        print(f"  {line}", flush=True)
    return bool(lines)


def _findings(reader: Reader, status: Status, exit_status: int, started_s: float) -> Iterator[str]:
    from fuzz.runner import FOUND

    # Findings of this run; older files are findings of earlier ones.
    found = [path for path in sorted(FOUND.glob(f"{reader.name}-*")) if path.stat().st_mtime >= started_s - 1.0]
    for path in found:
        yield f"found: scripts/fuzz --again {path.relative_to(FOUND.parents[1])}"
        yield f"  input: {path.read_bytes()!r:.{_MAX_SHOWN}}"
    if exit_status:
        yield f"the process ended with {os.waitstatus_to_exitcode(exit_status)}: a hang, exhausted memory, or a crash"
    if exit_status or found:
        log = FOUND / f".{reader.name}.log"
        lines = log.read_text(errors="replace").splitlines() if log.exists() else []
        yield from ("end of its log:", *(f"  {line}" for line in lines[-12:]))
    growths = (
        ("kB of memory", status.end_kb - status.warm_kb, MAX_GROWTH_KB),
        ("objects", status.end_objects - status.warm_objects, MAX_GROWTH_OBJECTS),
    )
    for unit, growth, maximum in growths:
        if growth > maximum:
            yield f"grew by {growth} {unit} since the warm-up"


def _row(reader: Reader, status: Status) -> str:
    speed, accepted = status.executions / (status.seconds or 1.0), status.accepted / (status.executions or 1)
    return (f"{reader.name:16} {status.executions:11,} {speed:7.0f} {accepted:8.1%} {1000 * status.slowest_s:5.0f} ms "
            f"{status.warm_kb / 1024:6.1f} {(status.end_kb - status.warm_kb) / 1024:+6.1f} "
            f"{status.end_objects - status.warm_objects:+8}")  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
