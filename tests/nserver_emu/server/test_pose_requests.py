"""get_robot_conf: pending while a page is open, dropped with the connection."""

from __future__ import annotations

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import Session
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation

HERE, CLICKED = (0, 0, 0, 0), (120, -30, 900, 450)


def waiting(emulator: Emulator) -> tuple[WireClient, Session]:
    client, session = meet(emulator)
    assert client.send("gs", bytes.fromhex("00c80000")) == []
    assert session.waiting
    return client, session


def test_without_a_page_it_is_where_the_robot_is() -> None:
    client, _ = meet(Emulator(simulation()))
    assert client.ask("get_robot_conf").values == HERE


def test_a_click_answers_all_requests_for_that_robot() -> None:
    emulator = Emulator(simulation())
    emulator.pose_requests.open = True
    ends = [waiting(emulator) for _ in range(2)]
    emulator.pass_time(5.0)
    assert emulator.pose_requests.counts() == {1: 2}
    assert not emulator.pose_requests.answer(2, CLICKED)
    assert emulator.pose_requests.answer(1, CLICKED)
    for client, session in ends:
        (reply,) = client.read("get_robot_conf", session.tick())
        assert reply.values == CLICKED
    assert emulator.pose_requests.counts() == {}


def test_closing_the_page_answers_pending_requests() -> None:
    emulator = Emulator(simulation())
    emulator.pose_requests.open = True
    client, session = waiting(emulator)
    emulator.pose_requests.open = False
    (reply,) = client.read("get_robot_conf", session.tick())
    assert reply.values == HERE
    assert emulator.pose_requests.counts() == {}


def test_requests_of_closed_connections_are_dropped() -> None:
    emulator = Emulator(simulation())
    emulator.pose_requests.open = True
    _, session = waiting(emulator)
    _, other = waiting(emulator)
    emulator.on_disconnect(session.context)
    assert emulator.pose_requests.counts() == {1: 1}
    emulator.on_disconnect(other.context)
    assert emulator.pose_requests.counts() == {}


def test_in_lockstep_the_pose_is_returned_at_once() -> None:
    emulator = Emulator(simulation())
    emulator.pose_requests.open = True
    emulator.clock.lockstep_s = 0.1
    client, _ = meet(emulator)
    assert client.ask("get_robot_conf").values == HERE
