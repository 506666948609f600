"""Every command of docs/window.md, in its order, on one daemon: real processes, a real page, real time."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

PAGE = (Path(__file__).parents[2] / "docs" / "window.md").read_text(encoding="utf-8")
LINES = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
START, *COMMANDS = LINES
SEEKS = "nomad localize nserver://localhost:7019/1 --map thesis_room --start unknown --stay"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, dict[str, str]]]:
    """A folder and what the page's places are here: port, token, socket."""
    folder = tmp_path_factory.mktemp("w")
    nserver, *words = shlex.split(START, comments=True)
    assert nserver == "nserver"
    command = [sys.executable, "-m", "nserver_emu", *words, "0", "--port", "0", "--speed", "4"]
    command += ["--control", str(folder / "c")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as daemon:
        assert daemon.stdout is not None
        try:
            told = dict(daemon.stdout.readline().split()[1:] for _ in range(3))
            port = told["nserver"].rpartition(":")[2]
            yield folder, {"7019": port, "http://127.0.0.1:7080/?token=...": told["viewer"],
                           "nserver ctl": f"nserver ctl --control {folder / 'c'}"}  # fmt: skip
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


def run(page: tuple[Path, dict[str, str]], command: str, most_s: float = 120) -> str:
    folder, here = page
    for there, place in here.items():
        command = command.replace(there, place)
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ["PATH"]))
    done = subprocess.run(["bash", "-c", command], cwd=folder, env=os.environ | {"PATH": path}, capture_output=True,
                          text=True, timeout=most_s, check=False)  # fmt: skip
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


def test_the_page_begins_with_its_daemon() -> None:
    assert START.startswith("nserver thesis_room --noisy --viewer")
    assert len(COMMANDS) == 5


@pytest.mark.parametrize("command", [line for line in COMMANDS if "--stay" not in line])
def test_a_command_of_the_page_runs(command: str, page: tuple[Path, dict[str, str]]) -> None:
    run(page, command)
    if "world set" in command:  # the next one is for the room that the page begins with
        run(page, "nserver ctl world set thesis_room")


def test_a_localizer_that_stays_goes_on_until_it_is_stopped(page: tuple[Path, dict[str, str]]) -> None:
    (command,) = [line for line in COMMANDS if "--stay" in line]
    assert command.startswith(SEEKS)
    told = run(page, f"timeout --signal INT 5 {command} || test $? = 124 -o $? = 130")
    assert "LOST" in told or "OK" in told
