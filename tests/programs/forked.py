"""Run `nserver` and `nomad` as separate processes without the one or two seconds that each needs for its imports.

    with Forked("nserver", "--port", "0") as process: process.stdout.readline()

They are forked from a process that has imported the packages: multiprocessing's fork server, one per test worker. Each
has its own command line, environment, sockets, signals and exit code. The interface is that of subprocess.Popen.

Tests of how programs start and exit use real commands instead (test_exit_codes.py, test_readme.py and others).
"""

from __future__ import annotations

import contextlib
import multiprocessing
import operator
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import reduction
from pathlib import Path
from typing import IO, Any, Self

_CONTEXT = multiprocessing.get_context("forkserver")
# What takes long to import is imported once, in the server from which programs are forked.
_CONTEXT.set_forkserver_preload([
    "nserver_emu.cli", "nserver_emu.server.pty", "nserver_emu.viewer.server", "numpy.random", "numpy.fft", "numpy.ma",
    "nclient.cli.main", "nclient.cli.serving", "nclient.cli.doctor", "nclient.cli.shell", "nclient.cli.robot",
    "nclient.cli.files",
    "localization.cli.calibrate", "localization.cli.localize", "localization.cli.mission",
    "localization.cli.map", "tests.programs.preloaded",
])  # fmt: skip


class Forked:
    """A process of `nserver` or `nomad`. `stdout` is a pipe; `stderr` on request.

    `cwd` and `environment` default to those of the tests.
    """

    def __init__(
        self, program: str, *words: str, stderr: bool = False, cwd: Path | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self.args = (program, *words)
        self.returncode: int | None = None
        self.stdout, out = _pipe()
        self.stderr: IO[str] | None = None
        err = os.dup(2)
        if stderr:
            os.close(err)
            self.stderr, err = _pipe()
        streams = _Descriptors(out, err)
        arguments = (program, words, cwd or Path.cwd(), dict(environment or os.environ), streams)
        self._process = _CONTEXT.Process(target=_run_program, args=arguments, daemon=True)
        self._process.start()
        # Only the forked process writes: the end of its output is then an end of file here.
        os.close(out)
        os.close(err)

    @property
    def pid(self) -> int:
        """Return the process id."""
        assert self._process.pid is not None
        return self._process.pid

    def poll(self) -> int | None:
        """Return the exit code, negative after a signal; None while it runs."""
        self.returncode = self._process.exitcode
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Wait for the end and return the exit code; raise TimeoutExpired if it still runs."""
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """Return the remaining output when it has ended; kill it after the time-out."""
        # Both pipes are read while the process runs; a full pipe would block it.
        with ThreadPoolExecutor(len(self._streams)) as readers:
            outputs = readers.map(operator.methodcaller("read"), self._streams)
            try:
                self.wait(timeout)
            except subprocess.TimeoutExpired:
                self.kill()
                raise
            out, err = (*outputs, "")[:2]
        self._close()
        return out, err

    def send_signal(self, number: int) -> None:
        """Send a signal if it still runs."""
        if self.poll() is None:
            with contextlib.suppress(ProcessLookupError):  # it ended meanwhile, as subprocess handles it too
                os.kill(self.pid, number)

    def terminate(self) -> None:
        """Send SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Send SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: type[BaseException] | None, *_: object) -> None:
        # After a failure nothing ends a program that waits.
        if error is not None:
            self.kill()
        self._close()
        self.wait()

    @property
    def _streams(self) -> list[IO[str]]:
        return [stream for stream in (self.stdout, self.stderr) if stream]

    def _close(self) -> None:
        for stream in self._streams:
            stream.close()


def run_forked(
    program: str, *words: str, timeout: float, cwd: Path | None = None, environment: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program that ends by itself and return its output."""
    with Forked(program, *words, stderr=True, cwd=cwd, environment=environment) as process:
        out, err = process.communicate(timeout)
        return subprocess.CompletedProcess((program, *words), process.wait(), out, err)


def _pipe() -> tuple[IO[str], int]:
    reading, writing = os.pipe()
    return os.fdopen(reading), writing


class _Descriptors:
    """File descriptors that are passed to another process."""

    def __init__(self, *numbers: int) -> None:
        self._numbers = numbers

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _detach, tuple(reduction.DupFd(number) for number in self._numbers)


def _detach(*passed: Any) -> tuple[int, ...]:
    return tuple(each.detach() for each in passed)


def _run_program(
    program: str, words: tuple[str, ...], cwd: Path, environment: dict[str, str], streams: tuple[int, ...]
) -> None:
    """Run the program in the forked process."""
    os.chdir(cwd)
    # Descriptors 1 and 2 become the pipes, as a shell would arrange it.
    for number, given in enumerate(streams, 1):
        os.dup2(given, number)
        os.close(given)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [program, *words]
    from tests.programs.ports import select_ports

    select_ports()
    if program == "nserver":
        from nserver_emu.cli import main
    else:
        from nclient.cli.main import main
    with contextlib.suppress(BrokenPipeError):
        sys.exit(main())
