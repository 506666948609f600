"""The old style of the command line, the time's options, saving and restoring: as real programs."""

from __future__ import annotations

import contextlib
import re
import signal
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from nserver_emu import cli
from nserver_emu.cli import as_long_option
from tests.nserver_emu.server.wire_client import WireClient
from tests.programs.forked import Forked

pytestmark = pytest.mark.long

END_S = 20


class Program:
    """A daemon that runs, and a client connected to its robot 1."""

    def __init__(self, process: Forked, port: int) -> None:
        self.process, self.port = process, port
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=END_S)
        self.client = WireClient(self._exchange)
        assert self.client.ask("connect_robot", 1, 1).values == (port,)

    def _exchange(self, data: bytes) -> bytes:
        self._socket.sendall(data)
        # A header of four bytes, type and number of words, then the words.
        head = self._socket.recv(4, socket.MSG_WAITALL)
        return head + self._socket.recv(4 * int.from_bytes(head[2:], "big"), socket.MSG_WAITALL)

    def end(self) -> str:
        """Stop it; return its stderr."""
        self.process.send_signal(signal.SIGTERM)
        _, err = self.process.communicate(timeout=END_S)
        assert self.process.returncode == 0
        return err

    def hang_up(self) -> None:
        """Close the client's socket."""
        self._socket.close()


@contextlib.contextmanager
def program(*words: str) -> Iterator[Program]:
    with Forked("nserver", *words, stderr=True) as process:
        line = re.fullmatch(r"listening nserver 127\.0\.0\.1:(\d+)\n", process.stdout.readline())
        assert line
        started = Program(process, int(line[1]))
        try:
            yield started
            if process.poll() is None:
                started.end()
        finally:
            started.hang_up()
            if process.poll() is None:
                process.kill()


@pytest.mark.parametrize("word", ["-help", "-hel", "-h", "--help"])
def test_help_by_its_first_letters(word: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main([word])
    assert stop.value.code == 0
    assert "robot.setup" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "long"),
    [("-noisy", "--noisy"), ("-n", "--noisy"), ("-p", "--port"), ("-port", "--port"), ("-v", "-v"), ("-vv", "-vv"),
     ("--port", "--port"), ("-5,3", "-5,3"), ("-noisier", "-noisier"), ("-", "-"), ("noisy", "noisy")],
)  # fmt: skip
def test_options_of_the_original_by_their_first_letters(words: str, long: str) -> None:
    # A number with a minus sign, unknown words and words without one are left as they are.
    assert as_long_option(words) == long


def test_the_old_style_with_both_setup_files(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    robot, world = tmp_path / "robot.setup", tmp_path / "world.setup"
    robot.write_text("[robot]\ntype = n200\n[laser]\noffset = 1 2\n")
    world.write_text(f"[server]\nport = {port}\n")
    with program("-n", str(robot), str(world)) as started:
        assert started.port == port
        # An arm: the robot is a N200. A velocity between 0 and 10 in/s: noise, hence ramps.
        assert started.client.ask("arm_mv", 0, 0, 0, 0).kind == "special"
        assert 0 < started.client.ask("vm", 100, 0, 0).slots[38] < 100
        assert "[laser] offset of the setup file is read and has no effect" in started.end()
    with program("-noisy", "-po", "0", str(robot), str(world)) as started:
        assert started.port != port


@pytest.mark.parametrize(
    ("words", "expected"),
    [(["nothing.setup"], "nothing.setup: cannot be read"), (["--restore", "nothing.json"], "nothing.json: cannot be")],
)
def test_files_that_are_not_there_exit_1(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(words) == 1
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    "words", [["a.setup", "b.setup", "c.setup"], ["thesis_room", "several_walls"], ["--lockstep", "0"],
              ["--lockstep", "11"], ["-x"]]
)  # fmt: skip
def test_wrong_usage_of_files_and_time_exits_2(words: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(words)
    assert stop.value.code == 2


def test_a_paused_start_that_clients_may_step() -> None:
    with program("--port", "0", "--paused", "--allow-control") as started:
        assert started.client.ask("gs").slots[0] == 0
        # Verb 4 steps by 250 ms.
        assert started.client.ask("sim_control", 4, 250).values == (1, 250, 10, 1)
    with program("--port", "0", "--paused") as started:
        assert started.client.ask("sim_control", 2, 0).values == (5,)
        assert "--allow-control" in started.end()


def test_a_setup_of_ones_own(tmp_path: Path) -> None:
    setup = tmp_path / "room12.toml"
    setup.write_text('base = "measured"\nsonar.dead = [3, 11]\n', encoding="utf-8")
    with program("--port", "0", "--lockstep", "0.1", "--setup", str(setup)) as started:
        slots = started.client.ask("gs").slots
        assert [number for number in range(16) if slots[17 + number] == 0] == [3, 11]
        assert 0 < started.client.ask("vm", 100, 0, 0).slots[38] < 100


def test_quit_ends_the_program_where_it_is_allowed() -> None:
    with program("--port", "0", "--allow-quit") as started:
        assert started.client.ask("quit_server").values == (0,)
        assert started.process.wait(END_S) == 0


def test_a_saved_simulation_is_restored_in_another_process(tmp_path: Path) -> None:
    saved, later = tmp_path / "saved.json", tmp_path / "later.json"
    time = ["--port", "0", "--lockstep", "0.1"]
    with program(*time, "--noisy", "--seed", "3", "--save", str(saved)) as started:
        started.client.ask("vm", 50, 100, -30)
        for _ in range(20):
            started.client.ask("gs")
        started.end()
    with program(*time, "--restore", str(saved), "--save", str(later)) as started:
        first = [started.client.ask("gs") for _ in range(30)]
        # SIGUSR1 saves at once, here after 21 + 30 requests.
        started.process.send_signal(signal.SIGUSR1)
        while not later.exists():
            started.client.ask("sim_truth")
        started.process.kill()
        started.process.wait(END_S)
    with program(*time, "--restore", str(saved)) as started:
        assert [started.client.ask("gs") for _ in range(30)] == first
    with program(*time, "--restore", str(later)) as started:
        # Saved after 5.1 s, plus the step of this request.
        assert started.client.ask("gs").clock == 5200
    # vm and 20 times gs took 2.1 s.
    assert first[0].clock == 2200
    assert first[0].slots[38] > 0


def test_an_end_that_cannot_be_saved_says_so_and_exits_1(tmp_path: Path) -> None:
    with program("--port", "0", "--save", str(tmp_path / "nowhere" / "saved.json")) as started:
        assert started.process.stderr is not None
        # At once, not when a day's run is over.
        assert "there is no folder" in started.process.stderr.readline()
        started.process.send_signal(signal.SIGUSR1)
        assert "not saved" in started.process.stderr.readline()
        started.process.send_signal(signal.SIGTERM)
        _, err = started.process.communicate(timeout=END_S)
        assert started.process.returncode == 1
    assert "cannot be written" in err
