"""Axes stop when the connection that owns them closes."""

from __future__ import annotations

import pytest

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import ConnectionContext, Session
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation


@pytest.fixture
def emulator() -> Emulator:
    return Emulator(simulation())


def pair(emulator: Emulator) -> tuple[WireClient, Session, WireClient]:
    """Two clients of one robot, the first with its session."""
    return *meet(emulator), meet(emulator)[0]


def test_a_finished_client_stops_nothing(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    session.receive(b"\x00\x14\x00\x00")  # zr
    session.process_requests(max_requests=1)
    emulator.pass_time(1.0)
    assert not session.waiting or session.tick()
    second.ask("mv", 0, 0, 0, 0, 1, 50)
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 50}
    del first


def test_taken_over_axes_are_not_stopped(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    first.ask("pr", 100, 0, 900)
    emulator.pass_time(1.0)
    second.ask("mv", 0, 0, 1, 60, 0, 0)
    assert first.ask("get_rv").slots == {38: 0, 39: 60, 40: 450}
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 60, 40: 0}


def test_a_client_of_several_robots_stops_all(emulator: Emulator) -> None:
    first, session, _ = pair(emulator)
    first.ask("create_robot", 2, 1)
    first.ask("vm", 0, 0, 100)
    first.ask("connect_robot", 1, 1)
    first.ask("vm", 0, 0, 100)
    assert [robot.moving[2] for robot in emulator.simulation.robots.values()] == [True, True]
    emulator.on_disconnect(session.context)
    assert [robot.moving[2] for robot in emulator.simulation.robots.values()] == [False, False]
    emulator.on_disconnect(session.context)


def test_an_observer_does_not_feed_the_watchdog(emulator: Emulator) -> None:
    first, _, second = pair(emulator)
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    for _ in range(3):
        emulator.pass_time(0.6)
        second.ask("gs")
    assert emulator.simulation.robots[1].moving[2]
    emulator.pass_time(0.6)
    assert not emulator.simulation.robots[1].moving[2]


def test_queries_of_the_owner_feed_the_watchdog(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    for _ in range(4):
        emulator.pass_time(1.0)
        first.ask("gs")
    assert emulator.simulation.robots[1].moving[2]
    assert not emulator.axis_ownership.may_feed_watchdog(ConnectionContext(), 1, emulator.simulation.robots[1])
    emulator.on_disconnect(session.context)
    assert emulator.axis_ownership.may_feed_watchdog(ConnectionContext(), 1, emulator.simulation.robots[1])
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}


def test_zr_ends_when_its_client_disconnects(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    first.ask("place_robot", 0, 0, 900, 900)
    session.receive(b"\x00\x14\x00\x00")  # zr
    assert session.process_requests(max_requests=1) == b""
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}
    assert not emulator.simulation.robots[1].zeroing
