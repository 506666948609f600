"""Every command of docs/window.md, in its order, on one daemon: real processes, a real page.

Rules: nothing is added to a command but where this machine's free ports are; the daemon's time goes faster. A runtime
folder of the test's own is the user's, so that daemon and `nserver ctl` meet where they do when nobody says.
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs" / "window.md").read_text(encoding="utf-8")
LINES = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
START, *COMMANDS = LINES
SEEKS = "nomad localize nserver://localhost:7019/1 --map thesis_room --start unknown --stay"


@dataclass(frozen=True)
class Here:
    """What the page's places are here: a folder, an environment in which programs are found, and words instead."""

    folder: Path
    environment: dict[str, str]
    places: dict[str, str]


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Here]:
    folder = tmp_path_factory.mktemp("w")  # a short path: a Unix socket's has about a hundred bytes
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    environment = os.environ | {"PATH": path, "XDG_RUNTIME_DIR": str(folder)}
    start = shlex.split(START.replace("--viewer", "--viewer 0 --port 0 --speed 4"), comments=True)
    with subprocess.Popen(start, stdout=subprocess.PIPE, text=True, env=environment) as daemon:
        assert daemon.stdout is not None
        try:
            told = dict(daemon.stdout.readline().split()[1:] for _ in range(2 + ("--control" in start)))
            places = {"7019": told["nserver"].rpartition(":")[2], "http://127.0.0.1:7080/?token=...": told["viewer"]}
            yield Here(folder, environment, places)
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


def run(here: Here, command: str, most_s: float = 120) -> str:
    for there, place in here.places.items():
        command = command.replace(there, place)
    done = subprocess.run(["bash", "-c", command], cwd=here.folder, env=here.environment, capture_output=True,
                          text=True, timeout=most_s, check=False)  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


def test_the_page_begins_with_its_daemon() -> None:
    assert START.startswith("nserver thesis_room --noisy --viewer")
    assert len(COMMANDS) == 6


@pytest.mark.parametrize("command", [line for line in COMMANDS if "--stay" not in line])
def test_a_command_of_the_page_runs(command: str, page: Here) -> None:
    run(page, command)


def test_a_localizer_that_stays_goes_on_until_it_is_stopped(page: Here) -> None:
    (command,) = [line for line in COMMANDS if "--stay" in line]
    assert command.startswith(SEEKS)
    told = run(page, f"timeout --signal INT 5 {command} || test $? = 124 -o $? = 130")
    assert "LOST" in told or "OK" in told
