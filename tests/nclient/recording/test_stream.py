"""record=FILE in an address: the run is the same, the file too where time is simulated, and no file is left open."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient import RecordingError, connect
from nclient.connector import Connector
from nclient.protocol.types import N150
from nclient.recording.format import read_recording
from nclient.recording.recorder import ClientRecording
from nclient.transports.stream import Deadline, MemoryStream
from nclient.url import parse_address
from tests.nclient.scripted_server import ScriptedServer, by_script, on_socket


def drive(address: str) -> tuple[int, ...]:
    with connect(address) as robot:
        robot.drive(translation_in_s=5)
        robot.wait_until_still(1)
        return robot.refresh().raw


@pytest.mark.long
def test_recording_is_transparent_and_reproducible(tmp_path: Path) -> None:
    address, files = "sim:thesis_room?noisy=1&seed=3&step_s=0.1", []
    for _ in range(2):
        assert drive(f"{address}&record={tmp_path}/run.log") == drive(address)
        files.append((tmp_path / "run.log").read_bytes())
    # No time of day and no process number is in the file of a simulation.
    assert files[0] == files[1]
    recording = read_recording(tmp_path / "run.log")
    assert recording.header["address"] == address
    assert recording.header["started"] is None
    # A simulation needs no keep-alive; st and disconnect_robot are those of the end of the block.
    assert recording.entries[-1].time_s == pytest.approx(1.5)
    calls = [entry.decoded[0]["call"] for entry in recording.entries if entry.kind == "out"]
    assert calls == ["connect_robot", "ct", "vm", "ws", "gs", "st", "disconnect_robot"]


def test_over_a_socket_time_is_the_clocks(tmp_path: Path) -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, calls=3)) as port, connect(
        f"nserver://127.0.0.1:{port}/1?record={tmp_path}/run.log&model=scout&tm_s=0"
    ) as robot:
        robot.refresh()
    header, *_ = (tmp_path / "run.log").read_text().splitlines()
    # A real connection has the time of day in its header.
    assert '"started":"20' in header
    assert '"model":"scout"' in header
    times = [entry.time_s for entry in read_recording(tmp_path / "run.log").entries]
    assert times == sorted(times)
    assert 0 <= times[0] < 5


def test_unwritable_file_is_reported_at_once(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be written"):
        connect(f"sim:thesis_room?record={tmp_path}/no/run.log")


def test_a_disk_that_is_full_costs_the_recording_and_not_the_run(caplog: pytest.LogCaptureFixture) -> None:
    with connect("sim:thesis_room?record=/dev/full") as robot:
        robot.move(translation_in=5)
        assert robot.wait_until_still(timeout_s=20).x_in == pytest.approx(5, abs=0.2)
    assert [record.message.partition(":")[0] for record in caplog.records] == ["/dev/full"]
    assert "begin another recording" in caplog.text


@pytest.mark.long
def test_a_connection_made_anew_goes_on_in_the_same_file(tmp_path: Path) -> None:
    connector = Connector(parse_address(f"sim:thesis_room?record={tmp_path}/run.log"))
    for _ in range(2):
        connector.open().close()
    entries = read_recording(tmp_path / "run.log").entries
    assert [(entry.kind, entry.connection) for entry in entries if entry.kind in ("open", "close")] == [
        ("open", "1"), ("close", "1"), ("open", "2"), ("close", "2")
    ]


class Silent:
    """A stream that receives one byte for anything sent."""

    def send(self, data: bytes) -> None:
        del data

    def receive(self) -> bytes:
        return b"\x01"

    def close(self) -> None: ...


def test_file_that_cannot_be_reopened_ends_only_the_recording(tmp_path: Path) -> None:
    folder = tmp_path / "gone"
    folder.mkdir()
    recording = ClientRecording(folder / "run.log", "here", "serial", N150)
    recording.wrap(MemoryStream(Silent())).close()
    # The folder is removed between two connections.
    (folder / "run.log").unlink()
    folder.rmdir()
    stream = recording.wrap(MemoryStream(Silent()))
    stream.send(b"\x00")
    assert stream.receive(Deadline.after(0)) == b"\x01"
    stream.close()
    assert not folder.exists()
