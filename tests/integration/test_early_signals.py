"""Signals at a program that is still starting, sent when it has imported a given module."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from nclient.common import INTERRUPTED
from nclient.common.process import ExitCode

TIMEOUT_S = 60.0
NOMAD = ("-m", "nclient.cli", "state", "sim:", "--watch")
NSERVER = ("-m", "nserver_emu", "--port", "0")
MARK = "import time:"
"""Begin of the lines in which Python reports imported modules."""


@contextmanager
def starting(words: tuple[str, ...], module: str) -> Iterator[subprocess.Popen[str]]:
    """Start a program and yield it when it has imported the module."""
    # Coverage would import the modules earlier, and is not written at an immediate exit.
    plain = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    with subprocess.Popen(
        [sys.executable, *words], env=plain | {"PYTHONPROFILEIMPORTTIME": "1"},
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            assert process.stderr is not None
            assert any(line.split("|")[-1].strip() == module for line in process.stderr), f"{module} is not imported"
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(
    ("words", "module"),
    [
        *((NOMAD, module) for module in ("argparse", "nclient.cli.main", "construct")),
        *((NOMAD, module) for module in ("nclient.connector", "numpy", "nserver_emu.simulation.robot")),
        *((NSERVER, module) for module in ("argparse", "asyncio", "numpy", "nserver_emu.cli")),
    ],
)
def test_sigint_exits_with_130_and_no_traceback(words: tuple[str, ...], module: str) -> None:
    with starting(words, module) as process:
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=TIMEOUT_S)
    # As a shell shows it: Python itself ends by the signal where it arrives between two modules.
    code = process.returncode if process.returncode >= 0 else 128 - process.returncode
    assert (code, out) == (130, "")
    assert [line for line in err.splitlines() if not line.startswith(MARK)] == []


@pytest.mark.parametrize("main", ["nserver_emu.__main__", "nclient.cli.__main__"])
def test_little_is_imported_before_sigint_is_handled(main: str) -> None:
    # Until then Python answers SIGINT by a traceback.
    program = f"import sys; import {main}; print(*(name for name in sys.modules if name.startswith('nclient.')))"
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert set(out.split()) - {main} <= {"nclient.common", "nclient.cli"}


def test_the_exit_code_of_an_interrupt_is_the_documented_one() -> None:
    assert INTERRUPTED == ExitCode.INTERRUPTED


@pytest.mark.parametrize("module", ["argparse", "numpy", "nserver_emu.cli"])
def test_sigusr1_does_not_end_a_starting_daemon(module: str) -> None:
    with starting(NSERVER, module) as process:
        process.send_signal(signal.SIGUSR1)
        assert process.stdout is not None
        assert process.stdout.readline().startswith("listening nserver ")
        process.send_signal(signal.SIGUSR1)
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == 0


@pytest.mark.parametrize("words", [NOMAD, NSERVER])
def test_sigterm_during_imports_ends_the_process(words: tuple[str, ...]) -> None:
    with starting(words, "nclient.common") as process:
        process.terminate()
        process.communicate(timeout=TIMEOUT_S)
    assert process.returncode == -signal.SIGTERM
