"""Build the C library with its Makefile, and programs linked with it, for the tests.

    BuildCache.libraries(kind)      both libraries, built once for all workers of a test run
    BuildCache.program(source, ...) a program linked with one of them
    run_calls([...], script)        the client state of programs/replay.c after each call of a script
    run_nserver(...)                an Nserver in its own process

Everything is built in the temporary folder of the test run. 32-bit builds need a compiler that supports them.
"""

from __future__ import annotations

import contextlib
import fcntl
import functools
import json
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.programs.forked import Forked

ROOT = Path(__file__).parents[2]
CLIB = ROOT / "clib"
PROGRAMS = Path(__file__).parent / "programs"
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
TIMEOUT_S = 60.0
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@functools.cache
def can_build_32_bit() -> bool:
    """Return True if 32-bit programs can be compiled and run on this machine."""
    with tempfile.TemporaryDirectory() as folder:
        # The compiler may accept -m32 and lack the 32-bit headers, or the kernel may not run the program: both are
        # tried.
        source, made = Path(folder) / "try.c", Path(folder) / "try"
        source.write_text("#include <stdio.h>\nint main(void) { return sizeof(long) != 4; }\n")
        command = ["cc", "-m32", str(source), "-o", str(made)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return False
        return subprocess.run([str(made)], check=False).returncode == 0


@dataclass(frozen=True)
class BuildKind:
    """A build configuration: word size and sanitizers."""

    bits: int
    sanitized: bool = False

    @property
    def name(self) -> str:
        return f"{self.bits}{'-sanitized' if self.sanitized else ''}"

    @property
    def flags(self) -> tuple[str, ...]:
        return (("-m32",) if self.bits == 32 else ()) + (SANITIZERS if self.sanitized else ())

    @property
    def optimization(self) -> str:
        """Return the compiler's optimization flags: as shipped, or none under sanitizers, which then check all code."""
        return "-O0 -g" if self.sanitized else "-O2 -g"

    @property
    def make_options(self) -> tuple[str, ...]:
        """Return the options for make."""
        return (("M32=1",) if self.bits == 32 else ()) + (("SANITIZE=1",) if self.sanitized else ())


PLAIN, SANITIZED = BuildKind(64), BuildKind(64, True)
NARROW, NARROW_SANITIZED = BuildKind(32), BuildKind(32, True)
KINDS = (PLAIN, SANITIZED, NARROW, NARROW_SANITIZED)


class BuildCache:
    """A folder shared by all workers of a test run; each library and program in it is built once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def libraries(self, kind: BuildKind) -> Path:
        """Return the folder of libnclient.a and libndirect.a, building them first if needed."""
        folder = self.folder / kind.name
        # Workers of one test run need the same library: the first one builds it while the others wait for the lock.
        with self._lock(kind.name):
            if not (folder / "complete").exists():
                options = (f"BUILD={folder}", f"CFLAGS={kind.optimization}", *kind.make_options)
                run(["make", "-s", "-j2", "-C", str(CLIB), *options])
                for made in folder.rglob("*.a"):  # M32 and SANITIZE build in subfolders
                    if made.parent != folder:
                        shutil.copy(made, folder)
                # A marker, since an interrupted build leaves some of the files.
                (folder / "complete").touch()
        return folder

    def program(
        self, source: Path, kind: BuildKind, library: str = "nclient", flags: tuple[str, ...] = (),
        extra_libraries: tuple[str, ...] = (),
    ) -> Path:
        """Return a program built from one source and a library; `flags` replaces the default standard and warnings."""
        libraries = self.libraries(kind)
        made = libraries / f"{source.parent.name}-{source.stem}-{library}"
        with self._lock(f"{kind.name}-{made.name}"):
            if not made.exists():
                partial = made.with_suffix(".partial")
                headers = ("-I", str(CLIB / "include"), "-I", str(CLIB / "src"))
                linked = ("-L", str(libraries), f"-l{library}", *extra_libraries)
                standard = flags or ("-std=c99", *WARNINGS)
                run(["cc", *standard, "-g", *kind.flags, *headers, str(source), *linked, "-o", str(partial)])
                # Renamed when complete: another worker must not execute a half-written program.
                partial.rename(made)
        return made

    def _lock(self, name: str) -> _Lock:
        return _Lock(self.folder / f"{name}.lock")


class _Lock:
    """A lock between the workers of a test run."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w")

    def __enter__(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def __exit__(self, *_: object) -> None:
        self._file.close()


def run(command: list[str]) -> str:
    """Run a command and return its output; fail with the output if the command fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def run_calls(program: list[str], script: str) -> list[dict[str, Any]]:
    """Return the client state of programs/replay.c after each call of a script; the last entry is its stderr."""
    # Tests may set a shorter one.
    timeout = {"REPLAY_TIMEOUT_MS": "10000"} | os.environ
    done = subprocess.run(program, input=script, env=timeout, capture_output=True, text=True, timeout=TIMEOUT_S,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()] + [{"stderr": done.stderr}]


@contextlib.contextmanager
def run_nserver(*words: str) -> Iterator[str]:
    """Run a server and yield its port."""
    with Forked("nserver", "--port", "0", *words) as process:
        try:
            # The server prints its port in its first line, and the serial link in the second one.
            port = process.stdout.readline().rpartition(":")[2].strip()
            if "--serial-link" in words:
                process.stdout.readline()
            yield port
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(TIMEOUT_S)
