"""A running server with a fault plan on all lines, and its control socket."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import NserverBackend
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.types import N150
from nclient.transports.serial import open_port
from nclient.transports.stream import TcpStream
from nserver_emu import cli
from tests.programs.forked import Forked

GS = Call("gs")
# The first rule acts on the serial line only, the second on all lines.
PLAN = """
[[rule]]
name = "every third reply"
do = "drop"
command = "gs"
every = 3
line = "serial:1"
[[rule]]
name = "no driving"
do = "nak"
command = "vm"
direction = "request"
"""
HANG_UP = """
[[rule]]
do = "hang_up"
command = "gs"
at = 2
"""


class Bench:
    """A server with a pseudo-terminal and a control socket, and its listening addresses."""

    def __init__(self, folder: Path, listening: dict[str, str]) -> None:
        self.folder, self.listening = folder, listening

    @property
    def control(self) -> str:
        return self.listening["control"]

    def ctl(self, *words: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
        assert cli.main(["ctl", "--control", self.control, "--json", *words]) == 0
        lines: dict[str, Any] = json.loads(capsys.readouterr().out)
        return lines

    def over_tcp(self) -> NserverBackend:
        return NserverBackend(TcpStream("127.0.0.1", int(self.listening["nserver"].rpartition(":")[2])))

    def on_its_line(self, timeout_s: float = 5.0) -> DirectBackend:
        return DirectBackend(open_port(str(self.folder / "robot")), N150, timeout_s=timeout_s)


@contextmanager
def bench(folder: Path, *words: str) -> Iterator[Bench]:
    """Run a server with its sockets in a folder; end it cleanly."""
    places = ("--port", "0", "--serial-link", str(folder / "robot"), "--control", str(folder / "s.sock"))
    with Forked("nserver", *places, *words, stderr=True) as daemon:
        try:
            lines = [daemon.stdout.readline().split() for _ in range(3)]
            yield Bench(folder, {kind: place for _, kind, place in lines})
        finally:
            daemon.send_signal(signal.SIGTERM)
            _, err = daemon.communicate(timeout=20)
        assert daemon.returncode == 0, err
        assert "Traceback" not in err
    assert not (folder / "s.sock").exists()


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a short path: that of a Unix socket is limited to about 100 bytes."""
    return tmp_path_factory.mktemp("f")


def answered(backend: DirectBackend | NserverBackend, call: Call, times: int) -> list[bool]:
    found = []
    for _ in range(times):
        try:
            backend.execute(call)
        except (ReplyTimeout, RobotRefused):
            found.append(False)
        else:
            found.append(True)
    return found


@pytest.mark.usefixtures("serial_ports")
def test_fault_plan_on_all_lines_with_counts(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "plan.toml").write_text(PLAN)
    planned = bench(folder, "--faults", str(folder / "plan.toml"))
    # Each reply that the plan drops takes the whole time-out.
    with planned as daemon, closing(daemon.on_its_line(0.6)) as line, closing(daemon.over_tcp()) as tcp:
        # The third and the sixth reply are dropped.
        assert answered(line, GS, 6) == [True, True, False] * 2
        assert answered(tcp, GS, 6) == [True] * 6
        drive = Call("vm", (100, 0, 0))
        assert answered(line, drive, 1) == answered(tcp, drive, 1) == [False]
        counts = daemon.ctl("faults", "counts", capsys=capsys)["counts"]
        assert counts["serial:1"]["every third reply"] == {"seen": 6, "drop": 2}
        assert counts["serial:1"]["no driving"] == counts["nserver"]["no driving"] == {"seen": 1, "nak": 1}
        status = daemon.ctl("status", capsys=capsys)
        # Two dropped replies, and vm refused on both lines.
        assert status["faults"] == {"rules": 2, "struck": {"drop": 2, "nak": 2}}
        assert not status["robots"][0]["moving"]
        assert status["lines"] == {"nserver": daemon.listening["nserver"], "serial:1": str(folder / "robot")}
        assert len(status["connections"]) == 2
        daemon.ctl("faults", "clear", capsys=capsys)
        assert answered(line, GS, 6) == [True] * 6
        assert answered(tcp, drive, 1) == [True]
        assert daemon.ctl("status", capsys=capsys)["robots"][0]["moving"]


