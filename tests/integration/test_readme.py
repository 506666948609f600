"""Every command of the README, as a reader would run it: real processes, a real socket, real time.

The test command itself is left out, since it is what runs this. Port 7019 is replaced by a free one, so that a daemon
of the reader's own does not matter.
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

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", README, re.DOTALL)
LINES = [line.split("#")[0].strip() for kind, text in BLOCKS if kind == "sh" for line in text.splitlines()]
ACTIVATION = ". .venv/bin/activate"
COMMANDS = [line for line in LINES if line != ACTIVATION]
PROGRAMS = [text for kind, text in BLOCKS if kind == "python"]
LEFT_OUT = ("scripts/test",)


def run(command: str, folder: Path) -> str:
    """What a command prints; it must succeed. `out/` is written below `folder`."""
    words = [str(folder / word) if word.startswith("out/") else word for word in shlex.split(command)]
    activate = Path(sys.executable).parent / "activate"
    line = f". {shlex.quote(str(activate))} && {shlex.join(words)}"
    bash, environment = ["bash", "-c", line], plain_environment()
    done = subprocess.run(bash, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def plain_environment() -> dict[str, str]:
    """The environment without the folder that this Python's programs are in: the activation must bring it."""
    own = str(Path(sys.executable).parent)
    path = os.pathsep.join(folder for folder in os.environ["PATH"].split(os.pathsep) if folder != own)
    return os.environ | {"PATH": path}


@contextlib.contextmanager
def daemon(command: str) -> Iterator[str]:
    """A daemon of the README on a free port; the port."""
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
            if "--allow-quit" not in words:  # else the test has ended it
                program.terminate()
    assert program.returncode == 0


def commands(beginning: str) -> list[str]:
    found = [command for command in COMMANDS if command.startswith(beginning)]
    assert found, f"the README has no {beginning}"
    return found


def test_nothing_in_the_readme_is_left_untested() -> None:
    tested = ("scripts/run", "nserver ", "nomad ", "python -m localization.experiments")
    assert ACTIVATION in LINES
    assert [c for c in COMMANDS if c and not c.startswith(tested) and c not in LEFT_OUT] == []
    assert len(README.splitlines()) < 150


def test_the_python_example_tells_where_the_robot_is(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = PROGRAMS
    exec(compile(program, "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert re.search(r"encoders: 24\.0, 0\.0 in at \d+\.\d s", out)
    assert re.search(r"wall ahead: \d+ in, or \d\.\d\d m", out)
    assert re.search(r"in truth: 2\d\.\d, -?\d\.\d in", out)


def test_one_command_shows_the_whole_path() -> None:
    out = run("scripts/run", ROOT)
    assert "2 of 2 way-points reached" in out
    assert (ROOT / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_a_daemon_and_a_run_on_it(tmp_path: Path) -> None:
    start = next(command for command in commands("nserver ") if "--speed" in command)
    (drive,) = (command for command in commands("nomad localize") if "nserver://" in command)
    with daemon(start) as port:
        out = run(drive.replace("7019", port), tmp_path)
    assert "2 of 2 way-points reached" in out
    assert (tmp_path / "out" / "run.png").read_bytes().startswith(b"\x89PNG")


def test_a_daemon_in_lockstep() -> None:
    (start,) = (command for command in commands("nserver ") if "--lockstep" in command)
    with daemon(start) as port:
        with connect(f"nserver://localhost:{port}/1") as robot:
            times = [robot.truth().time_s for _ in range(3) if robot.refresh()]
            robot.quit_server()
        assert [round(later - times[0], 6) for later in times] == [0.0, 0.1, 0.2]


def test_a_run_in_one_process(tmp_path: Path) -> None:
    (drive,) = (command for command in commands("nomad localize") if "sim:" in command)
    assert "3 of 3 way-points reached" in run(drive, tmp_path)


def test_a_way_and_a_mission(tmp_path: Path) -> None:
    (go,), (mission,) = commands("nomad go"), commands("nomad mission")
    assert "done at (90." in run(go, tmp_path).replace("(89.", "(90.")
    assert "dock (0, 20) 180 deg" in run(mission, tmp_path)


def test_a_robot_on_its_cable(tmp_path: Path) -> None:
    lines = [command.replace("/tmp/nomad", str(tmp_path / "nomad")) for command in COMMANDS if "/tmp/nomad" in command]
    start, doctor, drive, faults, stop = lines
    with daemon(start):
        assert "FAIL" not in run(doctor, tmp_path)
        assert "2 of 2 way-points reached" in run(drive, tmp_path)
        run(faults, tmp_path)
        run(stop, tmp_path)


def test_the_worlds_are_listed(tmp_path: Path) -> None:
    assert "thesis_room" in run("nserver --list-worlds", tmp_path)


def test_the_wire_tool_says_bytes(tmp_path: Path) -> None:
    (encode,) = commands("nomad wire encode")
    assert run(encode, tmp_path).strip() == "01080005640032800000245c"


def test_a_shell_and_a_look_at_the_state(tmp_path: Path) -> None:
    (shell,), (state,) = commands("nomad shell"), commands("nomad state")
    assert "x 24.0 in  y 0.0 in" in run(shell, tmp_path)
    assert run(state, tmp_path).startswith("pose        x 0.0 in")


def test_a_figure_comes_with_its_numbers(tmp_path: Path) -> None:
    (experiment,) = (command for command in commands("python -m") if "--json" in command)
    result = json.loads(run(f"{experiment} --out {tmp_path}", tmp_path))
    assert result["reached"] == result["seeds"] == 5
    assert (tmp_path / "figure_5.4.png").exists()
