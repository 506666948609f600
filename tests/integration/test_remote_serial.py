"""Serial ports of other machines, by Debian's ser2net, and the search for a robot on all ports."""

from __future__ import annotations

import json
import shutil
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from nclient.cli import doctor
from nclient.cli.main import main
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol.types import MODELS
from nclient.transports import serial as serial_port
from nclient.transports.stream import Deadline
from nclient.url import parse_address
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
    # A raw port or one with RFC 2217, which also carries the baud rate.
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
                # Every exchange had its answer: no byte was lost on the detour.
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


@pytest.mark.usefixtures("serial_ports")
def test_both_kinds_of_port_drive(line: Path) -> None:
    with connect(f"serial://{line}?model=scout") as robot:
        before = robot.read_pose().x_in
        # Ahead, where there is room; the tests share the robot.
        robot.move(translation_in=2)
        assert robot.wait_until_still(20).x_in == pytest.approx(before + 2, abs=0.3)


class Talker:
    """A device that sends without a pause."""

    def send(self, data: bytes) -> None:
        pass

    def receive(self, _: Deadline) -> bytes:
        # The begin of a GPS message: bytes, but no frame of a robot.
        return b"$GPGGA"

    def close(self) -> None:
        pass


def test_search_ends_at_a_device_that_never_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port, "open_port", lambda *_: Talker())
    monkeypatch.setattr(doctor, "ANSWER_S", 0.02)
    finding, address = doctor.search_port("/dev/ttyUSB0")
    assert "not as a Nomad" in finding.seen
    assert address == ""


def test_search_leaves_ports_of_other_programs_alone(line: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise AssertionError("opened")

    with line.open("rb", buffering=0):
        # A port that a program uses already must not be opened: on some systems that resets the device.
        monkeypatch.setattr(serial_port, "open_port", fail)
        finding, _ = doctor.search_port(str(line))
    assert "in use by this very program" in finding.seen


def test_search_names_ports_of_windows_as_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "ask_port", lambda *_: (MODELS["n150"], True))
    _, address = doctor.search_port("COM3")
    assert parse_address(address).path == "COM3"


def test_search_beside_an_nserver_shows_both(
    line: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    monkeypatch.setattr(doctor, "is_listening", lambda *_: True)
    monkeypatch.setattr(doctor, "DEFAULT_ADDRESS", "sim:thesis_room")
    monkeypatch.setattr(serial_port, "ports", lambda: [str(line)])
    main(["doctor", "--json", "--exchanges", "2", "--interval", "0"])
    found = json.loads(capsys.readouterr().out)
    assert found["address"] == "sim:thesis_room"
    assert found["addresses"] == [f"serial://{line}?model=scout"]


def serial_threads() -> list[str]:
    return [thread.name for thread in threading.enumerate() if thread.name.startswith("serial socket")]


@pytest.fixture
def silent_server() -> Iterator[tuple[str, socket.socket]]:
    """A server of a raw serial port: its address, and the listening socket."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"socket://127.0.0.1:{server.getsockname()[1]}", server


def test_failed_connect_leaves_no_thread(silent_server: tuple[str, socket.socket]) -> None:
    with pytest.raises(ReplyTimeout):
        connect(f"serial+{silent_server[0]}?retries=0&timeout_s=0.1")
    assert serial_threads() == []


def test_unread_bytes_are_bounded(
    silent_server: tuple[str, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_port, "_MAX_UNREAD", 1000)
    stream = serial_port.PortableSerialStream(silent_server[0])
    far, _ = silent_server[1].accept()
    with far:
        far.sendall(bytes(3000))
    # The far end has closed: all has been read.
    wait_until(lambda: stream._failure is not None)
    assert len(stream.receive(Deadline.after(1))) == 1000
    with pytest.raises(ConnectionLost, match="gone"):
        stream.receive(Deadline.after(1))
    # The socket inside of pyserial, to see that it is closed as well.
    link = vars(stream._port)["_socket"]
    stream.close()
    assert link.fileno() == -1


def test_server_that_reads_nothing_is_lost(
    silent_server: tuple[str, socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(serial_port, "WRITE_TIMEOUT_S", 0.1)
    stream = serial_port.PortableSerialStream(silent_server[0])
    far, _ = silent_server[1].accept()
    with far, pytest.raises(ConnectionLost, match="Write timeout"):
        # More than all buffers hold: the send must end with an error, not wait forever.
        stream.send(bytes(50_000_000))
    stream.close()


def test_other_baud_rates_answer_nonsense(line: Path) -> None:
    # 9600 baud: the pseudo-terminal answers with bytes that are no frames.
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
