"""`scripts/fuzz`: hostile input for every reader, or for those named. See fuzz/__init__.py and docs/fuzzing.md.

Rules: our packages are imported under atheris's instrumentation, and by nobody before; each reader has a process of its
own, forked from this one, so that they are imported once. Exit code 1: something was found, or memory grew.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from fuzz.campaign import Progress
    from fuzz.reader import Reader

PACKAGES: Final = ("nclient", "nserver_emu", "localization", "worlds")
RUNS: Final = 10_000_000
MOST_GROWN_KB: Final = 100_000
"""libFuzzer's own corpus and tables are some ten thousand."""
MOST_GROWN_BLOCKS: Final = 20_000
"""Objects of Python's: a tenth of one for each input would be a hundred times as many in a long run."""
_SHOWN: Final = 2000
"""Characters of an input that a report holds: where only the report is left of a run, it says what was found."""
_POLL_S: Final = 0.1
_LEAST_S: Final = 0.2
"""For less, no process is begun anew."""
_TOLD_EVERY_S: Final = 1.0
_CLEAN, _FOUND, _USAGE, _INTERRUPTED = 0, 1, 2, 130


class Goals(NamedTuple):
    """Where it happens, when a reader has had enough, and whether anybody looks at the code that is reached."""

    work: Path
    runs: int | None
    seconds: float | None
    blind: bool

    def after(self, seconds: float) -> Goals:
        """What is left of them for one that began so long ago."""
        return self if self.seconds is None else self._replace(seconds=max(_LEAST_S, self.seconds - seconds))

    def more(self, progress: Progress) -> bool:
        """Whether there is more to do for a reader that ended well and is so far: it was at the end of a spell."""
        return progress.executions < self.runs if self.runs else (self.seconds or 0.0) > _LEAST_S


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    readers = _readers(instrumented=not (options.again or options.list or options.blind))
    for name in options.readers:
        if name not in readers:
            parser.error(f"no reader {name!r}; there are {', '.join(readers)}")
    if options.list:
        for reader in readers.values():
            print(f"{reader.name:16}  {reader.about}")
        return _CLEAN
    if options.again:
        return _again(readers, options.again)
    return _run([readers[name] for name in options.readers or readers], options)


def _run(chosen: list[Reader], options: argparse.Namespace) -> int:
    """All of these readers; the exit code."""
    with contextlib.ExitStack() as held:
        held.callback(_files_gone)
        work = options.work or Path(held.enter_context(tempfile.TemporaryDirectory(prefix="nomad-fuzz-")))
        work.mkdir(parents=True, exist_ok=True)
        seconds = None if options.seconds is None else options.seconds / len(chosen)
        try:
            bad = _all(chosen, Goals(work, None if seconds else options.runs, seconds, options.blind), options.jobs)
        except KeyboardInterrupt:
            print("stopped; " + (f"--work {options.work} goes on from here" if options.work else "nothing is kept"),
                  file=sys.stderr)  # fmt: skip
            return _INTERRUPTED
        if options.keep:
            _keep(chosen, work)
    return _FOUND if bad else _CLEAN


def _keep(chosen: Iterable[Reader], work: Path) -> None:
    from fuzz.corpus import keep

    for reader in chosen:
        print(f"{reader.name:16}  {keep(reader, work):4} inputs kept")


def _files_gone() -> None:
    from fuzz.place import folder

    folder().cleanup()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/fuzz", description="Hostile input for the readers of the project: a value or the documented "
        "error, nothing else, and no growth in memory. Inputs that show something else are left in fuzz/found."
    )  # fmt: skip
    parser.add_argument("readers", nargs="*", metavar="READER", help="only these (default: all; --list tells them)")
    parser.add_argument("--runs", type=_whole, default=RUNS, metavar="N", help="inputs a reader (default: %(default)s)")
    parser.add_argument("--seconds", type=_seconds, metavar="S", help="instead: so long, all readers together")
    parser.add_argument("--blind", action="store_true", help="without looking at what code is reached: up to three "
                        "times as fast, from what the corpus and --work hold")  # fmt: skip
    parser.add_argument("--jobs", type=_whole, default=os.cpu_count() or 1, metavar="N",
                        help="readers at a time (default: one a core)")
    parser.add_argument("--work", type=Path, metavar="DIR", help="keep inputs and counts there; the same again goes on "
                        "where it was stopped (default: a folder that is gone afterwards)")  # fmt: skip
    parser.add_argument("--keep", action="store_true", help="put what reached new code into fuzz/corpus")
    parser.add_argument("--list", action="store_true", help="tell the readers and do nothing")
    parser.add_argument("--again", type=Path, metavar="FILE", help="read one input again: fuzz/found/worlds-1a2b3c")
    return parser


