"""One reader under atheris, in a process of its own, forked for it: millions of inputs, findings, memory.

    work/READER/          inputs that reached new code: goes on growing where the folder is kept
    work/READER.json      how far it got, read when it goes on        work/READER.log     what libFuzzer says
    fuzz/found/READER-*   inputs that showed something

Rules: this process ends by itself, after so many inputs or seconds, after a spell of them (who began it begins the
next), or told by SIGTERM; it tells by its file alone. A finding does not end it: the shortest input of each kind is
kept. What hangs or takes all memory ends it, and libFuzzer writes the input down. Instrumented are our packages, before
they are imported (see __main__).
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import functools
import gc
import hashlib
import itertools
import json
import logging
import os
import resource
import signal
import sys
import time
import traceback
import warnings
from dataclasses import asdict, dataclass, field
from importlib.metadata import entry_points
from pathlib import Path
from random import Random
from typing import Any, Final

from fuzz.mutating import below, bytes_changed, one_of
from fuzz.reader import CORPUS, Reader

FOUND: Final = Path(__file__).parent / "found"
SLOW_S: Final = 1.0
"""Of the processor's time, more than any input of these sizes may take; the slowest ones take hundredths."""
HANGS_S: Final = 25
MOST_MEMORY_MB: Final = 2048
_STUCK_S: Final = 60
"""Where nobody else sees to it, a process that is not heard of for so long ends with what it was at."""
SPELL: Final = 100_000
"""Inputs of one process under instrumentation: what that keeps in memory goes with it."""
_NO_END: Final = 1 << 62
_CHANGES: Final = (1, 1, 2, 3)
_MOST_ADDRESSES: Final = 8 << 30
_MOST_KINDS: Final = 20
_LAST_SEEDS: Final = 3
_LOOK_EVERY: Final = 512
_TOLD_EVERY_S: Final = 0.5
_WARM_SHARE: Final = 0.2
"""Of the run: until then caches fill."""
_PAGE_KB: Final = os.sysconf("SC_PAGE_SIZE") // 1024


@dataclass(slots=True)
class Progress:
    """How far a reader got, over all the runs of a folder; memory and seconds are of the last one.

    rss_kb      memory of the process after the warm-up and at the end, libFuzzer's own corpus and tables in it
    blocks      objects that Python holds, likewise: what a reader keeps shows here. Only of a blind run: instrumented
                code keeps an object of atheris's own for some comparisons
    """

    reader: str
    executions: int = 0
    seconds: float = 0.0
    taken: int = 0
    slowest_s: float = 0.0
    rss_kb: tuple[int, int] = (0, 0)
    blocks: tuple[int, int] = (0, 0)
    found: list[str] = field(default_factory=list)

    @classmethod
    def read(cls, work: Path, reader: str) -> Progress:
        """What stands in a folder; nothing where nothing does."""
        try:
            return cls(**json.loads((work / f"{reader}.json").read_text()))
        except FileNotFoundError:
            return cls(reader)

    def write(self, work: Path) -> None:
        """Put it there, whole or not at all."""
        unfinished = work / f".{self.reader}.json"
        unfinished.write_text(json.dumps(asdict(self)))
        unfinished.replace(work / f"{self.reader}.json")


