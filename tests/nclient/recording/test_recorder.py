"""Recorder: traffic in any pieces is cut into frames and decoded, with the clock passed in."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol import codec
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.decode import WireDecoder
from nclient.protocol.replies import Reply
from nclient.protocol.serial_framing import build_frame
from nclient.protocol.types import EVERYTHING, N150, N200, serial_wire_state, tcp_wire_state
from nclient.recording.format import Recording, RecordingWriter, read_recording
from nclient.recording.recorder import NULL_RECORDER, FrameDecoder, Recorder, RecordingStream
from nclient.transports.stream import Deadline, MemoryStream
from tests.nclient.protocol.recorded import LINE_SESSIONS, LP64, SERIAL, TCP, TCP_SESSIONS, exchanges, model_of

GS = codec.encode_tcp_request(Call("gs"))
LINE_GS = codec.encode_serial_request(Call("gs"), serial_wire_state(N150))
STATE = codec.encode_tcp_reply(BY_NAME["gs"], Reply("state", {34: 7}, clock=1500), tcp_wire_state(N150))
LINE_STATE = codec.encode_serial_reply(BY_NAME["gs"], Reply("state", {34: 7}, clock=1500), serial_wire_state(N150))


@pytest.mark.parametrize("session", TCP_SESSIONS)
@pytest.mark.parametrize("piece", [1, 7, 100_000])
# Byte by byte, in pieces of 7, and each message at once.
def test_decoding_in_any_pieces_equals_the_wire_tool(session: str, piece: int) -> None:
    follower, transcript = FrameDecoder("tcp", N150), WireDecoder("tcp", N150)
    for exchange in exchanges(TCP[session], None):
        for data, follow, decode in ((exchange.request, follower.to_robot, transcript.request),
                                   (exchange.reply, follower.to_host, transcript.reply)):
            found = [item for k in range(0, len(data), piece) for item in follow(data[k : k + piece])]
            # The oracle decodes each message as a whole.
            assert found == ([decode(data)] if data else [])


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_recorded_lines(session: str) -> None:
    model = model_of(session)
    follower, transcript = FrameDecoder("serial", model), WireDecoder("serial", model)
    whole = [exchange for exchange in exchanges(SERIAL[session], model) if exchange.request]
    assert len(whole) >= 5
    for exchange in whole:
        assert follower.to_robot(exchange.request) == [transcript.request(exchange.request)]
        reported = transcript.reply(exchange.reply)
        assert [item for item in follower.to_host(exchange.reply) if "error" not in item] == (
            [] if "error" in reported else [reported]
        )


def test_a_client_of_64_bits_is_known_by_its_first_request() -> None:
    follower, transcript = FrameDecoder("tcp", N150), WireDecoder("tcp64", N150)
    # Three bytes do not show the word size yet.
    assert follower.to_robot(bytes.fromhex(LP64["exchanges"][0]["request"])[:3]) == []
    assert follower.clock_s == 0.0
    follower = FrameDecoder("tcp", N150)
    for exchange in LP64["exchanges"]:
        request, reply = bytes.fromhex(exchange["request"]), bytes.fromhex(exchange.get("reply", ""))
        assert follower.to_robot(request) == [transcript.request(request)]
        assert follower.to_host(reply) == ([transcript.reply(reply)] if reply else [])


def test_stray_and_lost_bytes_are_reported() -> None:
    follower = FrameDecoder("serial", N150)
    assert follower.to_robot(b"\xee\xee" + LINE_GS)[0] == {"error": "2 bytes that are no frame"}
    stray, state = follower.to_host(b"\x77" + LINE_STATE)
    assert stray == {"error": "1 bytes that are no frame"}
    assert state["State"][34] == 7
    assert follower.to_host(LINE_STATE[:-5]) == []
    cut, call = follower.to_robot(LINE_GS)
    # The beginning of a reply that never became whole is reported when the next request is sent.
    assert cut == {"error": f"{len(LINE_STATE) - 5} bytes of an answer that never became whole"}
    assert call["call"] == "gs"
    # 1500 ms of the robot's clock.
    assert follower.clock_s == 1.5
    assert "type 99" in FrameDecoder("tcp", N150).to_robot(b"\x00\x63\x00\x00")[0]["error"]


@pytest.mark.parametrize("cut", [0, 4, 11, 13])
def test_the_eleven_bytes_that_come_first(cut: int) -> None:
    hello = build_handshake(Handshake(EVERYTHING, 51)) + build_frame(8)
    follower = FrameDecoder("hello", N200)
    found = follower.to_host(hello[:cut]) + follower.to_host(hello[cut:])
    assert [item["reply"] for item in found] == ["hello", "nak"]


def recorded_by(path: Path, recorder: Recorder) -> Recording:
    recorder.close()
    return read_recording(path)


def test_the_robots_own_clock_where_none_is_handed_in(tmp_path: Path) -> None:
    recorder = Recorder(RecordingWriter(tmp_path / "a.log", {}))
    tape = recorder.open("", "tcp", N150)
    tape.to_robot(GS)
    tape.to_host(STATE)
    tape.to_robot(GS)
    tape.close()
    tape.close()
    found = recorded_by(tmp_path / "a.log", recorder)
    assert [(entry.kind, entry.time_s) for entry in found.entries] == [
        # Without a clock of its own the recorder uses the one in the replies: 1.5 s from the first state on.
        ("open", 0.0), ("out", 0.0), ("in", 1.5), ("out", 1.5), ("close", 1.5)
    ]
    assert found.entries[0].more == {"wire": "tcp", "model": "n150"}


def test_time_that_passed_stands_with_the_entry_that_follows(tmp_path: Path) -> None:
    ticks = iter(range(100))
    recorder = Recorder(RecordingWriter(tmp_path / "a.log", {}), lambda: next(ticks) / 3)
    for step in (0.1, 0.1, 0.05):
        recorder.record_step(step)
    one, two = recorder.open("one", "tcp", N150), recorder.open("two", "serial", N150)
    one.to_robot(GS)
    recorder.record_step(0.2)
    two.to_robot(LINE_GS)
    recorder.record_step(0.4)
    found = recorded_by(tmp_path / "a.log", recorder)
    assert [(entry.kind, entry.connection, entry.more.get("steps")) for entry in found.entries] == [
        # Steps of simulated time are stored with the next entry, equal ones with a count.
        ("open", "one", [[0.1, 2], [0.05, 1]]), ("open", "two", None), ("out", "one", None),
        ("out", "two", [[0.2, 1]]), ("time", "", [[0.4, 1]]),
    ]
    assert [entry.time_s for entry in found.entries[:2]] == [0.0, 0.333333]
    assert found.connections() == ("one", "two")


def test_idle_server_does_not_fill_the_memory(tmp_path: Path) -> None:
    recorder = Recorder(RecordingWriter(tmp_path / "a.log", {}), lambda: 0.0)
    for number in range(1001):
        recorder.record_step(0.01 + number * 1e-6)
    found = recorded_by(tmp_path / "a.log", recorder)
    # 1001 different steps: an entry is written before the list grows without limit.
    assert [len(entry.more["steps"]) for entry in found.entries] == [1000, 1]


class Echo:
    """Returns what it received, once."""

    def __init__(self) -> None:
        self.received = b""

    def send(self, data: bytes) -> None:
        self.received = data

    def receive(self) -> bytes:
        data, self.received = self.received, b""
        return data

    def close(self) -> None:
        self.received = b""


def test_a_recorded_stream_is_the_stream(tmp_path: Path) -> None:
    recorder = Recorder(RecordingWriter(tmp_path / "a.log", {}))
    stream = RecordingStream(MemoryStream(Echo()), recorder.open("", "tcp", N150))
    stream.send(GS)
    assert stream.receive(Deadline.after(1)) == GS
    with pytest.raises(ReplyTimeout):
        stream.receive(Deadline.after(1))
    stream.close()
    stream.close()
    with pytest.raises(ConnectionLost):
        stream.send(b"\x00")
    found = recorded_by(tmp_path / "a.log", recorder)
    assert [(entry.kind, entry.data) for entry in found.entries] == [
        ("open", b""), ("out", GS), ("in", GS), ("close", b"")
    ]


def test_off_is_nothing() -> None:
    tape = NULL_RECORDER.open("a", "tcp", N150)
    tape.to_robot(GS)
    tape.to_host(GS)
    tape.close()
    NULL_RECORDER.record_step(0.1)
    NULL_RECORDER.close()
