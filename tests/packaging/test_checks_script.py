"""The script that runs all checks: exit codes, order of its output, the end by a signal. All programs are stand-ins."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from tests.waiting import wait_until

SCRIPTS = Path(__file__).parents[2] / "scripts"
PROGRAMS = ("pip", "ruff", "mypy", "lint-imports", "pytest", "python")
SYSTEM = ("make", "cc", "c++", "id", "apt-get", "zsh", "fish", "stunnel", "openssl", "ssh", "systemd-analyze", "tshark")
# Each stand-in prints its name, and fails or sleeps if a variable names it.
STAND_IN = """#!/usr/bin/env bash
name=$(basename "$0")
case "$name $*" in
  "id -u") echo 0; exit;;
  *collect-only*) exit;;
  "pytest -n 7"*) name=long;;
  "pytest"*) name=short;;
  "python -m fuzz"*) name=fuzz;;
  "cc "* | "c++ "*) cat >/dev/null; exit;;  # the program to compile; unread, the pipe would fail
  "python"* | "apt-get"*) exit;;
esac
echo "ran $name"
if [ "$name" = "$SLEEPS" ]; then echo $$ >pid; exec sleep 60; fi
[ "$name" != "$FAILS" ] || exit 3
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder with the scripts, and stand-ins for all programs that they start."""
    shutil.copytree(SCRIPTS, tmp_path / "scripts")
    for folder, names in ((".venv/bin", PROGRAMS), ("bin", SYSTEM)):
        (tmp_path / folder).mkdir(parents=True)
        for name in names:
            (tmp_path / folder / name).write_text(STAND_IN)
            (tmp_path / folder / name).chmod(0o755)
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / ".venv" / "installed-dev").touch()
    # Clearly older than the mark: what is installed is up to date.
    os.utime(tmp_path / "pyproject.toml", (0.0, 0.0))
    return tmp_path


def start(checkout: Path, *words: str, fails: str = "", sleeps: str = "") -> subprocess.Popen[str]:
    variables = {"PATH": f"{checkout / 'bin'}:{os.environ['PATH']}", "FAILS": fails, "SLEEPS": sleeps}
    command = [str(checkout / "scripts" / "test"), *words]
    return subprocess.Popen(command, cwd=checkout, env=os.environ | variables, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)


@pytest.mark.parametrize(("fails", "code"), [
    ("", 0), ("ruff", 3), ("mypy", 1), ("lint-imports", 1), ("short", 1), ("long", 1), ("fuzz", 1),
])  # fmt: skip
def test_failure_of_any_part_fails_the_run(checkout: Path, fails: str, code: int) -> None:
    with start(checkout, fails=fails) as script:
        shown, errors = script.communicate(timeout=60)
    assert script.returncode == code, shown + errors
    if fails != "ruff":
        # Every other part runs all the same; the output of those in the background comes in one piece.
        # ruff is first: a style error ends the run before anything long begins.
        ran = [line.removeprefix("ran ") for line in shown.splitlines() if line.startswith("ran ")]
        assert ran == ["ruff", "long", "short", "mypy", "lint-imports", "fuzz"]
    assert ("FAILED" in errors) == (fails in ("mypy", "lint-imports", "fuzz", "short"))


@pytest.mark.parametrize(("fails", "code"), [("", 0), ("mypy", 3), ("short", 3)])
def test_arguments_go_to_pytest_alone(checkout: Path, fails: str, code: int) -> None:
    with start(checkout, "-k", "raycast", fails=fails) as script:
        shown, errors = script.communicate(timeout=60)
    assert script.returncode == code, shown + errors
    assert "ran long" not in shown


@pytest.mark.parametrize("sleeps", ["short", "long"])
def test_signal_ends_both_chains(checkout: Path, sleeps: str) -> None:
    with start(checkout, sleeps=sleeps) as script:
        file = checkout / "pid"
        wait_until(lambda: file.exists() and file.read_text() != "")
        # The whole process group, as Ctrl-C at a terminal does.
        os.killpg(script.pid, signal.SIGTERM)
        script.communicate(timeout=30)
    # A shell reports a process that a signal has ended as 128 plus its number.
    assert script.returncode == 128 + signal.SIGTERM
    wait_until(lambda: not Path("/proc", file.read_text().strip()).exists())
