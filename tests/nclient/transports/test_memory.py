"""Peers in this process are found by entry point and answer without waiting."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import pytest

from nclient.errors import AddressError, ConnectionLost, ReplyTimeout
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.transports.stream import Deadline, MemoryStream, in_process_schemes, open_in_process
from tests.nclient.scripted_server import ScriptedServer

NOW = Deadline.after(0)


def test_bytes_pass_to_the_peer_and_back() -> None:
    stream = MemoryStream(ScriptedServer())
    stream.send(codec.encode_tcp_request(Call("connect_robot", (1, 2))))
    # Type 0x52 = 82, one word, 0x1b6b = 7019.
    assert stream.receive(NOW) == bytes.fromhex("0052000100001b6b")


def test_receive_times_out_at_once_without_a_reply() -> None:
    # A peer in this process answers at once or never: a long deadline is not awaited.
    with pytest.raises(ReplyTimeout, match="no reply"):
        MemoryStream(ScriptedServer()).receive(Deadline.after(1e6))


def test_close_closes_the_peer_once_and_ends_the_stream() -> None:
    peer = ScriptedServer()
    stream = MemoryStream(peer)
    stream.close()
    stream.close()
    assert peer.closed == 1
    with pytest.raises(ConnectionLost, match="this end"):
        stream.send(b"")
    with pytest.raises(ConnectionLost):
        stream.receive(NOW)


def test_the_emulator_is_an_installed_scheme() -> None:
    assert "sim" in in_process_schemes()


def test_an_opener_receives_the_whole_address(monkeypatch: pytest.MonkeyPatch) -> None:
    addresses: list[str] = []

    def open_toy(address: str) -> ScriptedServer:
        addresses.append(address)
        return ScriptedServer()

    class Point:
        name, value = "toy", "toys:open_toy"

        def load(self) -> object:
            return open_toy

    points = {"nomad.openers": [Point()]}
    monkeypatch.setattr("nclient.transports.stream.entry_points", lambda group: points.get(group, []))
    assert in_process_schemes() == ("toy",)
    assert isinstance(open_in_process("toy", "toy:box?lid=1"), MemoryStream)
    assert addresses == ["toy:box?lid=1"]


def test_a_scheme_without_opener_is_an_address_error() -> None:
    with pytest.raises(AddressError, match=r"package .*nosuch:"):
        open_in_process("nosuch", "nosuch:x")


@pytest.mark.parametrize("value", ["no_such_module:open_address", "nclient.errors:no_such_function"])
def test_an_opener_that_does_not_load_is_an_address_error(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    broken = EntryPoint("broken", value, "nomad.openers")
    monkeypatch.setattr("nclient.transports.stream.entry_points", lambda **_: [broken])
    with pytest.raises(AddressError, match=f"broken: .*{value} does not load"):
        open_in_process("broken", "broken:")
