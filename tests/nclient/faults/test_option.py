"""`faults=FILE` in an address: the plan is read before anything is opened, and put around what the program sees."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from nclient import connect
from nclient.connector import Connector
from nclient.errors import AddressError, FaultPlanError, ReplyTimeout, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.serial_framing import build_frame
from nclient.transports.stream import Deadline, MemoryStream
from nclient.url import parse_address
from tests.nclient.scripted_server import ScriptedServer

PLAN = """
[[rule]]
name = "no sonars"
do = "nak"
direction = "request"
command = "get_sn"
first = 1
[[rule]]
name = "deaf"
do = "drop"
command = "vm"
line = "nserver"
[[rule]]
name = "elsewhere"
do = "drop"
line = "serial"
"""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> ScriptedServer:
    """Peer at the other end of a memory stream."""
    server = ScriptedServer()
    monkeypatch.setattr("nclient.transports.stream.TcpStream", lambda *_: MemoryStream(server))
    return server


def test_the_plan_stands_between_program_and_robot(
    server: ScriptedServer, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    with caplog.at_level(logging.INFO), connect(f"nserver://lab/1?faults={path}") as robot:
        with pytest.raises(RobotRefused, match=r"get_sn .*not allowed"):
            robot.read_sonars()
        robot.read_sonars()
        with pytest.raises(ReplyTimeout):
            robot.drive(translation_in_s=1)
    # The refused get_sn was not sent; the reply to vm was dropped after the server had executed it.
    assert [name for name in server.names() if name in ("get_sn", "vm")] == ["get_sn", "vm"]
    assert "faults on nserver so far: {'nak': 1, 'drop': 1}" in caplog.text


def test_invalid_plan_is_rejected_before_opening(server: ScriptedServer, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("[[rule]]\ndo = 'drp'")
    with pytest.raises(FaultPlanError, match=r"plan\.toml: .*'rule 1': .*'drp'"):
        connect(f"nserver://lab/1?faults={path}")
    with pytest.raises(FaultPlanError, match="cannot be read"):
        connect(f"nserver://lab/1?faults={tmp_path / 'nowhere.toml'}")
    with pytest.raises(AddressError, match=r"faults .*file, not ''"):
        connect("nserver://lab/1?faults=")
    assert server.calls == []


def test_a_plan_for_other_lines_only_is_a_mistake(server: ScriptedServer, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("[[rule]]\ndo = 'drop'\nline = ['serial:1', 'robotd']")
    with pytest.raises(FaultPlanError, match=r"nserver, .*robotd, serial:1"):
        connect(f"nserver://lab/1?faults={path}")
    assert server.closed == 1
    path.write_text("seed = 1")
    connect(f"nserver://lab/1?faults={path}")


def test_on_an_n150_s_own_line_the_first_bytes_are_no_greeting(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("[[rule]]\ndo = 'drop'\ncommand = 'hello'")
    for model, greeted in (("n150", False), ("n200", True)):
        sent = build_frame(21, bytes(8))
        # The frame has 14 bytes: for a N200 the first 11 of them are the handshake.
        monkeypatch.setattr("nclient.transports.stream.TcpStream", lambda *_, sent=sent, **__: Chatty(sent))
        connector = Connector(parse_address(f"robotd://lab?model={model}&faults={path}"))
        stream = connector.open_stream()
        data = stream.receive(Deadline.after(0))
        assert data == (sent[11:] if greeted else sent)


class Chatty:
    """A stream on which something has come already."""

    def __init__(self, data: bytes) -> None:
        self._data = data

    def send(self, data: bytes) -> None:
        raise AssertionError(f"{data!r} was sent")

    def receive(self, deadline: Deadline) -> bytes:
        del deadline
        data, self._data = self._data, b""
        if not data:
            raise ReplyTimeout("nothing more")
        return data

    def close(self) -> None: ...


def test_counting_goes_on_when_the_connection_is_made_anew(server: ScriptedServer, tmp_path: Path) -> None:
    path = tmp_path / "plan.toml"
    path.write_text("[[rule]]\ndo = 'drop'\ncommand = 'gs'\nevery = 3")
    connector = Connector(parse_address(f"nserver://lab/1?faults={path}"))
    answered = []
    for _ in range(6):
        backend = connector.open_session()
        try:
            answered.append(bool(backend.execute(Call("gs"))))
        except ReplyTimeout:
            answered.append(False)
        backend.close()
    # Each session is a new connection: the third and the sixth gs are dropped all the same.
    assert answered == [True, True, False, True, True, False]
    assert connector.plan_injector is not None
    assert connector.plan_injector.counts == {"rule 1": {"seen": 6, "drop": 2}}
    assert server.closed == 6