class Campaign:
    """See the head of this file. It is over after `runs` inputs in all, or after `seconds` of this one."""

    def __init__(self, reader: Reader, work: Path, runs: int | None, seconds: float | None) -> None:
        self._reader, self._work = reader, work
        self._runs, self._seconds = runs, seconds
        self.progress = Progress.read(work, reader.name)
        self._before = self.progress.executions, self.progress.seconds
        self._most = min(runs or _NO_END, self._before[0] + SPELL)
        self._begun_s = self._told_s = time.perf_counter()
        self._warm = self._blind = False
        self._ended = False
        self._kinds: dict[tuple[object, ...], bytes] = {}

    def run(self) -> None:
        """Never comes back: the process ends with it."""
        import atheris

        self._settle()
        folder, seeds = self._work / self._reader.name, self._work / f".{self._reader.name}.seeds"
        for made in (folder, seeds, FOUND):
            made.mkdir(exist_ok=True)
        for seed in self._reader.seeds():
            (seeds / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
        options = {
            "artifact_prefix": f"{FOUND}/{self._reader.name}-", "max_len": self._reader.longest, "timeout": HANGS_S,
            "rss_limit_mb": MOST_MEMORY_MB, "len_control": 0, "reload": 0, "handle_int": 0, "handle_term": 0,
            "detect_leaks": 0, "verbosity": 0, "seed": self._before[0] % 2**31 + 1,
        }  # fmt: skip
        kept = [str(CORPUS / self._reader.name)] if (CORPUS / self._reader.name).is_dir() else []
        given = [f"-{name}={value}" for name, value in options.items()]
        gc.freeze()
        self._begun_s = self._told_s = time.perf_counter()
        arguments = [sys.argv[0], *given, str(folder), *kept, str(seeds)]
        atheris.Setup(arguments, self._one, custom_mutator=self._mutator(atheris))
        atheris.Fuzz()

    def run_blind(self) -> None:
        """The same without atheris: changes to the seeds, the corpus and what stands in the folder, by chance.

        Of two the shorter: what is read faster is read more often.
        """
        self._blind, self._most = True, self._runs or _NO_END
        self._settle()
        faulthandler.dump_traceback_later(_STUCK_S, exit=True)
        chance = Random(self._before[0])
        grown = (path.read_bytes() for path in (self._work / self._reader.name).glob("*"))
        inputs = [*self._reader.seeds(), *self._reader.kept(), *grown]
        gc.freeze()
        self._begun_s = self._told_s = time.perf_counter()
        while True:
            data = min(one_of(inputs, chance), one_of(inputs, chance), key=len)
            for _ in range(one_of(_CHANGES, chance)):
                data = bytes_changed(data, chance) if below(4, chance) == 0 else self._reader.mutate(data, chance)
            self._one(data[: self._reader.longest])

    def _settle(self) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._end)
        log = os.open(self._work / f"{self._reader.name}.log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        nothing = os.open(os.devnull, os.O_RDONLY)
        for given, stream in ((nothing, 0), (log, 1), (log, 2)):
            os.dup2(given, stream)
        resource.setrlimit(resource.RLIMIT_AS, (_MOST_ADDRESSES, _MOST_ADDRESSES))
        logging.disable(logging.CRITICAL)
        warnings.simplefilter("error")
        _read_entry_points_once()

    def _mutator(self, atheris: Any) -> Any:
        """Half of the changes fit the language, half are libFuzzer's own, which knows what was compared with what.

        Only once it runs is `atheris.Mutate` what it is called.
        """
        mutate = self._reader.mutate

        def mutated(data: bytes, longest: int, seed: int) -> bytes:
            chance = Random(seed)
            if chance.randrange(2):
                return bytes(atheris.Mutate(data, longest))
            return mutate(data, chance)[:longest]

        return mutated

    def _one(self, data: bytes) -> None:
        """One input; at times a look at the clock and at memory."""
        progress = self.progress
        begun_s = time.process_time()
        try:
            progress.taken += self._reader.take(data)
        except Exception as error:  # noqa: BLE001 whatever it is, it is what is looked for
            self._note(error, data)
        now_s, took_s = time.perf_counter(), time.process_time() - begun_s
        if took_s > progress.slowest_s:
            progress.slowest_s = took_s
            if progress.slowest_s > SLOW_S:
                self._note(TimeoutError(f"{progress.slowest_s:.1f} s for one input"), data)
        progress.executions += 1
        done = progress.executions >= self._most
        if done or self._ended or now_s - self._told_s > _TOLD_EVERY_S or progress.executions % _LOOK_EVERY == 0:
            self._look(now_s, done)

    def _look(self, now_s: float, done: bool) -> None:
        seconds = now_s - self._begun_s
        if not self._warm and (done or self._share(seconds) >= _WARM_SHARE):
            self._warm = True
            self.progress.rss_kb, self.progress.blocks = ((count,) * 2 for count in self._at_rest())
        over = done or self._ended or (self._seconds is not None and seconds >= self._seconds)
        if over or now_s - self._told_s > _TOLD_EVERY_S:
            self._told_s = now_s
            if self._blind:
                faulthandler.dump_traceback_later(_STUCK_S, exit=True)
            self._tell(seconds, over)
        if over:
            os._exit(0)

    def _share(self, seconds: float) -> float:
        """Of the run, by inputs or by time, that is behind."""
        inputs = (self.progress.executions - self._before[0]) / max(1, self._most - self._before[0])
        return max(inputs, seconds / self._seconds if self._seconds else 0.0)

    def _tell(self, seconds: float, over: bool) -> None:
        progress = self.progress
        progress.seconds = round(self._before[1] + seconds, 3)
        if over and self._warm:
            rss_kb, blocks = self._at_rest()
            progress.rss_kb, progress.blocks = (progress.rss_kb[0], rss_kb), (progress.blocks[0], blocks)
        progress.write(self._work)

    def _at_rest(self) -> tuple[int, int]:
        """Memory and objects after the same few inputs: what the last one leaves in caches says nothing.

        Nor do holes between blocks, tens of megabytes after a million inputs of all lengths: they are given back first.
        """
        for seed in itertools.islice(self._reader.seeds(), _LAST_SEEDS):
            self._reader.take(seed)
        gc.collect()
        with contextlib.suppress(AttributeError):  # another C library
            ctypes.CDLL(None).malloc_trim(0)
        return _rss_kb(), sys.getallocatedblocks() if self._blind else 0

    def _note(self, error: Exception, data: bytes) -> None:
        """Keep the shortest input of each kind of error: what was raised, and where in our code."""
        ours = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)
                if "site-packages" not in frame.filename]  # fmt: skip
        kind = (type(error).__name__, *ours[-1:])
        if len(self._kinds) >= _MOST_KINDS or (kind in self._kinds and len(self._kinds[kind]) <= len(data)):
            return
        self._kinds[kind] = data
        path = FOUND / f"{self._reader.name}-{hashlib.sha1(repr(kind).encode()).hexdigest()[:10]}"
        FOUND.mkdir(exist_ok=True)
        path.write_bytes(data)
        if str(path) not in self.progress.found:
            self.progress.found.append(str(path))
        self.progress.write(self._work)
        traceback.print_exception(error, limit=-6)

    def _end(self, _signal: int, _frame: object) -> None:
        self._ended = True


def _rss_kb() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_KB


def _read_entry_points_once() -> None:
    """What is installed does not change meanwhile, and to look takes longer than all else about an address."""
    from nclient.transports import memory

    setattr(memory, "entry_points", functools.cache(entry_points))  # noqa: B010 it is that room's own import
