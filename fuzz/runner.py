"""Run one reader on many inputs in a process of its own: guided by coverage with atheris, or by mutation alone.

The process reports through shared memory (`Status`), so that its figures survive a crash. It continues after a finding
and stores the shortest input of each kind in fuzz/found. An input that hangs or exhausts memory ends the process;
libFuzzer stores it.
"""

from __future__ import annotations

import contextlib
import ctypes
import faulthandler
import gc
import hashlib
import itertools
import logging
import mmap
import os
import resource
import sys
import time
import traceback
import warnings
from pathlib import Path
from random import Random
from typing import Final

from fuzz.mutation import choose, mutate_bytes
from fuzz.reader import Reader, input_folder

FOUND: Final = Path(__file__).parent / "found"
MAX_INPUT_S: Final = 1.0
"""Processor time of one input; the slowest valid ones take some hundredths of a second."""
MAX_HANG_S: Final = 25
MAX_MEMORY_MB: Final = 2048
MAX_ADDRESS_SPACE: Final = 8 << 30
"""Bytes: a process that needs more gets a MemoryError instead of slowing the machine down."""
GUIDED_INPUTS: Final = 100_000
"""Inputs of one guided process: atheris stores an object for some comparisons, and ending the process frees them."""
WARM_UP: Final = 0.2
"""Fraction of a run during which caches fill; memory is compared from then on."""
MIN_WARM_INPUTS: Final = 5_000
"""Inputs until the caches of the mutators are full; shorter runs compare no memory."""
_MAX_KINDS: Final = 20
_CHECK_EVERY_S: Final = 0.1
_MUTATIONS: Final = (1, 1, 2, 3)
_PAGE_KB: Final = os.sysconf("SC_PAGE_SIZE") // 1024


class Status(ctypes.Structure):
    """Figures of a reader in shared memory, summed over its processes; memory and objects are of the last one.

    Objects are those that Python has allocated. They are counted only without guidance, where nothing but the reader
    allocates them.
    """

    executions: int
    accepted: int
    seconds: float
    slowest_s: float
    warm_kb: int
    end_kb: int
    warm_objects: int
    end_objects: int
    _fields_ = (
        ("executions", ctypes.c_longlong), ("accepted", ctypes.c_longlong), ("seconds", ctypes.c_double),
        ("slowest_s", ctypes.c_double), ("warm_kb", ctypes.c_longlong), ("end_kb", ctypes.c_longlong),
        ("warm_objects", ctypes.c_longlong), ("end_objects", ctypes.c_longlong),
    )  # fmt: skip


def shared_status() -> Status:
    """Return figures that a process shares with the processes that it forks."""
    return Status.from_buffer(mmap.mmap(-1, ctypes.sizeof(Status)))


