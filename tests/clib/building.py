"""The C library built for the tests, by its own Makefile, and programs linked with it; imported by name.

    build("64")             both libraries, once for all workers of a test run
    program("replay", ...)  a program of programs/, linked
    held([...], script)     what programs/replay.c holds after each call of a script
    daemon(...)             an Nserver of the project, as its own process

Rules: everything is made in the run's own temporary folder, never in the tree. 32 bits are tried where the compiler
can make them; `WIDTHS` says so, and scripts/test sees to it that it can.
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

from forked import Forked

ROOT = Path(__file__).parents[2]
CLIB = ROOT / "clib"
PROGRAMS = Path(__file__).parent / "programs"
WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Werror")
PATIENCE_S = 60.0
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all")


@functools.cache
def makes_32_bits() -> bool:
    """Whether this machine's compiler can make and run programs of 32 bits."""
    with tempfile.TemporaryDirectory() as folder:
        source, made = Path(folder) / "try.c", Path(folder) / "try"
        source.write_text("#include <stdio.h>\nint main(void) { return sizeof(long) != 4; }\n")
        command = ["cc", "-m32", str(source), "-o", str(made)]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return False
        return subprocess.run([str(made)], check=False).returncode == 0


@dataclass(frozen=True)
class Kind:
    """One way to build: how wide a long is, and whether sanitizers watch."""

    bits: int
    sanitized: bool = False

    @property
    def name(self) -> str:
        return f"{self.bits}{'-sanitized' if self.sanitized else ''}"

    @property
    def flags(self) -> tuple[str, ...]:
        return (("-m32",) if self.bits == 32 else ()) + (SANITIZERS if self.sanitized else ())

    @property
    def optimised(self) -> str:
        """As shipped; where sanitizers watch, so that they see all of it."""
        return "-O0 -g" if self.sanitized else "-O2 -g"

    @property
    def switches(self) -> tuple[str, ...]:
        """What make is told."""
        return (("M32=1",) if self.bits == 32 else ()) + (("SANITIZE=1",) if self.sanitized else ())


PLAIN, SANITIZED = Kind(64), Kind(64, True)
NARROW, NARROW_SANITIZED = Kind(32), Kind(32, True)
KINDS = (PLAIN, SANITIZED, NARROW, NARROW_SANITIZED)


class Workshop:
    """A folder that all workers of a run share; each thing in it is made once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def libraries(self, kind: Kind) -> Path:
        """The folder of libnclient.a and libndirect.a."""
        place = self.folder / kind.name
        with self._alone(kind.name):
            if not (place / "whole").exists():
                told = (f"BUILD={place}", f"CFLAGS={kind.optimised}", *kind.switches)
                run(["make", "-s", "-j2", "-C", str(CLIB), *told])
                for made in place.rglob("*.a"):  # M32 and SANITIZE build in folders of their own
                    if made.parent != place:
                        shutil.copy(made, place)
                (place / "whole").touch()
        return place

    def program(
        self, source: Path, kind: Kind, library: str = "nclient", flags: tuple[str, ...] = (),
        beside: tuple[str, ...] = (),
    ) -> Path:
        """A program made of one source and a library, others `beside` it; `flags`: the standard first."""
        libraries = self.libraries(kind)
        made = libraries / f"{source.stem}-{library}"
        with self._alone(f"{kind.name}-{made.name}"):
            if not made.exists():
                partial = made.with_suffix(".partial")
                headers = ("-I", str(CLIB / "include"), "-I", str(CLIB / "src"))
                linked = ("-L", str(libraries), f"-l{library}", *beside)
                standard = flags or ("-std=c99", *WARNINGS)
                run(["cc", *standard, "-g", *kind.flags, *headers, str(source), *linked, "-o", str(partial)])
                partial.rename(made)
        return made

    def _alone(self, name: str) -> _Lock:
        return _Lock(self.folder / f"{name}.lock")


class _Lock:
    """One worker at a time."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("w")

    def __enter__(self) -> None:
        fcntl.flock(self._file, fcntl.LOCK_EX)

    def __exit__(self, *_: object) -> None:
        self._file.close()


def run(command: list[str]) -> str:
    """What a command says; a failure shows all of it."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def held(program: list[str], script: str) -> list[dict[str, Any]]:
    """What programs/replay.c held after each call of a script; the last tells what went to stderr."""
    patient = {"REPLAY_TIMEOUT_MS": "10000"} | os.environ  # the tests may say less
    done = subprocess.run(program, input=script, env=patient, capture_output=True, text=True, timeout=PATIENCE_S,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()] + [{"stderr": done.stderr}]


@contextlib.contextmanager
def daemon(*words: str) -> Iterator[str]:
    """A daemon; its port."""
    with Forked("nserver", "--port", "0", *words) as process:
        try:
            port = process.stdout.readline().rpartition(":")[2].strip()
            if "--serial-link" in words:
                process.stdout.readline()
            yield port
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(PATIENCE_S)
