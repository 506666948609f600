"""The command line of the daemon, in this process and once as a real program."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nserver_emu import cli
from nserver_emu.server.daemon import Daemon
from tests.programs.forked import Forked


def test_the_shipped_worlds_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--list-worlds"]) == 0
    out = capsys.readouterr().out
    for name in ("thesis_room", "several_walls", "centre_vertex"):
        assert re.search(rf"^{name} +\S", out, re.MULTILINE)


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        # The first start touches the wall at x = -12 in, the second is outside of the room.
        (["--start", "-8,0,0,0"], "touches the outline"),
        (["--start", "500,0,0,0"], "outside"),
        (["--start=500,0,0,0"], "outside"),
        (["thesis_rom"], "thesis_room"),
    ],
)
def test_what_cannot_start_says_why_and_exits_1(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(argv) == 1
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("argv", "words"), [
    (["--start", "x"], "a start is X,Y,STEER,TURRET"), (["--start", "1,2,a,b"], "got '1,2,a,b'"),
    (["--real", "foo"], "'foo' is no address: "),
])  # fmt: skip
def test_wrong_usage_exits_with_2(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(argv) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    "argv",
    [["--speed", "0"], ["--speed", "fast"], ["--port", "70000"], ["--seed", "-1"], ["--robot", "r2d2"], ["--bind", ""]],
)
def test_wrong_usage_exits_2(argv: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    # Each is refused by the parser, before anything is opened.
    with pytest.raises(SystemExit) as stop:
        cli.main(argv)
    assert stop.value.code == 2
    assert capsys.readouterr().err.splitlines()[1:] == ["nserver --help lists all options"]


def test_a_wrong_compiler_setting_exits_2_and_lists_values(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("NOMAD_COMPILED", "yes")
    assert cli.main(["--port", "0"]) == 2
    assert capsys.readouterr().err == "nserver: NOMAD_COMPILED is 'yes'; it can be always, crowd, never\n"


def test_a_port_in_use_exits_1(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert cli.main(["--port", str(taken.getsockname()[1])]) == 1
    assert "is another nserver running" in capsys.readouterr().err


def test_a_foreign_address_is_not_blamed_on_the_port(capsys: pytest.CaptureFixture[str]) -> None:
    # 192.0.2.1 is reserved for documentation: no machine has it.
    assert cli.main(["--port", "0", "--bind", "192.0.2.1"]) == 1
    output = capsys.readouterr().err
    assert "cannot listen on 192.0.2.1:0" in output
    assert output.endswith("--bind needs an address of this machine, and ports below 1024 are reserved for root\n")


def test_a_folder_as_save_file_is_reported_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--port", "0", "--save", str(tmp_path)]) == 1
    assert f"{tmp_path}: is a folder: name a file in it" in capsys.readouterr().err


def test_a_pipe_to_save_to_is_refused_at_the_start(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert cli.main(["--port", "0", "--save", str(tmp_path / "pipe"), "--autosave", "1"]) == 1
    assert "regular" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "output"), [
    (["--setup", "ideal", "--noisy"], "argument --noisy: it is --setup noisy, and --setup says ideal: leave one out"),
    (["-noisy", "--setup", "mine.toml"], "and --setup says mine.toml"),
    (["--lockstep", "0.1", "--speed", "3"], "argument --speed: in lockstep time passes with each request"),
    (["--lockstep", "abc"], "argument --lockstep: a step is more than 0 and at most 10 s, not 'abc'"),
    (["--lockstep", "0"], "argument --lockstep: a step is more than 0 and at most 10 s, not '0'"),
])  # fmt: skip
def test_what_would_be_dropped_without_a_word_is_wrong_usage(
    words: list[str], output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(words)
    assert output in capsys.readouterr().err


@pytest.mark.long
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_the_program_prints_its_address_serves_and_stops(ending: signal.Signals) -> None:
    command = [sys.executable, "-m", "nserver_emu", "--port", "0", "--speed", "max", "-v"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        line = re.fullmatch(r"listening nserver 127\.0\.0\.1:(\d+)\n", program.stdout.readline())
        assert line
        with socket.create_connection(("127.0.0.1", int(line[1])), timeout=10) as client:
            client.sendall(codec.encode_tcp_request(Call("connect_robot", (1, 1))))
            # Reply to CONNECT: type 0052, one word, the port.
            assert client.recv(8) == bytes((0, 0x52, 0, 1)) + int(line[1]).to_bytes(4, "big")
        program.send_signal(ending)
        out, err = program.communicate(timeout=20)
    assert (program.returncode, out) == (0, "")
    assert "connected" in err


@pytest.mark.parametrize(("words", "usage"), [(["help"], "nserver [-h]"), (["help", "ctl"], "nserver ctl [-h]")])
def test_help_is_a_word_as_well(words: list[str], usage: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        cli.main(words)
    assert capsys.readouterr().out.startswith(f"usage: {usage}")


def test_help_of_something_else_says_of_what_there_is_help(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(["help", "status"])
    assert capsys.readouterr().err.startswith("nserver: error: help status: it is help alone, or help ctl\n")


def test_ctrl_c_before_it_serves_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(_: list[Path]) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(cli, "read_setups", interrupted)
    assert cli.main(["--port", "0"]) == 130


@pytest.mark.long
def test_ctrl_c_ends_it_where_signals_cannot_be_handled(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """asyncio then cancels what runs."""

    async def cancelled(daemon: Daemon, *_: object) -> None:
        await daemon.close()
        raise asyncio.CancelledError

    monkeypatch.setattr(Daemon, "serve", cancelled)
    assert cli.main(["--port", "0"]) == 0
    assert capsys.readouterr().out.startswith("listening nserver ")


def test_usage_errors_say_what_is_wanted(capsys: pytest.CaptureFixture[str]) -> None:
    wanted = ((["--speed", "MAX"], "a speed is 0.1 to 999, or max, not 'MAX'"), (["--port", "x"], "a port is 0 to"),
              (["--setup", "mesured"], "files that end in .toml; did you mean measured?"))  # fmt: skip
    for argv, words in wanted:
        with pytest.raises(SystemExit):
            cli.main(argv)
        assert words in capsys.readouterr().err


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (["--robots", "60"], "no room for robot"),
        (["--start", "0,0", "--start", "5,0"], "touches robot 1"),
        (["--model-file", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["--setup", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["--model-file", "nowhere.toml", "--robot", "mine"], "nowhere.toml: cannot be read"),
    ],
)
def test_what_hinders_several_robots_or_new_models_exits_1(
    argv: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(argv) == 1
    assert words in capsys.readouterr().err


def test_an_unknown_model_names_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--robot", "skout"])
    assert "no model 'skout'; there are n150, n200, scout; did you mean scout?" in capsys.readouterr().err
    for count in ("0", "1001"):
        with pytest.raises(SystemExit):
            cli.main(["--robots", count])


@pytest.mark.long
def test_a_recorded_daemon_can_be_asked_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "run.log"
    words = ["--noisy", "--lockstep", "0.1", "--port", "0", "--allow-quit", "--record", str(path)]
    with Forked("nserver", *words) as daemon:
        port = int(daemon.stdout.readline().rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=10) as client:
            # CONNECT is a request like the others: four replies in total.
            for call in (Call("connect_robot", (1, 1)), Call("vm", (100, 0, 0)), Call("gs"), Call("quit_server")):
                client.sendall(codec.encode_tcp_request(call))
                client.recv(4096)
    assert cli.main(["--replay", str(path)]) == 0
    assert re.fullmatch(r"4 answers, \d+ bytes as recorded\n", capsys.readouterr().out)
    # Another seed: the first reply with noise differs; the cut line at the end is accepted.
    path.write_text(path.read_text().replace('"seed":0', '"seed":1', 1) + '{"t":')
    assert cli.main(["--replay", str(path)]) == 1
    output = capsys.readouterr()
    assert "as recorded, then not" in output.out
    assert re.search(r"run.log, line \d+: from byte \d+ on", output.err)
    assert cli.main(["--record", str(tmp_path / "no" / "run.log"), "--port", "0"]) == 1
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.long
def test_pages_and_bridges_end_before_the_gateway(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that drives a real robot at Ctrl-C: its robot must still be there."""
    ended: list[str] = []

    def record_end(name: str) -> None:
        original = getattr(cli, name)

        @contextlib.asynccontextmanager
        async def recorded(*args: Any) -> AsyncIterator[Any]:
            async with original(*args) as opened:
                yield opened
            ended.append(name)

        monkeypatch.setattr(cli, name, recorded)

    async def serve(*_: object) -> None: ...

    for name in ("run_gateway", "running_viewer", "running_ros"):
        record_end(name)
    monkeypatch.setattr(Daemon, "serve", serve)
    assert cli.main(["--port", "0"]) == 0
    assert len(ended) == 3
    # The gateway must be the last to end: what ends before it may still send stops to real robots.
    assert ended[-1] == "run_gateway"
