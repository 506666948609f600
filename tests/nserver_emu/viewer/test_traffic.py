"""Listening in: what is told of a connection, also of one taken up in the middle, and nothing where nobody looks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import N150, N200, Model
from nclient.protocol.wire_state import WireState, serial_wire_state
from nclient.recording.recorder import HANDSHAKE_FIRST, OFF, TCP, ConnectionRecorder, Decoded
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from nserver_emu.viewer.traffic import MOST_HEX, MOST_ROWS, Listening, parts
from tests.nserver_emu.server.wire_client import WireClient, simulation


class Inner:
    """A recorder that only counts."""

    def __init__(self) -> None:
        self.told: list[Any] = []

    def open(self, name: str, line: str, model: Model, robot_id: int | None = None) -> ConnectionRecorder:
        self.told.append(("open", name, line, model.name, robot_id))
        return self

    def to_robot(self, data: bytes) -> None:
        self.told.append(("to_robot", len(data)))

    def to_host(self, data: bytes, by_time: bool = False) -> None:
        self.told.append(("to_host", len(data), by_time))

    def stepped(self, dt_s: float) -> None:
        self.told.append(("stepped", dt_s))

    def changed(self, what: Mapping[str, Any]) -> None:
        self.told.append(("changed", dict(what)))

    def paced(self, factor: float | None, paused: bool) -> None:
        self.told.append(("paced", factor, paused))

    def close(self) -> None:
        self.told.append("close")


def listened(wide: bool = False) -> tuple[Listening, WireClient, Session]:
    """A client whose connection is listened to."""
    emulator = Emulator(simulation())
    session = Session(emulator.answer, "client")
    listening = Listening(OFF, lambda _: session.context.wire_state, lambda: emulator.simulation.time_s)
    tape = listening.open("client", TCP, N150)

    def exchange(data: bytes) -> bytes:
        tape.to_robot(data)
        session.receive(data)
        answered = session.process_requests(max_requests=100)
        tape.to_host(answered)
        return answered

    client = WireClient(exchange, wide=wide)
    return listening, client, session


def test_requests_and_replies_are_told_in_words_with_their_bytes() -> None:
    listening, client, _ = listened()
    listening.watched = True
    client.ask("connect_robot", 1, 4711)
    client.ask("vm", 100, -50, 0)
    rows = listening.rows()
    assert [(row["to"], row["what"]) for row in rows] == [
        ("robot", "connect_robot"), ("host", "simple"), ("robot", "vm"), ("host", "state"),
    ]  # fmt: skip
    assert [row["of"] for row in rows] == ["connect_robot", "connect_robot", "vm", "vm"]
    assert rows[2]["text"] == "vm 100 -50 0"
    assert rows[2]["hex"].startswith("00 0c 00 03 00 00 00 64 ff ff ff ce")
    assert (rows[2]["size"], rows[2]["who"]) == (16, "client")
    assert "v 10 -5 0" in rows[3]["text"]
    assert listening.rows() == []
    assert rows[0]["parts"] == [["code", 102], ["pid", 4711], ["robot_id", 1]]
    assert rows[2]["parts"] == [["code", 12], ["translation", 100], ["steering", -50], ["turret", 0]]
    assert rows[3]["parts"] == []


def test_arguments_are_named_and_those_that_vary_in_number_are_numbered() -> None:
    outline: Decoded = {"call": "add_obstacle", "args": [3, 6, 6, 7, 6, 7, 7]}
    numbered = [["1", 6], ["2", 6], ["3", 7], ["4", 6], ["5", 7], ["6", 7]]
    assert parts(outline, TCP) == [["code", 50], ["n", 3], *numbered]
    assert parts({"call": "vm", "args": [1, 2, 3]}, HANDSHAKE_FIRST)[:2] == [["code", 5], ["translation", 1]]
    assert parts({"call": "connect_robot", "args": [1]}, TCP) == [["code", 102], ["robot_id", 1]]
    assert parts({"call": "gs", "args": []}, TCP) == [["code", 15]]


@pytest.mark.parametrize("wide", [False, True])
def test_a_connection_is_taken_up_in_the_middle_on_its_own_terms(wide: bool) -> None:
    listening, client, _ = listened(wide)
    client.ask("connect_robot", 1, 4711)
    client.ask("ct", *(1,) * 44)
    assert listening.rows() == []
    listening.watched = True
    client.ask("gs")
    _request, reply = listening.rows()
    assert reply["what"] == "state"
    assert "sonar 93" in reply["text"]


def test_what_is_too_much_is_counted_and_then_it_goes_on() -> None:
    listening, client, _ = listened()
    listening.watched = True
    client.ask("connect_robot", 1, 4711)
    for _ in range(MOST_ROWS):
        client.ask("gs")
    assert len(listening.rows()) == MOST_ROWS
    assert listening.missed == 2 * (MOST_ROWS + 1) - MOST_ROWS
    client.ask("gs")
    assert [row["what"] for row in listening.rows()] == ["gs", "state"]


def test_a_connection_in_the_middle_of_a_request_waits_for_the_next() -> None:
    agreed = serial_wire_state(N200)
    wire_state: list[WireState | None] = [None, agreed]
    listening = Listening(OFF, lambda _: wire_state[0], lambda: 0.0)
    tape = listening.open("line", HANDSHAKE_FIRST, N200)
    frame = codec.line_request(Call("vm", (100, -50, 0)), agreed)
    tape.to_robot(frame)
    listening.watched = True
    tape.to_robot(frame)
    tape.to_host(b"\x01")
    assert listening.rows() == []
    wire_state.pop(0)
    tape.to_robot(frame)
    assert [row["text"] for row in listening.rows()] == ["vm 100 -50 0"]


def test_what_is_no_frame_is_told_as_such_and_bytes_beyond_measure_are_cut() -> None:
    listening = Listening(OFF, lambda _: None, lambda: 0.0)
    listening.watched = True
    listening.open("client", TCP, N150).to_robot(b"\x77\x77\x00\x01" + bytes(2 * MOST_HEX))
    row = listening.rows()[0]
    assert row["what"] == "error"
    assert "unknown message type" in row["text"]
    assert len(row["hex"]) == 3 * MOST_HEX - 1


def test_everything_is_handed_on_to_the_real_recorder() -> None:
    inner = Inner()
    listening = Listening(inner, lambda _: None, lambda: 0.0)
    tape = listening.open("client", TCP, N150)
    tape.to_robot(b"abc")
    tape.to_host(b"de", by_time=True)
    tape.close()
    listening.stepped(0.1)
    listening.paced(2.0, False)
    listening.changed({"noise": {}})
    listening.close()
    assert inner.told == [
        ("open", "client", TCP, "n150", None), ("to_robot", 3), ("to_host", 2, True), "close", ("stepped", 0.1),
        ("paced", 2.0, False), ("changed", {"noise": {}}), "close",
    ]  # fmt: skip
