"""Addresses of robots on their own line, and what their options put on; the robot is a script in this process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nclient import AddressError, BumperHit, ConnectionLost, ReplyTimeout, Robot, RobotRefused, connect, connect_async
from nclient.connector import is_listening
from nclient.protocol.client_state import Handshake, build_handshake
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N150, N200, SCOUT
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_line import ScriptedLine, spoiled
from tests.nclient.scripted_server import ScriptedServer


class Bench:
    """A scripted robot behind every serial line, and the lines that were opened."""

    def __init__(self) -> None:
        self.robot = ScriptedLine()
        self.opened: list[tuple[Any, ...]] = []
        self.streams: list[MemoryStream] = []
        self.robots: list[Robot] = []

    def open(self, *where: Any, **_: Any) -> MemoryStream:
        self.opened.append(where)
        self.streams.append(MemoryStream(self.robot))
        return self.streams[-1]

    def connect(self, address: str, **options: Any) -> Robot:
        self.robots.append(connect(address, **options))
        return self.robots[-1]


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    made = Bench()
    monkeypatch.setattr("nclient.transports.serial.SerialStream", made.open)
    monkeypatch.setattr("nclient.transports.serial.PortableSerialStream", made.open)
    monkeypatch.setattr("nclient.transports.stream.TcpStream", made.open)
    yield made
    for robot in made.robots:
        robot.disconnect()


def test_a_serial_port(bench: Bench) -> None:
    robot = bench.connect("serial:///dev/ttyUSB0")
    assert bench.opened == [("/dev/ttyUSB0", 38400)]
    assert robot.model is N150
    assert bench.robot.calls == [Call("conf_tm", (5,))]
    assert robot.state.sonars_in[0] == 57
    assert robot.state.bumpers == ()
    # The raw slot has the bits that always read 1; `bumpers` leaves them out.
    assert robot.state.raw[33] == 0xF00000
    bench.connect("serial:///dev/serial/by-id/a%20b?model=scout&baud=9600&tm_s=0")
    assert bench.opened[1] == ("/dev/serial/by-id/a b", 9600)
    assert bench.robots[1].model is SCOUT


@pytest.mark.parametrize(("address", "port"), [
    ("/dev/ttyUSB0", "/dev/ttyUSB0"), ("/dev/cu.usbserial-1?model=n150", "/dev/cu.usbserial-1"),
    ("COM3", "COM3"), ("com12?model=n150", "com12"), ("serial:///COM3", "COM3"),
    ("serial+rfc2217://lab:4001", "rfc2217://lab:4001"), ("serial+rfc2217://[::1]:4001", "rfc2217://[::1]:4001"),
    ("serial+socket://lab:4001?model=n150", "socket://lab:4001"),
])  # fmt: skip
def test_names_of_ports_are_addresses(bench: Bench, address: str, port: str) -> None:
    bench.connect(address)
    assert bench.opened == [(port, 38400)]


def test_the_serial_protocol_over_tcp(bench: Bench) -> None:
    bench.connect("robotd://lab?model=n150")
    bench.robot = ScriptedLine(model=N200)
    bench.robot.wire_state.set_mask(EVERYTHING.with_position(2))
    bench.robot.out += build_handshake(Handshake(EVERYTHING.with_position(2), 51))
    robot = bench.connect("robotd://[::1]:7000?model=n200")
    assert [where[:2] for where in bench.opened] == [("lab", 65001), ("::1", 7000)]
    # The mask came with the handshake: no ct is sent.
    assert bench.robot.names() == ["conf_tm"]
    assert "sonar_0" in robot.refresh().stamps


def test_a_program_runs_unchanged_on_a_line(bench: Bench) -> None:
    with connect("serial:///dev/ttyUSB0?model=n150") as robot:
        robot.configure_sonars()
        robot.drive(translation_in_s=5)
        assert robot.wait_until_still(1).sonars_in[0] == 57
        with pytest.raises(RobotRefused, match=r"only .*Nserver"):
            robot.truth()
        with pytest.raises(RobotRefused, match="not have it"):
            robot.position_data(sonars=True)
        assert not robot.is_simulated()
        assert robot.link is not None
        # conf_tm, conf_sn, vm and ws; refusals by this side are no exchanges.
        assert robot.link.exchanges == robot.link.answers == 4
    assert bench.robot.names() == ["conf_tm", "conf_sn", "vm", "ws", "st"]
    assert bench.robot.closed == 1


async def test_an_async_robot_on_a_line(bench: Bench) -> None:
    async with connect_async("serial:///dev/ttyUSB0") as robot:
        await robot.drive(translation_in_s=5)
        assert robot.link is not None
        assert robot.link.answers == 2
    assert bench.robot.names() == ["conf_tm", "vm", "st"]


def test_two_retries_by_default(bench: Bench) -> None:
    for options, tries in (("", 3), ("&retries=0", 1), ("&retries=4", 5)):
        robot = bench.connect(f"serial:///dev/ttyUSB0?tm_s=0{options}")
        bad = spoiled(bench.robot.frame("get_rc"))
        bench.robot.calls.clear()
        bench.robot.answers["get_rc"] = [bad] * tries
        with pytest.raises(ReplyTimeout):
            robot.read_pose()
        assert bench.robot.names().count("get_rc") == tries


def test_a_lost_line_is_reopened_by_default(bench: Bench) -> None:
    robot = bench.connect("serial:///dev/ttyUSB0?reconnect=0.01")
    bench.streams[0].close()
    with pytest.raises(ConnectionLost):
        robot.refresh()
    assert not robot.closed
    assert robot.refresh().sonars_in[0] == 57
    # The settings are restored on the new connection before gs is sent.
    assert bench.robot.names() == ["conf_tm", "conf_tm", "gs"]
    assert robot.link is not None
    assert (robot.link.losses, robot.link.reconnects) == (1, 1)
    robot = bench.connect("serial:///dev/ttyUSB0?reconnect=0")
    bench.streams[-1].close()
    for _ in range(2):
        with pytest.raises(ConnectionLost):
            robot.refresh()
    assert robot.closed


def test_reply_timeouts(bench: Bench) -> None:
    bench.robot.answers["gs"] = None
    for address, given, wait_s in (
        ("serial:///dev/ttyUSB0?tm_s=0&retries=0", None, 1), ("serial:///dev/ttyUSB0?tm_s=0&retries=0", 3, 3),
        ("serial:///dev/ttyUSB0?tm_s=0&retries=0&timeout_s=0.5", 3, 0.5),
    ):  # fmt: skip
        with pytest.raises(ReplyTimeout, match=f"no answer .* {wait_s} s"):
            bench.connect(address, timeout_s=given).refresh()


def test_replies_are_validated_by_default(bench: Bench) -> None:
    bench.robot.slots[43] = 4000
    with pytest.raises(ReplyTimeout, match="compass reads 4000"):
        bench.connect("serial:///dev/ttyUSB0?tm_s=0&retries=0").refresh()
    assert bench.connect("serial:///dev/ttyUSB0?tm_s=0&retries=0&checks=0").refresh().compass_deg == 400
    # With two retries the third reply is accepted: the value is unusual, and not corrupt.
    assert bench.connect("serial:///dev/ttyUSB0?tm_s=0").refresh().compass_deg == 400


def test_speed_limits(bench: Bench) -> None:
    robot = bench.connect("serial:///dev/ttyUSB0?tm_s=0&max_speed_in_s=8&max_turn_deg_s=30")
    robot.drive(translation_in_s=20, steering_deg_s=45)
    robot.move(translation_in=10)
    assert bench.robot.calls == [
        Call("vm", (80, 300, 0)), Call("mv", (5, 80, 0, 0, 0, 0)), Call("mv", (0, 0, 5, 300, 5, 300)),
        Call("pr", (100, 0, 0)),
    ]  # fmt: skip


def test_a_bumper_hit_stops(bench: Bench) -> None:
    robot = bench.connect("serial:///dev/ttyUSB0?bumper_stop=1&feed=0")
    bench.robot.slots[33] |= 4
    with pytest.raises(BumperHit, match="vm: bumper 2"), robot:
        robot.drive(translation_in_s=5)
    # One st by the bumper, one when the block ends.
    assert bench.robot.names() == ["conf_tm", "vm", "st", "st"]


def test_a_hit_at_the_final_stop_hides_no_earlier_error(bench: Bench) -> None:
    def run(*, goes_wrong: bool) -> None:
        bench.robot.slots[33] = N150.bumper_rest
        with connect("serial:///dev/ttyUSB0?bumper_stop=1&feed=0") as robot:
            robot.drive(translation_in_s=5)
            bench.robot.slots[41] = 1
            robot.refresh()
            bench.robot.slots[33] |= 4
            if goes_wrong:
                raise KeyError

    with pytest.raises(KeyError):
        run(goes_wrong=True)
    # The contact is in the reply to the final st.
    with pytest.raises(BumperHit, match="st: bumper 2"):
        run(goes_wrong=False)


def test_an_unanswered_first_command_closes_the_line(bench: Bench) -> None:
    bench.robot.answers |= dict.fromkeys(("conf_tm", "get_ra", "get_rv"))
    with pytest.raises(ReplyTimeout, match="conf_tm"):
        connect("serial:///dev/ttyUSB0")
    assert bench.robot.closed == 1


def test_is_listening_opens_and_closes_the_line(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_listening("serial:///dev/ttyUSB0", 0)
    assert bench.robot.closed == 1

    def refuse(*_: Any) -> MemoryStream:
        raise ConnectionLost("refuse")

    monkeypatch.setattr("nclient.transports.serial.SerialStream", refuse)
    assert not is_listening("serial:///dev/ttyUSB0", 0)


# the same options elsewhere


@pytest.mark.long
def test_a_simulation_has_no_keep_alive_by_default() -> None:
    with connect("sim:thesis_room?max_speed_in_s=5") as robot:
        robot.drive(translation_in_s=20)
        # 80 ms are enough to reach the limited speed.
        for _ in range(80):
            state = robot.refresh()
        assert state.translation_in_s == 5
        assert robot.link is None
    with connect("sim:thesis_room?tm_s=2&seed=1") as robot:
        robot.drive(translation_in_s=1)
        assert robot.refresh().moving


@pytest.mark.long
def test_a_long_wait_outlasts_the_motion_timeout() -> None:
    with connect("sim:thesis_room?tm_s=2&start=-0,0,0,0&max_speed_in_s=5") as robot:
        # The move of 8 s is longer than the timeout of 2 s.
        robot.move(translation_in=40)
        assert robot.wait_until_still(20).x_in == pytest.approx(40, abs=0.2)


def test_a_fast_simulation_has_no_keep_alive_by_default(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    server = ScriptedServer()
    # A simulation at full speed: a timeout of 5 simulated seconds would pass between two requests.
    server.slots = {0: 9999}
    monkeypatch.setattr("nclient.transports.stream.TcpStream", lambda *_: MemoryStream(server))
    bench.connect("nserver://lab/1")
    assert server.names() == []
    bench.connect("nserver://lab/1?tm_s=9&feed=0")
    assert server.calls[-1] == Call("conf_tm", (9,))


def test_a_recorded_line_is_replayed_as_a_line(bench: Bench, tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    with connect(f"serial:///dev/ttyUSB0?record={path}") as robot:
        seen = robot.refresh().raw
    assert bench.opened
    with connect(f"replay:{path}") as played:
        assert played.model is N150
        assert played.refresh().raw == seen


def test_tcp_is_counted_only_with_reconnect(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    streams: list[MemoryStream] = []

    def dial(*_: Any) -> MemoryStream:
        streams.append(MemoryStream(ScriptedServer()))
        return streams[-1]

    monkeypatch.setattr("nclient.transports.stream.TcpStream", dial)
    assert bench.connect("nserver://lab/1?tm_s=0").link is None
    robot = bench.connect("nserver://lab/1?reconnect=0.01&feed=0")
    streams[-1].close()
    with pytest.raises(ConnectionLost):
        robot.refresh()
    assert robot.refresh().speed_factor == 1.0
    assert robot.link is not None
    # connect_robot and ct twice each, conf_tm twice, and gs.
    assert (robot.link.losses, robot.link.reconnects, robot.link.answers) == (1, 1, 7)


@pytest.mark.parametrize(("address", "message"), [
    ("serial:///dev/r1#2", "three slashes and a port follow"), ("robotd://lab#2", "a host and its port follow"),
    ("replay:", "the name of a recording follows: replay:FILE"), ("replay:?order=strict", "the name of a recording"),
])
def test_incomplete_addresses_are_rejected(address: str, message: str) -> None:
    with pytest.raises(AddressError, match=message):
        connect(address)


def test_a_refused_connection_to_a_line_over_tcp() -> None:
    with pytest.raises(ConnectionLost, match="`nserver --robotd 1`"):
        connect("robotd://127.0.0.1:1?reconnect=0")
