"""Run every command and program of the guides as a user would: real processes, real sockets, real time.

Port 7019 and the cable /dev/ttyUSB0 are replaced by a free port and by the serial line of an emulated robot. Blocks
in the language `console` are for other machines and are not run. `scripts/run` is tested with the README.
"""

from __future__ import annotations

import contextlib
import re
import shlex
import shutil
import signal
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, ROOT, code_blocks, command_lines, run
from tests.programs.forked import Forked

NOT_RUN = ("scripts/run", ". .venv/bin/activate")


def commands(page: str) -> list[str]:
    lines = [line for line in command_lines(page) if line not in NOT_RUN]
    assert lines
    return lines


@contextlib.contextmanager
def daemon(command: str, *more: str) -> Iterator[str]:
    """Run the page's daemon on a free port and yield the port."""
    words = [*shlex.split(command)[1:], "--port", "0", *more]
    with Forked("nserver", *words) as program:
        try:
            # One more line for each serial link.
            port = program.stdout.readline().strip().rpartition(":")[2]
            for _ in range(words.count("--serial-link")):
                assert program.stdout.readline().startswith("listening serial")
            yield port
        finally:
            program.send_signal(signal.SIGTERM)
    assert program.returncode == 0


def test_getting_started(tmp_path: Path) -> None:
    shell, start, *others = commands("start.md")
    assert "x 24.0 in" in run(shell, tmp_path)
    assert start.startswith("nserver ")
    with daemon(start) as port:
        state, localize = [run(command.replace("7019", port), tmp_path) for command in others]
    assert "sonar" in state
    assert re.search(r"2 of 2 waypoints reached", localize)


def test_program_of_getting_started(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = code_blocks("start.md", "python")
    exec(compile(program, "start.md", "exec"), {})
    found = re.fullmatch(r"(\d+) in before the wall, (\d+) in from the start\n", capsys.readouterr().out)
    assert found is not None
    # The program stops in front of the wall of the 290 cm room.
    assert 10 <= int(found[1]) <= 21
    assert int(found[2]) > 10


def test_real_robot(tmp_path: Path) -> None:
    ports, *others = commands("real-robot.md")
    run(ports, tmp_path)
    link = tmp_path / "line"
    with daemon("nserver thesis_room --setup measured", "--serial-link", str(link)):
        outputs = [run(command.replace("/dev/ttyUSB0", str(link)), tmp_path) for command in others]
    doctor, stop, shell, localize = outputs
    assert "FAIL" not in doctor
    assert stop.startswith("stands still")
    # 6 in were driven, with the noise of the measured setup.
    assert re.search(r"x (5\.9|6\.\d) in", shell)
    assert re.search(r"2 of 2 waypoints reached", localize)


def test_faults_and_recordings(tmp_path: Path) -> None:
    (tmp_path / "docs").symlink_to(DOCS)
    doctor, stop, recorded, dumped, replayed = [run(command, tmp_path) for command in commands("faults.md")]
    assert re.search(r"^\w+ +line ", doctor, re.MULTILINE)
    assert stop.startswith("stands still")
    assert "gs" in dumped
    assert "pose" in recorded
    assert replayed == recorded


def sonars(output: str) -> list[float]:
    """Return the sixteen sonars that `nomad state` or the shell prints, inf where there is no echo."""
    (line,) = re.findall(r"^sonar +(.*?) in,", output, re.MULTILINE)
    return [float(reading.replace("-", "inf")) for reading in line.split()]


def test_sensors_and_noise(tmp_path: Path) -> None:
    everything, ideal, measured, at_4_ms, at_60_ms, laser = [run(line, tmp_path) for line in commands("sensors.md")]
    for part in ("infrared", "bumpers", "compass", "battery", "clock"):
        assert re.search(rf"^{part} ", everything, re.MULTILINE)
    # 1. Without noise all sonars have an echo.
    assert max(sonars(ideal)) < 255
    # 2. With measured noise those that point squarely at a wall have one, and those at 45 degrees may have one.
    with_echo = {number for number, reading in enumerate(sonars(measured)) if reading < 255}
    assert {0, 4, 8, 12} <= with_echo <= {0, 2, 4, 6, 8, 10, 12, 14}
    # 3. At 4 ms between sonars echoes of one sonar reach the next one: the readings are far too small.
    assert sonars(at_4_ms)[:2] == [12, 12]
    # 4. At 60 ms they do not.
    assert all(91 <= reading <= 96 for reading in sonars(at_60_ms)[:2])
    assert re.search(r"laser +2 readings, in: \([^,)]+(, [^,)]+){3}\)", laser)


def test_program_of_sensors_is_reproducible(capsys: pytest.CaptureFixture[str]) -> None:
    (program,) = code_blocks("sensors.md", "python")
    exec(compile(program, "sensors.md", "exec"), {})
    first, again, other = [line.partition(": ")[2] for line in capsys.readouterr().out.splitlines()]
    assert first == again != other
    assert all(line.startswith("encoders 60.0 in, true ") for line in (first, other))


def test_localization(tmp_path: Path) -> None:
    outputs = [run(line, tmp_path) for line in commands("localization.md")]
    rays, cones, overconfident, figures, found, worn = outputs
    for output in (rays, cones, overconfident, worn):
        assert re.search(r"2 of 2 waypoints reached", output)
    assert re.search(r"1 of 1 waypoints reached", found)
    assert re.search(r"DEGRADED: .*slipped", overconfident)
    assert "DEGRADED" not in rays
    # NEES of a consistent filter is 3 on average, the dimension of the pose.
    assert [float(nees) < 5.5 for nees in re.findall(r"NEES, mean +([\d.]+)", figures)] == [True, True]


def test_c_program(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "clib", tmp_path / "clib", ignore=shutil.ignore_patterns("build"))
    (program,) = code_blocks("c-programs.md", "c")
    (tmp_path / "hello.c").write_text(program)
    make, compiled, started = commands("c-programs.md")
    run(make, tmp_path)
    run(compiled, tmp_path)
    # The program needs a server, which the text names.
    (start,) = re.findall(r"^With `(nserver [^`]+)` running:$", (DOCS / "c-programs.md").read_text(), re.MULTILINE)
    with daemon(start) as port:
        assert run(started.replace("7019", port), tmp_path) == "at 240, 0 tenths of an inch\n"



def test_citation_has_this_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {project['version']}\n" in citation
    assert f"\nlicense: {project['license']}\n" in citation
    for key in ("cff-version", "message", "title", "authors"):  # required by the format
        assert re.search(rf"^{key}:", citation, re.MULTILINE)
