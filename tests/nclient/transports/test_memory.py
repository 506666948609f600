"""A peer in this process: found by entry point, asked without waiting."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.transports import memory
from nclient.transports.memory import MemoryStream, open_in_process, schemes
from nclient.transports.stream import Deadline
from tests.nclient.answering import ScriptedServer

NOW = Deadline.after(0)


def test_bytes_go_to_the_peer_and_back() -> None:
    stream = MemoryStream(ScriptedServer())
    stream.send(codec.encode_tcp_request(Call("connect_robot", (1, 2))))
    assert stream.receive(NOW) == bytes.fromhex("0052000100001b6b")


def test_nothing_said_is_a_time_out_at_once() -> None:
    with pytest.raises(ReplyTimeout, match="nothing to say"):
        MemoryStream(ScriptedServer()).receive(Deadline.after(1e6))


def test_a_closed_stream_is_lost_and_its_peer_closed_once() -> None:
    peer = ScriptedServer()
    stream = MemoryStream(peer)
    stream.close()
    stream.close()
    assert peer.closed == 1
    with pytest.raises(ConnectionLost, match="this end"):
        stream.send(b"")
    with pytest.raises(ConnectionLost):
        stream.receive(NOW)


def test_the_emulator_of_this_project_is_found() -> None:
    assert "sim" in schemes()


def test_an_opener_is_given_the_whole_address(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[str] = []

    def open_toy(address: str) -> ScriptedServer:
        given.append(address)
        return ScriptedServer()

    class Point:
        name, value = "toy", "toys:open_toy"

        def load(self) -> object:
            return open_toy

    monkeypatch.setattr(memory, "entry_points", lambda group: [Point()] if group == "nomad.openers" else [])
    assert schemes() == ("toy",)
    assert isinstance(open_in_process("toy", "toy:box?lid=1"), MemoryStream)
    assert given == ["toy:box?lid=1"]


def test_a_scheme_without_opener_is_an_address_error() -> None:
    with pytest.raises(AddressError, match="nothing installed here answers nosuch:"):
        open_in_process("nosuch", "nosuch:x")


@pytest.mark.parametrize("value", ["no_such_module:open_address", "nclient.errors:no_such_function"])
def test_an_opener_that_does_not_load_says_so(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    broken = EntryPoint("broken", value, "nomad.openers")
    monkeypatch.setattr(memory, "entry_points", lambda **_: [broken])
    with pytest.raises(AddressError, match=f"broken: addresses cannot be served, {value} does not load"):
        open_in_process("broken", "broken:")
