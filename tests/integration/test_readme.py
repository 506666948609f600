"""Run every command of the README as a user would: real processes, real sockets, real time.

Port 7019 is replaced by a free one, so that a daemon that is
already running does not interfere.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from tests.waiting import wait_until

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, re.DOTALL)
LINES = [line.split("#")[0].strip() for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]
ACTIVATION = ". .venv/bin/activate"
COMMANDS = [line for line in LINES if line != ACTIVATION]
PROGRAMS = [text for kind, text in BLOCKS if kind == "python"]
NOT_RUN: tuple[str, ...] = ()
MAX_LINES = 150
"""The README stays short enough to be read as a whole."""


def run(command: str, folder: Path) -> str:
    """Return the output of a command, which must succeed; files in `out/` are written below `folder`."""
    words = [str(folder / word) if word.startswith("out/") else word for word in shlex.split(command)]
    activate = Path(sys.executable).parent / "activate"
    line = f". {shlex.quote(str(activate))} && {shlex.join(words)}"
    bash, environment = ["bash", "-c", line], environment_without_venv()
    done = subprocess.run(bash, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def environment_without_venv() -> dict[str, str]:
    """Return the environment without this Python's programs in PATH, so that the activation has to add them."""
    own = str(Path(sys.executable).parent)
    path = os.pathsep.join(folder for folder in os.environ["PATH"].split(os.pathsep) if folder != own)
    return os.environ | {"PATH": path}


@contextlib.contextmanager
def daemon(command: str) -> Iterator[str]:
    """Run a daemon of the README on a free port and yield the port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    words = shlex.split(command.replace("7019", port))
    arguments = [sys.executable, "-m", "nserver_emu", *words[1:]]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        try:
            assert program.stdout.readline() == f"listening nserver 127.0.0.1:{port}\n"
            for _ in range(sum(word in ("--serial-link", "--control") for word in words)):
                assert program.stdout.readline().startswith("listening ")
            yield port
        finally:
            if "--allow-quit" not in words:  # otherwise the test itself ends the daemon
                program.terminate()
    assert program.returncode == 0


def commands(beginning: str) -> list[str]:
    found = [command for command in COMMANDS if command.startswith(beginning)]
    assert found, f"the README has no command {beginning}"
    return found


def test_every_command_has_a_test() -> None:
    tested = ("scripts/run", ".venv/bin/nserver ", "nserver ", "nomad ", "python -m localization.experiments")
    assert ACTIVATION in LINES
    assert [c for c in COMMANDS if c and not c.startswith(tested) and c not in NOT_RUN] == []
    assert len(README.splitlines()) < MAX_LINES


def test_python_example(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = PROGRAMS
    exec(compile(program, "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert re.search(r"encoders: 24\.0, 0\.0 in at \d+\.\d s", out)
    assert re.search(r"wall ahead: \d+ in, or \d\.\d\d m", out)
    assert re.search(r"ground truth: 2\d\.\d, -?\d\.\d in", out)


def test_run_script_draws_a_picture() -> None:
    out = run("scripts/run", ROOT)
    assert re.search(r"2 of 2 waypoints reached", out)
    assert (ROOT / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_second_command_opens_the_page_and_localizes(tmp_path: Path) -> None:
    (command,) = commands(".venv/bin/nserver ")
    words = [*shlex.split(command)[1:], "--port", "0", "--viewer", "0"]
    # A browser that stores the address which it gets.
    (tmp_path / "browser").write_text(f"#!/bin/sh\nprintf %s \"$1\" >{tmp_path}/address.part\n"
                                      f"mv {tmp_path}/address.part {tmp_path}/address\n")  # fmt: skip
    (tmp_path / "browser").chmod(0o755)
    environment = os.environ | {"BROWSER": str(tmp_path / "browser")}
    program = [sys.executable, "-m", "nserver_emu", *words]
    with subprocess.Popen(program, stdout=subprocess.PIPE, text=True, env=environment) as daemon:
        try:
            assert daemon.stdout is not None
            lines = [daemon.stdout.readline() for _ in range(2)]
            wait_until((tmp_path / "address").exists, 20)
            address = (tmp_path / "address").read_text()
            assert lines[1] == f"listening viewer {address}\n"
        finally:
            daemon.terminate()
    assert daemon.returncode == 0


def test_daemon_and_localization(tmp_path: Path) -> None:
    start = next(command for command in commands("nserver ") if "--speed" in command)
    (drive,) = (command for command in commands("nomad localize") if "nserver://" in command)
    with daemon(start) as port:
        out = run(drive.replace("7019", port), tmp_path)
    assert re.search(r"2 of 2 waypoints reached", out)
    assert (tmp_path / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_daemon_in_lockstep() -> None:
    (start,) = (command for command in commands("nserver ") if "--lockstep" in command)
    with daemon(start) as port:
        with connect(f"nserver://localhost:{port}/1") as robot:
            times = [robot.truth().time_s for _ in range(3) if robot.refresh()]
            robot.quit_server()
        assert [round(later - times[0], 6) for later in times] == [0.0, 0.1, 0.2]


def test_localization_in_one_process(tmp_path: Path) -> None:
    (drive,) = (command for command in commands("nomad localize") if "sim:" in command)
    assert re.search(r"3 of 3 waypoints reached", run(drive, tmp_path))


def test_go_and_mission(tmp_path: Path) -> None:
    (go,), (mission,) = commands("nomad go"), commands("nomad mission")
    assert "done at (90." in run(go, tmp_path).replace("(89.", "(90.")
    assert "dock (0, 20) 180 deg" in run(mission, tmp_path)


def test_robot_on_its_cable(tmp_path: Path) -> None:
    folders = re.compile(r"/(?:dev/shm|tmp)/(?=nomad)")
    lines = [folders.sub(f"{tmp_path}/", command) for command in COMMANDS if folders.search(command)]
    start, doctor, drive, faults, stop = lines
    with daemon(start):
        assert "FAIL" not in run(doctor, tmp_path)
        assert re.search(r"2 of 2 waypoints reached", run(drive, tmp_path))
        run(faults, tmp_path)
        run(stop, tmp_path)


def test_list_worlds(tmp_path: Path) -> None:
    assert "thesis_room" in run("nserver --list-worlds", tmp_path)


def test_wire_encode(tmp_path: Path) -> None:
    (encode,) = commands("nomad wire encode")
    assert run(encode, tmp_path).strip() == "01080005640032800000245c"


def test_shell_and_state(tmp_path: Path) -> None:
    (shell,), (state,) = commands("nomad shell"), commands("nomad state")
    assert "x 24.0 in  y 0.0 in" in run(shell, tmp_path)
    assert run(state, tmp_path).startswith("pose        x 0.0 in")


def test_experiment_draws_a_figure(tmp_path: Path) -> None:
    (experiment,) = (command for command in commands("python -m") if "--json" in command)
    result = json.loads(run(f"{experiment} --out {tmp_path}", tmp_path))
    assert result["reached"] == result["seeds"] == 5
    assert (tmp_path / "figure_5.4.png").exists()
