"""Forked programs behave like programs started by a shell."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.programs import forked
from tests.programs.forked import Forked

pytestmark = pytest.mark.long

TIMEOUT_S = 60.0


@pytest.mark.parametrize("words", [("--version",), ("--porrt", "0"), ("no_such_world.toml",), ("--list-worlds",)])
def test_output_and_exit_code_equal_subprocess(words: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "nserver_emu", *words]
    shell = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
    fork = forked.run_forked("nserver", *words, timeout=TIMEOUT_S)
    assert (fork.returncode, fork.stdout) == (shell.returncode, shell.stdout)
    # Usage lines name the program differently; the last line is the error itself.
    assert fork.stderr.splitlines()[-1:] == shell.stderr.splitlines()[-1:]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 0), (signal.SIGKILL, -9)])
def test_process_ends_by_signal(number: signal.Signals, code: int) -> None:
    with Forked("nserver", "--port", "0") as process:
        assert process.stdout.readline().startswith("listening nserver")
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(TIMEOUT_S) == process.poll() == code
        process.terminate()


def test_environment_is_the_current_one(monkeypatch: pytest.MonkeyPatch) -> None:
    # The fork server has an environment of its own: that of the test must be used.
    for value, code in (("sometimes", 2), ("never", 0)):
        monkeypatch.setenv("NOMAD_COMPILED", value)
        with Forked("nserver", "--port", "0", stderr=True) as process:
            assert process.stdout.readline().startswith("listening") is (code == 0)
            process.terminate()
            out, err = process.communicate(TIMEOUT_S)
            assert (process.returncode, out, "NOMAD_COMPILED is 'sometimes'" in err) == (code, "", code == 2)


def test_timeout_kills_the_process() -> None:
    with pytest.raises(subprocess.TimeoutExpired):
        forked.run_forked("nserver", "--port", "0", timeout=0.5)
