"""The guard around imports: SIGINT exits at once; an ignored SIGINT stays ignored. One thread of BLAS."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from nclient.cli import __main__ as nomad
from nclient.common import exit_on_interrupt, use_one_thread
from nclient.common.process import ExitCode
from nserver_emu import __main__ as nserver


@pytest.fixture(autouse=True)
def _python_handler() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_signal_exits_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def leave(code: int) -> None:
        raise SystemExit(code)

    # os._exit would end the test run.
    monkeypatch.setattr(os, "_exit", leave)
    with pytest.raises(SystemExit, match="130"), exit_on_interrupt():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_failed_import_restores_the_handler() -> None:
    with pytest.raises(ImportError), exit_on_interrupt():
        raise ImportError
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_an_ignored_signal_stays_ignored() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with exit_on_interrupt():
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN


@pytest.mark.parametrize(("given", "used"), [(None, "1"), ("4", "4")])
def test_blas_has_one_thread_unless_the_environment_says_more(
    given: str | None, used: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    use_one_thread()
    assert os.environ["OPENBLAS_NUM_THREADS"] == used


@pytest.mark.parametrize(("script", "command"), [(nomad, "nclient.cli.main"), (nserver, "nserver_emu.cli")])
def test_scripts_run_the_command(script: SimpleNamespace, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    handlers: list[object] = []

    def main() -> int:
        # 1. The script restored Python's handler before it called the command; 2. Ctrl-C in the command is its exit
        # code.
        handlers.append(signal.getsignal(signal.SIGINT))
        if len(handlers) == 2:
            raise KeyboardInterrupt
        return 3

    monkeypatch.setattr(f"{command}.main", main)
    assert script.main() == 3
    assert script.main() == ExitCode.INTERRUPTED
    assert handlers == [signal.default_int_handler] * 2


def test_scripts_handle_signals_before_slow_imports() -> None:
    # Without site, whose files may import anything.
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import nclient.cli.__main__, nserver_emu.__main__\n"
        # Modules that take long to import: Ctrl-C during them would print a traceback.
        "slow = {'typing', 're', 'pathlib', 'argparse', 'logging', 'asyncio', 'numpy'} & set(sys.modules)\n"
        "assert not slow, slow\n"
    )
    root = str(Path(__file__).parents[3])
    subprocess.run([sys.executable, "-S", "-c", program, root], check=True, timeout=60)


def test_the_package_imports_its_names_when_used() -> None:
    program = (
        "import sys, nclient; nclient.BumperHit\n"
        "assert 'nclient.errors' in sys.modules and not {'nclient.connector', 'asyncio'} & set(sys.modules)\n"
        "assert set(nclient.__all__) <= set(dir(nclient)) and not hasattr(nclient, 'other')\n"
        "assert all(hasattr(nclient, name) for name in nclient.__all__)\n"
        "import nclient.connector; assert nclient.connect is nclient.connector.connect\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
