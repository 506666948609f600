"""Daemons that are killed, and disks that refuse, as real processes: what is lost, what is said, and who goes on."""

from __future__ import annotations

import contextlib
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import Robot, RobotState, connect

END_S = 60
STEP_S = 0.1
NSERVER = [sys.executable, "-m", "nserver_emu", "--port", "0", "--lockstep", str(STEP_S)]
SMALL_KIB = 4


@contextlib.contextmanager
def running(*command: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A daemon, and the address of its robot; killed at the end where it is still there."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        found = re.fullmatch(r"listening nserver (\S+)\n", process.stdout.readline())
        assert found, process.communicate()
        try:
            yield process, f"nserver://{found[1]}/1?tm_s=0"
        finally:
            process.kill()


def seen(state: RobotState) -> tuple[float, tuple[float, ...]]:
    assert state.clock_s is not None
    return state.clock_s, (state.x_in, state.y_in, state.steering_rad, *state.sonars_in)


def asked(robot: Robot, times: int) -> list[tuple[float, tuple[float, ...]]]:
    return [seen(robot.refresh()) for _ in range(times)]


def test_killed_and_restored_it_has_lost_what_came_after_the_last_autosave_and_no_more(tmp_path: Path) -> None:
    """Time moves by what the client asks, so the file tells how far it was: two of them have been written since."""
    saved = tmp_path / "saved.json"
    keeping = ["--save", str(saved), "--autosave", "1"]
    with running(*NSERVER, "--noisy", "--seed", "5", *keeping) as (process, address), connect(address) as robot:
        robot.drive(translation_in_s=4.0, steering_deg_s=20.0)
        before = asked(robot, 20)
        written, end_s = set[int](), time.monotonic() + END_S
        while len(written) < 3:
            assert time.monotonic() < end_s
            if saved.exists():
                written.add(saved.stat().st_mtime_ns)
            time.sleep(0.02)
        after = asked(robot, 30)
        process.kill()
        process.wait(END_S)
    with running(*NSERVER, "--restore", str(saved)) as (_, address), connect(address) as robot:
        first = seen(robot.state)  # connecting asks for a state: the step after the one that was saved
    assert first in after
    assert before[-1][0] < first[0]


def test_a_disk_that_is_full_costs_the_files_and_nobody_his_robot(tmp_path: Path) -> None:
    """Files may grow to 4 KiB at first, as on a disk that fills up; then as they like, as on one with room again."""
    saved, recorded = tmp_path / "saved.json", tmp_path / "run.log"
    words = [*NSERVER, "--save", str(saved), "--autosave", "1", "--record", str(recorded)]
    with running("bash", "-c", f"ulimit -S -f {SMALL_KIB}; exec {shlex.join(words)}") as (process, address):
        assert process.stderr is not None
        with connect(address) as robot:
            asked(robot, 100)
            said = [process.stderr.readline() for _ in range(2)]
            time.sleep(1.5)  # it is tried again meanwhile
            asked(robot, 10)
            most = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (most, most))
            said.append(process.stderr.readline())
            asked(robot, 10)
        process.send_signal(signal.SIGTERM)
        rest = process.communicate(timeout=END_S)[1]
        assert process.returncode == 0, rest
    full = "File too large; raise the limit on the size of files (ulimit -f)"
    assert sorted(line[24:].rstrip() for line in said[:2]) == [
        f"ERROR {recorded}: no longer recorded; the run goes on, what was written can be read: {full}, "
        "and begin another recording",
        f"ERROR not saved: {saved}: cannot be written: {full}; the run goes on, and it is tried again each time",
    ]
    assert said[2][24:] == f"WARNING {saved}: saved again\n"
    assert "saved" not in rest
    assert "recorded" not in rest


def test_a_full_disk_at_the_end_is_the_exit_code(tmp_path: Path) -> None:
    words = [*NSERVER, "--save", str(tmp_path / "saved.json")]
    with running("bash", "-c", f"ulimit -S -f {SMALL_KIB}; exec {shlex.join(words)}") as (process, _):
        process.send_signal(signal.SIGTERM)
        said = process.communicate(timeout=END_S)[1]
    assert process.returncode == 1
    assert said.startswith(f"nserver: {tmp_path}/saved.json: cannot be written: File too large")
    assert list(tmp_path.iterdir()) == []


def test_output_that_cannot_be_written_ends_no_daemon(tmp_path: Path) -> None:
    """Standard output on a full disk: the address is in the log, and there are clients."""
    command = ["bash", "-c", f"exec {shlex.join(NSERVER)} >/dev/full"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stderr is not None
        try:
            said = process.stderr.readline()
            found = re.search(r"stdout cannot be written: No space left on device; .* listening nserver (\S+)\n", said)
            assert found, said
            with connect(f"nserver://{found[1]}/1?tm_s=0") as robot:
                asked(robot, 3)
        finally:
            process.send_signal(signal.SIGTERM)
            rest = process.communicate(timeout=END_S)[1]
    assert (process.returncode, rest) == (0, "")


@pytest.mark.parametrize("log", ["2>/dev/full", "2>&-"], ids=["full", "closed"])
def test_a_log_that_cannot_be_written_ends_no_daemon(log: str) -> None:
    with running("bash", "-c", f"exec {shlex.join(NSERVER)} -vv {log}") as (process, address):
        with connect(address) as robot:
            asked(robot, 3)
        process.send_signal(signal.SIGTERM)
        assert process.wait(END_S) == 0
