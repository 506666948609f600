"""nomad dump: a recording or bare bytes, for people and as objects."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from nclient import connect
from nclient.cli import main
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, N150, serial_wire_state
from nclient.recording.format import Entry, RecordingWriter, format_entry, format_frame

Dump = Callable[..., tuple[int, list[str], str]]


@pytest.fixture
def dump(capsys: pytest.CaptureFixture[str]) -> Dump:
    def run(*words: str) -> tuple[int, list[str], str]:
        code = main.main(["dump", *words])
        out, err = capsys.readouterr()
        return code, out.splitlines(), err

    return run


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A recorded run."""
    # Lockstep: each request advances the simulation by 0.1 s, so that all times are exact.
    with connect(f"sim:thesis_room?step_s=0.1&record={tmp_path}/run.log") as robot:
        robot.drive(translation_in_s=5)
        robot.read_sonars()
        robot.read_bumpers()
        robot.truth()
    return tmp_path / "run.log"


def test_a_run_line_by_line(dump: Dump, path: Path) -> None:
    code, lines, err = dump(str(path))
    assert (code, err) == (0, "")
    calls = [line.split(" > ")[1].split()[0] for line in lines if " > " in line]
    # connect() sends connect_robot, ct; closing sends st and disconnect_robot. truth() is sim_truth.
    assert calls == ["connect_robot", "ct", "vm", "get_sn", "get_bp", "sim_truth", "st", "disconnect_robot"]
    assert lines[0] == "     0.000  1 -- open tcp n150"
    assert lines[-1].endswith("1 -- close")
    (driving,) = (line for line in lines if " v 5 0 0 " in line and line.startswith("     0.200"))
    assert " < state x 0 y 0 steer 0 turret 0 v 5 0 0 sonar 93 " in driving
    assert driving.endswith("volts 12.0 12.0")
    assert any(line.startswith("     0.300  1 < sonar 93 ") and line.endswith("clock 0.3") for line in lines)
    assert any(line.endswith("< bumper 0x0 clock 0.4") for line in lines)
    assert any(" < truth 1 " in line for line in lines)


def test_one_command_with_its_bytes(dump: Dump, path: Path) -> None:
    _, lines, _ = dump(str(path), "--filter", "get_bp", "--bytes")
    # Types 0x23 = 35 and 0x57 = 87, get_bp and its reply, behind int16 type and uint16 count.
    assert [line.partition("1 ")[2][:20] for line in lines] == [
        "> get_bp", "> [00 23 00 00]", "< bumper 0x0 clock 0", "< [00 57 00 02 00 00"
    ]
    assert dump(str(path), "--filter", "pr")[1] == []
    assert "no command 'fly'" in dump(str(path), "--filter", "fly")[2]


def test_objects(dump: Dump, path: Path) -> None:
    _, lines, _ = dump(str(path), "--json", "--connection", "1")
    found = [json.loads(line) for line in lines]
    assert {"t": 0.1, "connection": "1", "to": "robot", "call": "vm", "args": [50, 0, 0]} in found
    code, _, err = dump(str(path), "--connection", "9")
    assert (code, "no connection '9'; there are 1" in err) == (1, True)


def test_one_of_two_connections(dump: Dump, tmp_path: Path) -> None:
    writer = RecordingWriter(tmp_path / "two.log", {})
    for name in "ab":
        writer.write(Entry(0.0, "open", name, more={"wire": "tcp", "model": "scout"}))
    writer.close()
    assert dump(str(tmp_path / "two.log"), "--connection", "b")[1] == ["     0.000  b -- open tcp scout"]


def test_incomplete_recording_is_shown_and_reported(dump: Dump, path: Path) -> None:
    whole = dump(str(path))[1]
    # The last line lacks its end, as after a crash of the recording program.
    path.write_text(path.read_text()[:-5])
    code, lines, err = dump(str(path))
    assert (code, lines) == (1, whole[:-1])
    assert "cut short" in err


def test_bare_bytes(dump: Dump, tmp_path: Path) -> None:
    capture = tmp_path / "capture.bin"
    vm = codec.encode_serial_request(Call("vm", (100, -50, 0)), serial_wire_state(N150))
    # One byte of noise before the frame.
    capture.write_bytes(b"\xee" + vm)
    assert dump(str(capture), "--line", "serial")[1] == [
        "     0.000  > ! 1 bytes that are no frame", "     0.000  > vm 100 -50 0"
    ]
    state = codec.encode_serial_reply(
        BY_NAME["gs"], Reply("state", {34: 15, 43: 900}, clock=5), serial_wire_state(N150)
    )
    capture.write_bytes(state)
    (line,) = dump(str(capture), "--line", "serial", "--from-robot", "--model", "n150")[1]
    assert line.startswith("     0.000  < state x 1.5 y 0 ")
    assert " compass 90 clock 0.005 " in line
    assert json.loads(dump(str(capture), "--line", "serial", "--from-robot", "--json")[1][0])["t"] == 0.0
    assert "cannot be read" in dump(str(tmp_path / "none"), "--line", "tcp")[2]
    assert "no recording" in dump(str(capture))[2]


def test_a_year_of_frames_in_words() -> None:
    # Each kind of frame once: only the fields that are set are shown.
    state: list[int | None] = [None] * 45
    nothing = {"State": state, "Laser": None, "clock": None, "volt_cpu": None, "volt_motor": None}
    assert format_frame({"reply": "state", **nothing}) == "state"
    assert format_frame({"reply": "hello", "mask": [1], "laser_mode": 51}) == "hello"
    assert format_frame({"reply": "error", "values": [4], **nothing}) == "error 4"
    assert format_frame({"reply": "laser", **nothing, "Laser": [2, 1, 2, 3, 4]}) == "laser 2 readings"
    assert format_frame({"reply": "laser", **nothing, "Laser": [0]}) == "laser"
    seen = {**nothing, "State": [None, *range(16), *[None] * 28]}
    assert format_frame({"reply": "infrared", **seen}).startswith("infrared 0 1 2 3")
    ct = {"call": "ct", "args": [], "mask": list(EVERYTHING.smask)}
    assert format_frame(ct) == "ct mask " + "".join(map(str, EVERYTHING.smask))
    assert (
        format_frame({"call": "special_request", "args": [1, 2], "packet_type": 9})
        == "special_request 1 2 (packet_type 9)"
    )
    assert list(format_entry(Entry(1.0, "time"))) == []
    assert list(format_entry(Entry(1.0, "in", "a"), with_bytes=True)) == []
    assert list(format_entry(Entry(1.0, "close"))) == ["     1.000  -- close"]
