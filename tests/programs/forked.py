"""Programs of ours as processes of their own, without the second or two that each takes for its imports.

    with Forked("nserver", "--port", "0") as process: process.stdout.readline()

They are forked from a process that has the imports behind it, one for all tests of a worker: multiprocessing's fork
server. Each has its own command line, environment, sockets, signals and exit code, as when a shell begins it.

Rules: for tests that want a daemon, not for those of how a program is begun or ends, which begin it as a user does
(test_cli.py, test_exit_codes.py, test_readme.py and others). What is asked of it here is what Popen has.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import operator
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from multiprocessing import reduction
from typing import IO, Any, Self

_CONTEXT = multiprocessing.get_context("forkserver")
_CONTEXT.set_forkserver_preload([
    "nserver_emu.cli", "nserver_emu.server.pty", "nserver_emu.viewer.server", "numpy.random",
    "nclient.cli.main", "nclient.cli.bridge", "nclient.cli.doctor", "nclient.cli.play",
    "localization.cli.calibrate", "localization.cli.localize", "localization.cli.mission", "localization.cli.go",
])  # fmt: skip


class Forked:
    """`nserver` or `nomad` with its words. `stdout` is a pipe, and `stderr` where it is asked for."""

    def __init__(self, program: str, *words: str, stderr: bool = False) -> None:
        self.args = (program, *words)
        self.returncode: int | None = None
        self.stdout, out = _pipe()
        self.stderr: IO[str] | None = None
        err = os.dup(2)
        if stderr:
            os.close(err)
            self.stderr, err = _pipe()
        streams = _Descriptors(out, err)
        self._process = _CONTEXT.Process(target=_be, args=(program, words, dict(os.environ), streams), daemon=True)
        self._process.start()
        os.close(out)
        os.close(err)

    @property
    def pid(self) -> int:
        """Its number."""
        assert self._process.pid is not None
        return self._process.pid

    def poll(self) -> int | None:
        """Its exit code, below 0 by a signal; None while it runs."""
        self.returncode = self._process.exitcode
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        """Its exit code; raises TimeoutExpired where it still runs."""
        self._process.join(timeout)
        code = self.poll()
        if code is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return code

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What else it says until it ends, once; killed where it does not in time."""
        with ThreadPoolExecutor(len(self._streams)) as readers:
            said = readers.map(operator.methodcaller("read"), self._streams)
            try:
                self.wait(timeout)
            except subprocess.TimeoutExpired:
                self.kill()
                raise
            out, err = (*said, "")[:2]
        self._close()
        return out, err

    def send_signal(self, number: int) -> None:
        """To one that runs."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """SIGTERM."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """SIGKILL."""
        self.send_signal(signal.SIGKILL)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()
        self.wait()

    @property
    def _streams(self) -> list[IO[str]]:
        return [stream for stream in (self.stdout, self.stderr) if stream]

    def _close(self) -> None:
        for stream in self._streams:
            stream.close()


def done(program: str, *words: str, timeout: float) -> subprocess.CompletedProcess[str]:
    """What one says that ends by itself."""
    with Forked(program, *words, stderr=True) as process:
        out, err = process.communicate(timeout)
        return subprocess.CompletedProcess((program, *words), process.wait(), out, err)


def _pipe() -> tuple[IO[str], int]:
    reading, writing = os.pipe()
    return os.fdopen(reading), writing


class _Descriptors:
    """File descriptors on their way to another process."""

    def __init__(self, *numbers: int) -> None:
        self._numbers = numbers

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return _arrived, tuple(reduction.DupFd(number) for number in self._numbers)


def _arrived(*passed: Any) -> tuple[int, ...]:
    return tuple(each.detach() for each in passed)


def _be(program: str, words: tuple[str, ...], environment: dict[str, str], streams: tuple[int, ...]) -> None:
    """The program, in the process that was forked for it."""
    for number, mark_sent in enumerate(streams, 1):
        os.dup2(mark_sent, number)
        os.close(mark_sent)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [program, *words]
    if program == "nserver":
        from nserver_emu.cli import main
    else:
        from nclient.cli.main import main
    with contextlib.suppress(BrokenPipeError):
        sys.exit(main())
