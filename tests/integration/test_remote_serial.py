"""Serial ports of other machines, by Debian's ser2net, and the search for a robot on all ports."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from nclient.cli import doctor
from nclient.cli.main import main
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports import serial as serial_port
from tests.programs.forked import Forked
from tests.waiting import wait_until

SER2NET = shutil.which("ser2net") or "/usr/sbin/ser2net"
needs_ser2net = pytest.mark.skipif(not Path(SER2NET).exists(), reason="ser2net is not installed (apt install ser2net)")


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A simulated Scout on a pseudo-terminal."""
    link = tmp_path_factory.mktemp("line") / "nomad"
    with Forked("nserver", "--port", "0", "--robot", "scout", "--serial-link", str(link)) as daemon:
        try:
            for _ in range(2):
                assert daemon.stdout.readline()
            yield link
        finally:
            daemon.send_signal(signal.SIGTERM)
            daemon.communicate(timeout=30)


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def is_open(port: int) -> bool:
    with socket.socket() as client:
        return client.connect_ex(("127.0.0.1", port)) == 0


@needs_ser2net
@pytest.mark.parametrize(("scheme", "accepter"), [("rfc2217", "telnet(rfc2217),"), ("socket", "")])
def test_drive_through_ser2net(line: Path, tmp_path: Path, scheme: str, accepter: str) -> None:
    port = free_port()
    config = (f"connection: &robot\n  accepter: {accepter}tcp,127.0.0.1,{port}\n"
              f"  connector: serialdev,{line},38400n81,local\n  options:\n    mdns: false\n")
    (tmp_path / "ser2net.yaml").write_text(f"%YAML 1.1\n---\n{config}")
    with subprocess.Popen([SER2NET, "-n", "-c", str(tmp_path / "ser2net.yaml")], stdin=subprocess.DEVNULL,
                          stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as server:
        try:
            wait_until(lambda: is_open(port))
            with connect(f"serial+{scheme}://127.0.0.1:{port}?model=scout") as robot:
                before = robot.read_pose().x_in
                robot.move(translation_in=2)
                assert robot.wait_until_still(20).x_in == pytest.approx(before + 2, abs=0.3)
                assert robot.link is not None
                assert robot.link.answers == robot.link.exchanges
            if scheme == "rfc2217":
                # The rate of the far port is set, too: at another one than the robot's there is no answer.
                with pytest.raises(ReplyTimeout, match="no answer"):
                    connect(f"serial+{scheme}://127.0.0.1:{port}?model=scout&baud=9600&retries=0&timeout_s=0.3")
        finally:
            server.terminate()


def test_no_server_of_the_port() -> None:
    with pytest.raises(ConnectionLost, match="ser2net"):
        connect(f"serial+socket://127.0.0.1:{free_port()}")


@pytest.mark.parametrize("portable", [False, True])
def test_both_kinds_of_port_drive(line: Path, monkeypatch: pytest.MonkeyPatch, portable: bool) -> None:
    monkeypatch.setattr(serial_port, "needs_portable", lambda _: portable)
    with connect(f"serial://{line}?model=scout") as robot:
        before = robot.read_pose().x_in
        robot.move(translation_in=-2)
        assert robot.wait_until_still(20).x_in == pytest.approx(before - 2, abs=0.3)


def test_other_baud_rates_answer_nonsense(line: Path) -> None:
    assert doctor.ask_port(str(line), 9600) == (None, True)
    model, _ = doctor.ask_port(str(line), 38400)
    assert model is not None
    assert model.name == "scout"


def test_doctor_searches_all_ports(
    line: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    monkeypatch.setattr(doctor, "is_listening", lambda *_: False)
    monkeypatch.setattr(serial_port, "ports", lambda: [str(line), str(tmp_path / "ttyUSB7")])
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert f"OK    {line} a scout answers at 38400 baud" in shown
    assert "WARN  " + str(tmp_path / "ttyUSB7") in shown
    assert f"nomad doctor 'serial://{line}?model=scout'" in shown
    # A robot at another rate than any that is tried: only noise.
    monkeypatch.setattr(doctor, "USUAL_BAUDS", (9600,))
    assert main(["doctor", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert (found["addresses"], found["worst"]) == ([], "FAIL")
    assert "not as a Nomad" in found["findings"][0]["seen"]
    monkeypatch.setattr(serial_port, "ports", list)
    assert main(["doctor"]) == 1
    assert "no serial ports" in capsys.readouterr().out