class Run:
    """A run of a reader in this process, of at most `max_inputs` inputs and `max_seconds` seconds."""

    def __init__(
        self, reader: Reader, status: Status, corpus: Path, max_inputs: float, max_seconds: float, *, is_guided: bool
    ) -> None:
        self.reader, self.status, self.corpus = reader, status, corpus
        self.is_guided = is_guided
        self._max_inputs, self._max_seconds = max_inputs, max_seconds
        self._inputs = 0
        self._started_s = self._checked_s = time.perf_counter()
        self._seconds_before = status.seconds
        self._is_warm = False
        self._kinds: dict[tuple[object, ...], int] = {}

    def guided(self) -> None:
        """Let atheris choose the inputs by coverage. Does not return: the process ends with the run."""
        import atheris

        self._isolate()
        self.corpus.mkdir(parents=True, exist_ok=True)
        starts = input_folder() / f"{self.reader.name}.seeds"
        starts.mkdir(exist_ok=True)
        for seed in self._seeds():
            (starts / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
        # 1. Options of libFuzzer: limits per input, no size ramp-up, no handling of signals, no output.
        options = {
            "artifact_prefix": f"{FOUND}/{self.reader.name}-", "max_len": self.reader.max_size, "timeout": MAX_HANG_S,
            "rss_limit_mb": MAX_MEMORY_MB, "len_control": 0, "reload": 0, "handle_int": 0, "handle_term": 0,
            "detect_leaks": 0, "verbosity": 0, "seed": self.status.executions % 2**31 + 1,
        }  # fmt: skip

        def mutate(data: bytes, max_size: int, seed: int) -> bytes:
            # Half of the mutations keep the input nearly valid, half are those of libFuzzer, which uses comparisons.
            rng = Random(seed)
            if rng.random() < 0.5:
                return bytes(atheris.Mutate(data, max_size))
            return self.reader.mutate(data, rng)[:max_size]

        # 2. New inputs are stored in the first folder; those of the second are only read.
        arguments = [f"-{name}={value}" for name, value in options.items()]
        atheris.Setup([sys.argv[0], *arguments, str(self.corpus), str(starts)], self.run_input, custom_mutator=mutate)
        atheris.Fuzz()

    def blind(self) -> None:
        """Mutate seeds and corpus at random, without coverage. Does not return: the process ends with the run."""
        self._isolate()
        # Each process of a reader has another seed, and repeats its inputs when run again.
        rng = Random(self.status.executions)
        inputs = [*self._seeds(), *(path.read_bytes() for path in sorted(self.corpus.glob("*")))]
        gc.freeze()
        while True:
            # The shorter of two: short inputs are read faster, so more of them are tried.
            data = min(choose(inputs, rng), choose(inputs, rng), key=len)
            for _ in range(choose(_MUTATIONS, rng)):
                data = mutate_bytes(data, rng) if rng.random() < 0.25 else self.reader.mutate(data, rng)
            self.run_input(data[: self.reader.max_size])

    def run_input(self, data: bytes) -> None:
        """Run one input; end the process if it was the last one."""
        status, started_s = self.status, time.process_time()
        try:
            status.accepted += self.reader.accepts(data)
        except Exception as error:  # noqa: BLE001 any undocumented exception is a finding
            self._save_finding(error, data)
        seconds = time.process_time() - started_s
        if seconds > max(status.slowest_s, MAX_INPUT_S):
            self._save_finding(TimeoutError(f"{seconds:.1f} s for one input"), data)
        status.slowest_s = max(status.slowest_s, seconds)
        status.executions += 1
        self._inputs += 1
        now_s = time.perf_counter()
        if self._inputs >= self._max_inputs or now_s - self._checked_s > _CHECK_EVERY_S:
            self._checked_s = now_s
            self._check_limits()

    def _check_limits(self) -> None:
        """Record memory after the warm-up and at the end, and end the process if the run is complete."""
        seconds = time.perf_counter() - self._started_s
        self.status.seconds = self._seconds_before + seconds
        if not self.is_guided:
            faulthandler.dump_traceback_later(2 * MAX_HANG_S, exit=True)
        # The run is complete after its inputs or its time, whichever comes first.
        progress = max(self._inputs / self._max_inputs, seconds / self._max_seconds)
        if not self._is_warm and (progress >= 1.0 or (progress >= WARM_UP and self._inputs >= MIN_WARM_INPUTS)):
            self._is_warm = True
            self.status.warm_kb, self.status.warm_objects = self._measure_memory()
        if progress >= 1.0:
            self.status.end_kb, self.status.end_objects = self._measure_memory()
            os._exit(0)

    def _measure_memory(self) -> tuple[int, int]:
        """Return resident memory in kB and the number of Python objects, after the same inputs each time."""
        # 1. The last inputs may be in caches: replace them.
        for seed in itertools.islice(self.reader.valid_inputs(), 3):
            self.reader.accepts(seed)
        # 2. Return freed memory to the system, where the C library can.
        gc.collect()
        with contextlib.suppress(AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
        resident_kb = int(Path("/proc/self/statm").read_text().split()[1]) * _PAGE_KB
        return resident_kb, 0 if self.is_guided else sys.getallocatedblocks()

    def _seeds(self) -> list[bytes]:
        return [*self.reader.valid_inputs(), *self.reader.seeds().values()]

    def _save_finding(self, error: Exception, data: bytes) -> None:
        """Store the shortest input of each kind of error: exception type and line of this project."""
        # The last line of this project tells errors of the same type apart.
        frames = [(frame.filename, frame.lineno) for frame in traceback.extract_tb(error.__traceback__)
                  if "site-packages" not in frame.filename]  # fmt: skip
        kind = (type(error).__name__, *frames[-1:])
        if len(self._kinds) >= _MAX_KINDS or self._kinds.get(kind, len(data) + 1) <= len(data):
            return
        self._kinds[kind] = len(data)
        FOUND.mkdir(exist_ok=True)
        digest = hashlib.sha1(repr(kind).encode()).hexdigest()[:10]
        (FOUND / f"{self.reader.name}-{digest}").write_bytes(data)
        traceback.print_exception(error, limit=-6)

    def _isolate(self) -> None:
        """Send output to a log file and set the limits of this process."""
        FOUND.mkdir(exist_ok=True)
        log = os.open(FOUND / f".{self.reader.name}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        null = os.open(os.devnull, os.O_RDONLY)
        for source, stream in ((null, 0), (log, 1), (log, 2)):
            os.dup2(source, stream)
        resource.setrlimit(resource.RLIMIT_AS, (MAX_ADDRESS_SPACE, MAX_ADDRESS_SPACE))
        logging.disable(logging.CRITICAL)
        warnings.simplefilter("error")
        _cache_entry_points()


def _cache_entry_points() -> None:
    """Look up installed plugins once: the search takes longer than all other work on an address."""
    import functools
    from importlib.metadata import entry_points

    from nclient.transports import stream as memory

    setattr(memory, "entry_points", functools.cache(entry_points))  # noqa: B010 an import of that module
