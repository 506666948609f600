"""A program that is forked behaves as one that a shell begins."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from tests.programs import forked
from tests.programs.forked import Forked

pytestmark = pytest.mark.long

PATIENCE_S = 60.0


@pytest.mark.parametrize("words", [("--version",), ("--porrt", "0"), ("no_such_world.toml",), ("--list-worlds",)])
def test_it_says_the_same_with_the_same_code(words: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "nserver_emu", *words]
    shell = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S, check=False)
    fork = forked.done("nserver", *words, timeout=PATIENCE_S)
    assert (fork.returncode, fork.stdout) == (shell.returncode, shell.stdout)
    assert fork.stderr.splitlines()[-1:] == shell.stderr.splitlines()[-1:]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 0), (signal.SIGKILL, -9)])
def test_it_ends_by_a_signal_and_not_before(number: signal.Signals, code: int) -> None:
    with Forked("nserver", "--port", "0") as process:
        assert process.stdout.readline().startswith("listening nserver")
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(0.01)
        assert process.poll() is None
        process.send_signal(number)
        assert process.wait(PATIENCE_S) == process.poll() == code
        process.terminate()


def test_the_environment_is_the_one_of_the_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    for told, code in (("sometimes", 2), ("never", 0)):
        monkeypatch.setenv("NOMAD_COMPILED", told)
        with Forked("nserver", "--port", "0", stderr=True) as process:
            assert process.stdout.readline().startswith("listening") is (code == 0)
            process.terminate()
            out, err = process.communicate(PATIENCE_S)
            assert (process.returncode, out, "NOMAD_COMPILED is 'sometimes'" in err) == (code, "", code == 2)


def test_what_does_not_end_in_time_is_killed() -> None:
    with pytest.raises(subprocess.TimeoutExpired):
        forked.done("nserver", "--port", "0", timeout=0.5)
