"""Traffic rows of connections, also when watching starts in the middle; nothing is decoded without a watcher."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import N150, N200, Model, WireState, serial_wire_state
from nclient.recording.recorder import HANDSHAKE_FIRST, NULL_RECORDER, TCP, ConnectionRecorder, Decoded
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from nserver_emu.viewer.messages import MAX_HEX, MAX_ROWS, TrafficMonitor, parts
from tests.nserver_emu.server.wire_client import WireClient, simulation


class Inner:
    """A recorder that only counts."""

    def __init__(self) -> None:
        self.calls: list[Any] = []

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        self.calls.append(("open", name, line, model.name, robot_id))
        return self

    def to_robot(self, data: bytes) -> None:
        self.calls.append(("to_robot", len(data)))

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        self.calls.append(("to_host", len(data), by_time))

    def record_step(self, dt_s: float) -> None:
        self.calls.append(("stepped", dt_s))

    def record_change(self, what: Mapping[str, Any]) -> None:
        self.calls.append(("changed", dict(what)))

    def record_pace(self, factor: float | None, paused: bool) -> None:
        self.calls.append(("paced", factor, paused))

    def close(self) -> None:
        self.calls.append("close")


def listened(wide: bool = False) -> tuple[TrafficMonitor, WireClient, Session]:
    """A client whose connection is listened to."""
    emulator = Emulator(simulation())
    session = Session(emulator.answer, "client")
    traffic_monitor = TrafficMonitor(
        NULL_RECORDER, lambda _: session.context.wire_state, lambda: emulator.simulation.time_s
    )
    tape = traffic_monitor.open("client", TCP, N150)

    def exchange(data: bytes) -> bytes:
        tape.to_robot(data)
        session.receive(data)
        answered = session.process_requests(max_requests=100)
        tape.to_host(answered)
        return answered

    client = WireClient(exchange, wide=wide)
    return traffic_monitor, client, session


def test_rows_have_readable_text_and_bytes() -> None:
    traffic_monitor, client, _ = listened()
    traffic_monitor.watched = True
    client.ask("connect_robot", 1, 4711)
    client.ask("vm", 100, -50, 0)
    rows = traffic_monitor.rows()
    assert [(row["to"], row["what"]) for row in rows] == [
        ("robot", "connect_robot"), ("host", "simple"), ("robot", "vm"), ("host", "state"),
    ]  # fmt: skip
    assert [row["of"] for row in rows] == ["connect_robot", "connect_robot", "vm", "vm"]
    assert rows[2]["text"] == "vm 100 -50 0"
    # Type 000c (vm), 3 words, 100 = 64, -50 = ffffffce.
    assert rows[2]["hex"].startswith("00 0c 00 03 00 00 00 64 ff ff ff ce")
    assert (rows[2]["size"], rows[2]["who"]) == (16, "client")
    # Velocities are shown in inches and degrees per second.
    assert "v 10 -5 0" in rows[3]["text"]
    assert traffic_monitor.rows() == []
    assert rows[0]["parts"] == [["code", 102], ["pid", 4711], ["robot_id", 1]]
    assert rows[2]["parts"] == [["code", 12], ["translation", 100], ["steering", -50], ["turret", 0]]
    # Only requests have named parts.
    assert rows[3]["parts"] == []


def test_arguments_are_named_or_numbered() -> None:
    outline: Decoded = {"call": "add_obstacle", "args": [3, 6, 6, 7, 6, 7, 7]}
    numbered = [["1", 6], ["2", 6], ["3", 7], ["4", 6], ["5", 7], ["6", 7]]
    assert parts(outline, TCP) == [["code", 50], ["n", 3], *numbered]
    assert parts({"call": "vm", "args": [1, 2, 3]}, HANDSHAKE_FIRST)[:2] == [["code", 5], ["translation", 1]]
    assert parts({"call": "connect_robot", "args": [1]}, TCP) == [["code", 102], ["robot_id", 1]]
    assert parts({"call": "gs", "args": []}, TCP) == [["code", 15]]


@pytest.mark.parametrize("wide", [False, True])
def test_decoding_starts_with_the_connections_wire_state(wide: bool) -> None:
    # 1. Before any page watches, the client chooses a word size and a mask.
    traffic_monitor, client, _ = listened(wide)
    client.ask("connect_robot", 1, 4711)
    client.ask("ct", *(1,) * 44)
    assert traffic_monitor.rows() == []
    # 2. Decoding begins later, with that state: a wrong word size would give no frame.
    traffic_monitor.watched = True
    client.ask("gs")
    _request, reply = traffic_monitor.rows()
    assert reply["what"] == "state"
    assert "sonar 93" in reply["text"]


def test_what_is_too_much_is_counted_and_then_it_goes_on() -> None:
    traffic_monitor, client, _ = listened()
    traffic_monitor.watched = True
    client.ask("connect_robot", 1, 4711)
    for _ in range(MAX_ROWS):
        client.ask("gs")
    # CONNECT and MAX_ROWS queries, two rows each.
    assert len(traffic_monitor.rows()) == MAX_ROWS
    assert traffic_monitor.missed == 2 * (MAX_ROWS + 1) - MAX_ROWS
    client.ask("gs")
    assert [row["what"] for row in traffic_monitor.rows()] == ["gs", "state"]


def test_decoding_starts_between_two_requests() -> None:
    agreed = serial_wire_state(N200)
    wire_state: list[WireState | None] = [None, agreed]
    traffic_monitor = TrafficMonitor(NULL_RECORDER, lambda _: wire_state[0], lambda: 0.0)
    tape = traffic_monitor.open("line", HANDSHAKE_FIRST, N200)
    # 1. The wire state cannot be read yet, as during a request: nothing is decoded.
    frame = codec.encode_serial_request(Call("vm", (100, -50, 0)), agreed)
    tape.to_robot(frame)
    traffic_monitor.watched = True
    tape.to_robot(frame)
    tape.to_host(b"\x01")
    assert traffic_monitor.rows() == []
    # 2. It has one: decoding begins with the next frame.
    wire_state.pop(0)
    tape.to_robot(frame)
    assert [row["text"] for row in traffic_monitor.rows()] == ["vm 100 -50 0"]


def test_bytes_without_a_frame_are_shown_and_truncated() -> None:
    traffic_monitor = TrafficMonitor(NULL_RECORDER, lambda _: None, lambda: 0.0)
    traffic_monitor.watched = True
    # A type that does not exist (7777), with one word and more zeros than are shown.
    traffic_monitor.open("client", TCP, N150).to_robot(b"\x77\x77\x00\x01" + bytes(2 * MAX_HEX))
    row = traffic_monitor.rows()[0]
    assert row["what"] == "error"
    assert "unknown message type" in row["text"]
    # Two digits and a space per byte, without the last space.
    assert len(row["hex"]) == 3 * MAX_HEX - 1


def test_everything_reaches_the_inner_recorder() -> None:
    inner = Inner()
    traffic_monitor = TrafficMonitor(inner, lambda _: None, lambda: 0.0)
    tape = traffic_monitor.open("client", TCP, N150)
    tape.to_robot(b"abc")
    tape.to_host(b"de", by_time=True)
    tape.close()
    traffic_monitor.record_step(0.1)
    traffic_monitor.record_pace(2.0, False)
    traffic_monitor.record_change({"noise": {}})
    traffic_monitor.close()
    assert inner.calls == [
        ("open", "client", TCP, "n150", None), ("to_robot", 3), ("to_host", 2, True), "close", ("stepped", 0.1),
        ("paced", 2.0, False), ("changed", {"noise": {}}), "close",
    ]  # fmt: skip
