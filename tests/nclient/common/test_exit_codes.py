"""The table of exit codes: its page, and each code as a command really ends with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest

from nclient.common.process import ExitCode, in_short

pytestmark = pytest.mark.long

# The interpreter of the tests, whatever scripts the PATH has.
NOMAD = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())"]
NSERVER = [sys.executable, "-m", "nserver_emu"]
# Sleeping for 80000 simulated seconds in steps of 1 ms: the command is busy until the signal.
SHELL = [*NOMAD, "shell", "sim:thesis_room?step_s=0.001", "-c", "State[0]; vm 10 0 0; sleep 80000"]


def test_codes_are_numbers_and_each_is_once() -> None:
    assert [int(code) for code in (ExitCode.DONE, ExitCode.FAILED, ExitCode.USAGE)] == [0, 1, 2]
    assert len({int(code) for code in ExitCode}) == len(ExitCode)
    assert in_short().startswith("0 done, 1 failed, 2 usage, ")


@pytest.mark.parametrize("name", ["SIGHUP", "SIGINT", "SIGPIPE", "SIGTERM"])
def test_above_128_a_code_is_its_signals(name: str) -> None:
    codes = {"SIGHUP": ExitCode.HUNG_UP, "SIGINT": ExitCode.INTERRUPTED, "SIGPIPE": ExitCode.READER_GONE,
             "SIGTERM": ExitCode.TERMINATED}  # fmt: skip
    assert codes[name] == 128 + getattr(signal, name)


@pytest.mark.parametrize(("command", "code"), [
    ([*NOMAD, "state", "sim:thesis_room", "pose"], ExitCode.DONE),
    ([*NSERVER, "--list-worlds"], ExitCode.DONE),
    ([*NSERVER, "ctl", "help"], ExitCode.DONE),
    ([*NOMAD, "state", "nserver://localhost:1"], ExitCode.FAILED),
    ([*NSERVER, "no_such_world.toml"], ExitCode.FAILED),
    ([*NSERVER, "ctl", "--control", "/absent/socket", "status"], ExitCode.FAILED),
    ([*NOMAD, "stat"], ExitCode.USAGE),
    ([*NSERVER, "--porrt", "0"], ExitCode.USAGE),
    ([*NSERVER, "ctl", "statsu"], ExitCode.USAGE),
    # 1 s is not enough for this path.
    ([*NOMAD, "localize", "sim:", "--map", "thesis_room", "--waypoints", "0,0", "60,40", "--time-limit", "1"],
     ExitCode.NOT_REACHED),
], ids=lambda value: value.name if isinstance(value, ExitCode) else " ".join(value[2:5]))  # fmt: skip
def test_a_command_ends_with_its_code(command: list[str], code: ExitCode) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == code, done.stderr
    assert bool(done.stderr) == (code in (ExitCode.FAILED, ExitCode.USAGE))


@pytest.mark.parametrize(("number", "code"), [
    (signal.SIGINT, ExitCode.INTERRUPTED), (signal.SIGTERM, ExitCode.TERMINATED), (signal.SIGHUP, ExitCode.HUNG_UP),
])
def test_a_signal_ends_a_shell_with_its_code(number: signal.Signals, code: ExitCode) -> None:
    """Without coverage, whose lock is never opened again where a signal comes in the middle of its own code."""
    plain = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    with subprocess.Popen(SHELL, stdout=subprocess.PIPE, text=True, env=plain) as process:
        assert process.stdout is not None
        try:
            # The first line of output shows that the command runs.
            assert process.stdout.readline() == "State[0] = 0\n"
            process.send_signal(number)
            assert process.wait(60) == code
        finally:
            process.kill()


def test_sigterm_is_how_a_daemon_is_stopped() -> None:
    with subprocess.Popen([*NSERVER, "--port", "0"], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline().startswith("listening nserver")
        process.terminate()
        assert process.wait(60) == ExitCode.DONE
