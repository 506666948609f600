"""Killed servers and full disks, with real processes: data lost, messages, and continued operation."""

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
    """Run a server and yield it with the address of its robot; kill it at the end if it still runs."""
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        found = re.fullmatch(r"listening nserver (\S+)\n", process.stdout.readline())
        assert found, process.communicate()
        try:
            yield process, f"nserver://{found[1]}/1?tm_s=0"
        finally:
            process.kill()


def reading(state: RobotState) -> tuple[float, tuple[float, ...]]:
    assert state.clock_s is not None
    return state.clock_s, (state.x_in, state.y_in, state.steering_rad, *state.sonars_in)


def refresh_many(robot: Robot, times: int) -> list[tuple[float, tuple[float, ...]]]:
    return [reading(robot.refresh()) for _ in range(times)]


def test_restored_server_continues_from_last_autosave(tmp_path: Path) -> None:
    """In lockstep the time in the file shows which requests it includes; two more files were written after `before`."""
    saved = tmp_path / "saved.json"
    options = ["--save", str(saved), "--autosave", "1"]
    with running(*NSERVER, "--noisy", "--seed", "5", *options) as (process, address), connect(address) as robot:
        robot.drive(translation_in_s=4.0, steering_deg_s=20.0)
        before = refresh_many(robot, 20)
        # Three different times of modification: at least two saves after `before`.
        written, end_s = set[int](), time.monotonic() + END_S
        while len(written) < 3:
            assert time.monotonic() < end_s
            if saved.exists():
                written.add(saved.stat().st_mtime_ns)
            time.sleep(0.02)
        after = refresh_many(robot, 30)
        process.kill()
        process.wait(END_S)
    with running(*NSERVER, "--restore", str(saved)) as (_, address), connect(address) as robot:
        # Connecting requests a state, one step after the saved one.
        first = reading(robot.state)
    # The restored clock is one of those after `before`, with the same readings.
    assert first in after
    assert before[-1][0] < first[0]


def test_full_disk_stops_files_but_not_the_server(tmp_path: Path) -> None:
    """Files may first grow to 4 KiB, as on a full disk; then the limit is removed."""
    saved, recorded = tmp_path / "saved.json", tmp_path / "run.log"
    words = [*NSERVER, "--save", str(saved), "--autosave", "1", "--record", str(recorded)]
    # `ulimit -f` limits the size of files: writes fail as on a full disk.
    with running("bash", "-c", f"ulimit -S -f {SMALL_KIB}; exec {shlex.join(words)}") as (process, address):
        assert process.stderr is not None
        with connect(address) as robot:
            refresh_many(robot, 100)
            lines = [process.stderr.readline() for _ in range(2)]
            time.sleep(1.5)  # saving is retried meanwhile
            refresh_many(robot, 10)
            maximum = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            # The limit is removed from outside, as if there was room again.
            resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (maximum, maximum))
            lines.append(process.stderr.readline())
            refresh_many(robot, 10)
        process.send_signal(signal.SIGTERM)
        rest = process.communicate(timeout=END_S)[1]
        assert process.returncode == 0, rest
    full = "File too large; raise the limit on the size of files (ulimit -f)"
    # Each log line begins with 24 characters of time.
    assert sorted(line[24:].rstrip() for line in lines[:2]) == [
        f"ERROR {recorded}: no longer recorded; the run goes on, what was written can be read: {full}, "
        "and begin another recording",
        f"ERROR not saved: {saved}: cannot be written: {full}; the run goes on, and it is tried again each time",
    ]
    assert lines[2][24:] == f"WARNING {saved}: saved again\n"
    assert "saved" not in rest
    assert "recorded" not in rest


def test_full_disk_at_exit_sets_exit_code(tmp_path: Path) -> None:
    words = [*NSERVER, "--save", str(tmp_path / "saved.json")]
    with running("bash", "-c", f"ulimit -S -f {SMALL_KIB}; exec {shlex.join(words)}") as (process, _):
        process.send_signal(signal.SIGTERM)
        lines = process.communicate(timeout=END_S)[1]
    assert process.returncode == 1
    assert lines.startswith(f"nserver: {tmp_path}/saved.json: cannot be written: File too large")
    assert list(tmp_path.iterdir()) == []


def test_unwritable_stdout_does_not_end_server(tmp_path: Path) -> None:
    """With standard output on a full disk, the address is logged and clients are served."""
    command = ["bash", "-c", f"exec {shlex.join(NSERVER)} >/dev/full"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, cwd=tmp_path) as process:
        assert process.stderr is not None
        try:
            lines = process.stderr.readline()
            found = re.search(r"stdout cannot be written: No space left on device; .* listening nserver (\S+)\n", lines)
            assert found, lines
            with connect(f"nserver://{found[1]}/1?tm_s=0") as robot:
                refresh_many(robot, 3)
        finally:
            process.send_signal(signal.SIGTERM)
            rest = process.communicate(timeout=END_S)[1]
    assert (process.returncode, rest) == (0, "")


@pytest.mark.parametrize("log", ["2>/dev/full", "2>&-"], ids=["full", "closed"])
def test_unwritable_log_does_not_end_server(log: str) -> None:
    with running("bash", "-c", f"exec {shlex.join(NSERVER)} -vv {log}") as (process, address):
        with connect(address) as robot:
            refresh_many(robot, 3)
        process.send_signal(signal.SIGTERM)
        assert process.wait(END_S) == 0
