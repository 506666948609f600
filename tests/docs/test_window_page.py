"""Run every command of docs/window.md in order on one daemon: real processes, a real viewer.

Only ports are replaced, and the daemon's time runs faster. A temporary runtime folder lets the daemon and `nserver ctl`
find each other by default.
"""

from __future__ import annotations

import shlex
import signal
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.docs.pages import command_lines, environment_with_venv, run
from tests.programs.forked import Forked

pytestmark = pytest.mark.long

START, *COMMANDS = command_lines("window.md")


@dataclass(frozen=True)
class Setting:
    """Folder and environment of the commands, and the addresses of the page with their replacements."""

    folder: Path
    environment: dict[str, str]
    addresses: dict[str, str]


@pytest.fixture(scope="module")
def setting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Setting]:
    # Short: the path of a Unix socket has at most about a hundred bytes.
    folder = tmp_path_factory.mktemp("w")
    environment = environment_with_venv() | {"XDG_RUNTIME_DIR": str(folder)}
    start = shlex.split(START.replace("--viewer", "--viewer 0 --port 0 --speed 4"), comments=True)
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True, env=environment) as daemon:
        assert daemon.stdout is not None
        try:
            ports = dict(daemon.stdout.readline().split()[1:] for _ in range(2 + ("--control" in start)))
            port, viewer = ports["nserver"].rpartition(":")[2], ports["viewer"]
            # The page shows the default ports and a token that is not a real one.
            yield Setting(folder, environment, {"7019": port, "http://127.0.0.1:7080/?token=...": viewer})
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


def addressed(setting: Setting, command: str) -> str:
    """Return a command for the daemon of this test."""
    for address, replacement in setting.addresses.items():
        command = command.replace(address, replacement)
    return command


def test_page_begins_with_its_daemon() -> None:
    assert START.startswith("nserver thesis_room --noisy --viewer")
    assert len(COMMANDS) == 6


@pytest.mark.parametrize("command", [line for line in COMMANDS if "--stay" not in line])
def test_command_runs(command: str, setting: Setting) -> None:
    run(addressed(setting, command), setting.folder, setting.environment)


def test_localizer_that_stays_runs_until_stopped(setting: Setting) -> None:
    (command,) = [line for line in COMMANDS if "--stay" in line]
    assert command.startswith("nomad localize nserver://localhost:7019/1 --map thesis_room --start unknown --stay")
    program, *words = shlex.split(addressed(setting, command))
    with Forked(program, *words, cwd=setting.folder, environment=setting.environment) as localizer:
        deadline = threading.Timer(300.0, localizer.kill)
        deadline.start()
        # It prints its health once in a second.
        healthy = (line for line in localizer.stdout if "LOST" in line or "OK" in line)
        assert next(healthy, None)
        # Two lines: the localizer goes on after it has found the robot.
        assert next(healthy, None)
        localizer.send_signal(signal.SIGINT)
        localizer.communicate()
        deadline.cancel()
    # 128 + 2: ended by SIGINT.
    assert localizer.returncode == 130