def _whole(text: str) -> int:
    if not (text.isascii() and text.isdecimal()) or not int(text[:18]) > 0:
        raise argparse.ArgumentTypeError(f"a whole number above 0, not {text!r}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e9:
        raise argparse.ArgumentTypeError(f"a number of seconds above 0, not {text!r}")
    return value


def _readers(*, instrumented: bool) -> dict[str, Reader]:
    if instrumented:
        try:
            import atheris
        except ImportError:
            raise SystemExit("scripts/fuzz wants atheris (Linux, Python 3.11 to 3.13): pip install 'nomad-nserver[dev]'"
                             ) from None
        with contextlib.redirect_stderr(io.StringIO()), atheris.instrument_imports(include=list(PACKAGES)):
            from fuzz.table import READERS
    else:
        from fuzz.table import READERS
    return READERS


def _again(readers: dict[str, Reader], path: Path) -> int:
    """One input, read without anything around it; what it raises is shown whole."""
    reader = readers.get(path.name.partition("-")[0]) or readers.get(path.absolute().parent.name)
    if reader is None:
        print(f"{path}: its name or its folder begins with none of {', '.join(readers)}", file=sys.stderr)
        return _USAGE
    taken = reader.take(path.read_bytes())
    print("taken" if taken else f"refused as documented: {', '.join(error.__name__ for error in reader.errors)}")
    return _CLEAN


def _all(readers: list[Reader], goals: Goals, jobs: int) -> bool:
    """Every reader once, so many at a time; whether anything is wrong."""
    from fuzz.place import folder

    folder()
    print(f"{'reader':16} {'executions':>11} {'/s':>7} {'taken':>6} {'slowest':>8} {'RSS MB':>13} {'objects':>8}")
    waiting, running, bad, work = list(readers), dict[int, "Reader"](), False, goals.work
    begun_s: dict[str, float] = {}
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                reader = waiting.pop(0)
                since_s = time.monotonic() - begun_s.setdefault(reader.name, time.monotonic())
                running[_begun(reader, goals.after(since_s))] = reader
            for pid, status in _ended(running):
                reader = running.pop(pid)
                since_s = time.monotonic() - begun_s[reader.name]
                if not status and goals.after(since_s).more(_progress(work, reader)):
                    waiting.insert(0, reader)
                else:
                    bad |= _told(reader, work, status)
            _show(running.values(), work)
            time.sleep(_POLL_S)
    finally:
        for pid in running:
            os.kill(pid, signal.SIGTERM)
        for pid, reader in running.items():
            _wait(pid)
            print(_row(_progress(work, reader)))
    return bad


def _begun(reader: Reader, goals: Goals) -> int:
    """The number of the process that this reader has."""
    from fuzz.campaign import Campaign

    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid == 0:
        try:
            campaign = Campaign(reader, goals.work, goals.runs, goals.seconds)
            if goals.blind:
                campaign.run_blind()
            campaign.run()
        except BaseException:  # noqa: BLE001 whatever it is, it stands in the log
            traceback.print_exc()
        finally:
            os._exit(_FOUND)
    return pid


def _ended(running: dict[int, Reader]) -> list[tuple[int, int]]:
    """Processes that are over, with how they ended."""
    return [(pid, status) for pid, status in (os.waitpid(pid, os.WNOHANG) for pid in running) if pid]


def _wait(pid: int, patience_s: float = 5.0) -> None:
    until_s = time.monotonic() + patience_s
    while time.monotonic() < until_s:
        if os.waitpid(pid, os.WNOHANG)[0]:
            return
        time.sleep(_POLL_S)
    os.kill(pid, signal.SIGKILL)
    os.waitpid(pid, 0)


def _told(reader: Reader, work: Path, status: int) -> bool:
    """Print how a reader fared; whether anything is wrong."""
    progress = _progress(work, reader)
    print(_row(progress), flush=True)
    wrong = list(_wrong(progress, status, work))
    for line in wrong:
        print(f"  {line}", flush=True)
    return bool(wrong)


def _wrong(progress: Progress, status: int, work: Path) -> Iterator[str]:
    from fuzz.campaign import FOUND

    for path in progress.found:
        yield f"found: scripts/fuzz --again {Path(path).relative_to(FOUND.parents[1])}"
        with contextlib.suppress(FileNotFoundError):  # one of a run before this, mended since
            yield f"  which is {Path(path).read_bytes()!r:.{_SHOWN}}"
    if status:
        yield f"ended with {os.waitstatus_to_exitcode(status)} (a hang, all memory, or a crash)"
    if status or progress.found:
        log = (work / f"{progress.reader}.log").read_text(errors="replace").splitlines()
        yield from ("the end of its log is", *(f"  {line}" for line in log[-12:]))
    for what, (before, after), most in (("KB of memory", progress.rss_kb, MOST_GROWN_KB),
                                        ("objects", progress.blocks, MOST_GROWN_BLOCKS)):
        if after - before > most:
            yield f"grew by {after - before} {what} since the warm-up"


def _row(progress: Progress) -> str:
    speed, taken = progress.executions / (progress.seconds or 1.0), progress.taken / (progress.executions or 1)
    (begin_kb, end_kb), (begin, end) = progress.rss_kb, progress.blocks
    return (f"{progress.reader:16} {progress.executions:11,} {speed:7.0f} {taken:6.1%} "
            f"{1000 * progress.slowest_s:5.0f} ms {begin_kb / 1024:6.1f} {(end_kb - begin_kb) / 1024:+6.1f} "
            f"{end - begin:+8}")


def _show(readers: Iterable[Reader], work: Path) -> None:
    """A line that tells how far those are that run, for who sits at a terminal."""
    if not sys.stderr.isatty():
        return
    told = (_progress(work, reader) for reader in readers)
    print("\r\33[K" + "   ".join(f"{each.reader} {each.executions:,}" for each in told), end="\r", file=sys.stderr)


def _progress(work: Path, reader: Reader) -> Progress:
    from fuzz.campaign import Progress

    return Progress.read(work, reader.name)


if __name__ == "__main__":
    raise SystemExit(main())