@pytest.mark.usefixtures("serial_ports")
def test_fault_plan_at_run_time_disconnects_clients(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "plan.toml").write_text(HANG_UP)
    with bench(folder) as daemon, closing(daemon.on_its_line()) as line, closing(daemon.over_tcp()) as tcp:
        assert answered(line, GS, 1) == answered(tcp, GS, 1) == [True]
        daemon.ctl("faults", "set", str(folder / "plan.toml"), capsys=capsys)
        for backend in (line, tcp):
            # The first gs passes, the second closes the connection, the third finds it closed.
            assert answered(backend, GS, 1) == [True]
            with pytest.raises((ConnectionLost, ReplyTimeout)):
                backend.execute(GS)
            with pytest.raises(ConnectionLost):
                backend.execute(GS)
        for again in (daemon.on_its_line, daemon.over_tcp):
            with closing(again()) as backend:
                assert answered(backend, GS, 3) == [True] * 3
        counts = daemon.ctl("faults", "counts", capsys=capsys)["counts"]
        # Two before the close and three after the reconnection; the count outlives the connection.
        assert counts == {name: {"rule 1": {"seen": 5, "hang_up": 1}} for name in ("nserver", "serial:1")}


def test_control_of_time_and_its_errors(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with bench(folder, "--paused") as daemon:
        before = daemon.ctl("status", capsys=capsys)["time_s"]
        assert daemon.ctl("step", "2.5", capsys=capsys)["time_s"] == pytest.approx(before + 2.5)
        assert daemon.ctl("resume", capsys=capsys)["paused"] is False
        assert daemon.ctl("speed", "max", capsys=capsys)["speed"] == "max"
        saved = folder / "now.json"
        assert daemon.ctl("save", str(saved), capsys=capsys) == {"saved": str(saved)}
        assert saved.exists()
        # A plan for a line that does not exist changes nothing.
        (folder / "bad.toml").write_text("[[rule]]\ndo = 'drop'\nline = 'serial:7'")
        assert cli.main(["ctl", "--control", daemon.control, "faults", "set", str(folder / "bad.toml")]) == 1
        assert "there is no serial:7; the lines are nserver, serial:1" in capsys.readouterr().err
        with closing(daemon.over_tcp()) as tcp:
            assert tcp.execute(GS).slots[0] == 9999


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        (["--faults", "nowhere.toml"], "nowhere.toml: cannot be read"),
        (["--control", "/nowhere/s.sock"], "cannot open the control socket /nowhere/s.sock"),
    ],
)
def test_failure_exits_1(words: list[str], lines: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["--port", "0", *words]) == 1
    assert lines in capsys.readouterr().err


def test_world_file_is_not_a_socket(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--control", "thesis_room"])
    assert "not 'thesis_room'; the world goes before --control" in capsys.readouterr().err


@pytest.mark.usefixtures("serial_ports")
def test_faults_between_gateway_and_robot(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The robot of the gateway is that of another server; requests that the plan rejects never reach it."""
    with bench(folder) as robot:
        own = folder / "gateway"
        own.mkdir()
        (own / "plan.toml").write_text('[[rule]]\ndo = "nak"\ncommand = "pr"\ndirection = "request"\nline = "real"')
        address = f"serial://{folder / 'robot'}?model=n150"
        with bench(own, "--real", address, "--faults", str(own / "plan.toml")) as gateway, \
                closing(gateway.over_tcp()) as tcp:  # fmt: skip
            assert gateway.ctl("status", capsys=capsys)["lines"]["real:1"] == address
            move = Call("pr", (100, 0, 0))
            # The gateway's own plan: the request is answered before it reaches the robot.
            assert answered(tcp, move, 1) == [False]
            assert not robot.ctl("status", capsys=capsys)["robots"][0]["moving"]
            counts = gateway.ctl("faults", "clear", capsys=capsys)["counts"]
            assert counts == {"real:1": {"rule 1": {"seen": 1, "nak": 1}}}
            assert answered(tcp, move, 1) == [True]
            assert robot.ctl("status", capsys=capsys)["robots"][0]["moving"]


def test_default_control_socket_is_in_runtime_dir(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    (folder / "nserver.sock").write_text("no socket")
    assert cli.main(["--port", "0", "--control"]) == 1
    assert f"control socket {folder / 'nserver.sock'}: it exists and is no socket" in capsys.readouterr().err


def test_fault_plan_without_control_socket(folder: Path) -> None:
    (folder / "plan.toml").write_text("[[rule]]\ndo = 'nak'\ncommand = 'vm'\ndirection = 'request'")
    with Forked("nserver", "--port", "0", "--faults", str(folder / "plan.toml")) as daemon:
        port = int(daemon.stdout.readline().rpartition(":")[2])
        with closing(NserverBackend(TcpStream("127.0.0.1", port))) as tcp:
            assert answered(tcp, Call("vm", (100, 0, 0)), 2) == [False, False]
        daemon.terminate()
        assert daemon.wait(20) == 0
