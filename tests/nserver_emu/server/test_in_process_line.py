"""The emulator without a socket, on a robot's own line: its language, its silence, and the simulation beside it."""

from __future__ import annotations

import pytest

from nclient.errors import AddressError
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N150, N200, Model, serial_wire_state
from nserver_emu.server.inprocess import InProcess, InProcessLine, open_address
from tests.nserver_emu.server.line_host import LineHost
from tests.nserver_emu.server.wire_client import WireClient


def opened(address: str) -> InProcessLine:
    end = open_address(address)
    assert isinstance(end, InProcessLine)
    return end


def exchange(end: InProcess, data: bytes) -> bytes:
    end.send(data)
    return end.receive()


def host_on(end: InProcess, model: Model = N150) -> LineHost:
    return LineHost(lambda data: exchange(end, data), model)


def watcher(end: InProcessLine) -> WireClient:
    beside = end.beside()
    client = WireClient(lambda data: exchange(beside, data))
    client.ask("connect_robot", 1, 1)
    return client


def test_a_line_has_no_stamps_and_resting_bumpers() -> None:
    host = host_on(opened("sim:thesis_room?line=1&step_s=0.25"))
    replies = [host.ask("gs") for _ in range(3)]
    assert [reply.clock for reply in replies] == [250, 500, 750]
    assert all(reply.stamps == {} for reply in replies)
    assert all(reply.slots[33] == N150.bumper_rest for reply in replies)


def test_a_wait_is_answered_in_the_same_exchange() -> None:
    host = host_on(opened("sim:?line=1"))
    host.ask("pr", 100, 0, 0)
    assert host.ask("ws", 1, 1, 1, 30).slots[34] == 100


def test_a_n200_accepts_a_mask_and_sends_no_handshake() -> None:
    end = opened("sim:?line=1&robot=n200")
    assert end.receive() == b""
    host = host_on(end, N200)
    host.ask("ct", *EVERYTHING.smask)
    assert host.ask("gs").clock


def test_requests_without_reply_take_a_step() -> None:
    end = opened("sim:?line=1&step_s=0.1")
    client = watcher(end)
    question = codec.encode_serial_request(Call("gs"), serial_wire_state(N150))
    assert exchange(end, question[:-1]) == b""
    assert client.ask("sim_truth").values[1] == 100
    for _ in range(6):
        assert exchange(end, b"") == b""
    assert client.ask("sim_truth").values[1] == 700
    assert host_on(end).ask("gs").clock == 800


def test_silence_takes_nothing_where_time_stands() -> None:
    end = opened("sim:?line=1")
    client = watcher(end)
    end.emulator.clock.paused = True
    assert exchange(end, b"rubbish") == b""
    assert client.ask("sim_truth").values[1] == 0


def test_the_side_connection_reads_the_same_simulation() -> None:
    end = opened("sim:thesis_room?line=1&start=10,20,0,0&step_s=0.05")
    client = watcher(end)
    assert client.ask("sim_truth").values[1:4] == (0, 10_000, 20_000)
    host = host_on(end)
    host.ask("vm", 100, 0, 0)
    assert host.ask("gs").slots[38] == 100
    assert client.ask("sim_truth").values[1] == 100
    assert end.emulator.clock.lockstep_s == 0.05


def test_leaving_the_line_stops_the_robot() -> None:
    end = opened("sim:?line=1")
    host_on(end).ask("vm", 50, 0, 0)
    end.close()
    assert end.emulator.simulation.robots[1].moving == (False, False, False)


@pytest.mark.parametrize("text", ["2", "yes", ""])
def test_the_option_is_one_or_nought(text: str) -> None:
    with pytest.raises(AddressError, match="1 or 0"):
        open_address(f"sim:?line={text}")
    assert not isinstance(open_address("sim:?line=0"), InProcessLine)
