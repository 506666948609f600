"""Axes stop when the connection that owns them closes."""

from __future__ import annotations

import pytest

from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.session import ConnectionContext, Session
from nserver_emu.simulation.models import N200
from tests.nserver_emu.server.wire_client import WireClient, meet, simulation
from worlds.world import StartPose


@pytest.fixture
def emulator() -> Emulator:
    return Emulator(simulation())


def pair(emulator: Emulator) -> tuple[WireClient, Session, WireClient]:
    """Two clients of one robot, the first with its session."""
    return *meet(emulator), meet(emulator)[0]


def test_a_finished_client_stops_nothing(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    # zr has no arguments: type 20 (0014), no words.
    session.receive(b"\x00\x14\x00\x00")  # zr
    session.process_requests(max_requests=1)
    emulator.pass_time(1.0)
    # At zero already, it completes; the client then owns axes that do not move.
    assert not session.waiting or session.tick()
    second.ask("mv", 0, 0, 0, 0, 1, 50)
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 50}
    del first


def test_taken_over_axes_are_not_stopped(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    # 1. The first client moves translation and turret; after 1 s only the turret still turns.
    first.ask("pr", 100, 0, 900)
    emulator.pass_time(1.0)
    # 2. The second one takes over the steering with mode 1 of mv.
    second.ask("mv", 0, 0, 1, 60, 0, 0)
    assert first.ask("get_rv").slots == {38: 0, 39: 60, 40: 450}
    # 3. The first one closes: its turret stops, the steering continues.
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 60, 40: 0}


def test_a_client_of_several_robots_stops_all(emulator: Emulator) -> None:
    first, session, _ = pair(emulator)
    # create_robot also connects to the new robot, so the client commands robot 2, then robot 1.
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
    # The turret moves with a timeout of 2 s; queries of the other client every 0.6 s do not extend it.
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    for _ in range(3):
        emulator.pass_time(0.6)
        second.ask("gs")
    # 3 x 0.6 = 1.8 s: still moving. 2.4 s: stopped.
    assert emulator.simulation.robots[1].moving[2]
    emulator.pass_time(0.6)
    assert not emulator.simulation.robots[1].moving[2]


def is_turning(emulator: Emulator, robot_id: int = 1) -> bool:
    """Return True if the turret of a robot moves."""
    return emulator.simulation.robots[robot_id].moving[2]


# None of these moves an axis: modes 4 and 5 of mv set acceleration and speed.
SETTINGS = [
    ("sp", 100, 450, 450), ("ac", 300, 500, 500), ("dp", 0, 0), ("da", 0, 0), ("conf_tm", 2), ("conf_cp", 1),
    ("conf_sn", 15, *range(16)), ("conf_ir", 0, *range(16)), ("mv", 5, 100, 0, 0, 4, 100),
    ("place_robot", 600, 600, 0, 0),
]  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("setting", SETTINGS, ids=lambda setting: setting[0])
def test_settings_of_another_client_do_not_feed_it(emulator: Emulator, setting: tuple[str, *tuple[int, ...]]) -> None:
    emulator.simulation.add_robot(2, StartPose(60.0, 60.0), N200)
    first, _, second = pair(emulator)
    for client in (first, second):
        client.ask("connect_robot", 2, 1)
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    # 1.8 s without a command of the driver, then 0.2 s more: 2.0 s.
    for _ in range(3):
        emulator.pass_time(0.6)
        assert second.ask(*setting).kind != "error"
    assert is_turning(emulator, 2)
    emulator.pass_time(0.2)
    assert not is_turning(emulator, 2)
    # Those of the driver do.
    first.ask("vm", 0, 0, 100)
    for _ in range(4):
        emulator.pass_time(1.9)
        first.ask(*setting)
    assert is_turning(emulator, 2)


# The new timeout counts from vm at 0 s, not from its own time of 0.5 s.
@pytest.mark.parametrize(("changed_s", "stops_s"), [(3, 3.0), (1, 1.0), (2, 2.0)])
def test_another_timeout_counts_from_the_last_command(emulator: Emulator, changed_s: int, stops_s: float) -> None:
    first, _, second = pair(emulator)
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    emulator.pass_time(0.5)
    second.ask("conf_tm", changed_s)
    emulator.pass_time(stops_s - 0.6)
    assert is_turning(emulator)
    emulator.pass_time(0.1)
    assert not is_turning(emulator)
    assert emulator.simulation.robots[1].timed_out_s == pytest.approx(stops_s)


@pytest.mark.long
def test_a_shorter_timeout_than_the_silence_stops_at_once(emulator: Emulator) -> None:
    first, _, second = pair(emulator)
    # 5 s of silence are allowed by a timeout of 9 s, and not by one of 2 s.
    first.ask("conf_tm", 9)
    first.ask("vm", 0, 0, 100)
    emulator.pass_time(5.0)
    second.ask("conf_tm", 2)
    emulator.pass_time(0.001)
    assert not is_turning(emulator)
    second.ask("conf_tm", 0)
    first.ask("vm", 0, 0, 100)
    emulator.pass_time(50.0)
    assert is_turning(emulator)


def test_queries_of_the_owner_feed_the_watchdog(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    first.ask("conf_tm", 2)
    first.ask("vm", 0, 0, 100)
    # 4 s with a query every second, longer than the timeout of 2 s.
    for _ in range(4):
        emulator.pass_time(1.0)
        first.ask("gs")
    assert emulator.simulation.robots[1].moving[2]
    # A context without axes: an observer as long as there is an owner.
    assert not emulator.axis_ownership.may_feed_watchdog(ConnectionContext(), 1, emulator.simulation.robots[1])
    emulator.on_disconnect(session.context)
    assert emulator.axis_ownership.may_feed_watchdog(ConnectionContext(), 1, emulator.simulation.robots[1])
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}


@pytest.mark.long
def test_a_client_that_leaves_does_not_feed_the_watchdog(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    second.ask("conf_tm", 2)
    # The turret of one client and the steering of another move.
    second.ask("mv", 0, 0, 0, 0, 1, 50)
    first.ask("mv", 0, 0, 1, 50, 0, 0)
    emulator.pass_time(1.5)
    # The second axis stops with its client; that must not restart the timeout of the other.
    emulator.on_disconnect(session.context)
    assert emulator.simulation.robots[1].moving == (False, False, True)
    emulator.pass_time(0.6)
    assert emulator.simulation.robots[1].moving == (False, False, False)


def test_zr_ends_when_its_client_disconnects(emulator: Emulator) -> None:
    first, session, second = pair(emulator)
    first.ask("place_robot", 0, 0, 900, 900)
    session.receive(b"\x00\x14\x00\x00")  # zr
    assert session.process_requests(max_requests=1) == b""
    emulator.on_disconnect(session.context)
    assert second.ask("get_rv").slots == {38: 0, 39: 0, 40: 0}
    assert not emulator.simulation.robots[1].zeroing
