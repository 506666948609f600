"""Connections are built from addresses; invalid addresses are rejected before anything is opened."""

from __future__ import annotations

import socket

import pytest

from nclient import (
    AddressError,
    AsyncRobot,
    ConnectionLost,
    Robot,
    RobotRefused,
    WorldFileError,
    connect,
    connect_async,
    connector,
)
from nclient.connector import ConnectOptions, is_listening, open_machine
from nclient.protocol.types import EVERYTHING, N150, N200, SCOUT
from nclient.transports.stream import MemoryStream
from nclient.url import available_schemes
from tests.nclient.scripted_server import ScriptedServer, by_script, on_socket


@pytest.fixture
def dialled(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """Return the targets of TCP connections, which scripted servers answer."""
    calls: list[tuple[str, int]] = []
    servers.clear()

    def dial(host: str, port: int, timeout_s: float) -> MemoryStream:
        assert timeout_s >= 5
        calls.append((host, port))
        servers.append(ScriptedServer())
        return MemoryStream(servers[-1])

    monkeypatch.setattr("nclient.transports.stream.TcpStream", dial)
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    return calls


servers: list[ScriptedServer] = []


@pytest.mark.parametrize(
    ("address", "host", "port", "robot_id"),
    [
        ("nserver://lab:7654/3", "lab", 7654, 3),
        ("nserver://lab/2", "lab", 7019, 2),
        ("nserver://lab", "lab", 7019, 1),
        ("nserver://lab/", "lab", 7019, 1),
        ("nserver:///4", "localhost", 7019, 4),
        ("NSERVER://[::1]:7000/1", "::1", 7000, 1),
        ("  nserver://127.0.0.1:1/1 ", "127.0.0.1", 1, 1),
    ],
)
def test_addresses_of_nservers(
    dialled: list[tuple[str, int]], address: str, host: str, port: int, robot_id: int
) -> None:
    robot = connect(address)
    assert isinstance(robot, Robot)
    assert dialled == [(host, port)]
    assert servers[0].calls[0].args[0] == robot_id
    # The second call is ct, with all masks on.
    assert servers[0].calls[1].args == EVERYTHING.smask


def test_the_environment_is_the_default_address(
    dialled: list[tuple[str, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without an address: first the default, then the environment's, then the named one; an empty variable is none.
    connect()
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab:1234/2")
    connect()
    connect("nserver://other/1")
    monkeypatch.setenv("NOMAD_ROBOT", "")
    connect()
    assert dialled == [("localhost", 7019), ("lab", 1234), ("other", 7019), ("localhost", 7019)]


def test_options_of_an_nserver(dialled: list[tuple[str, int]]) -> None:
    robot = connect("nserver://lab/1?timeout_s=0.5&model=scout&tm_s=0", timeout_s=9)
    assert dialled
    # The address's own option precedes the argument.
    assert robot.model is SCOUT
    assert robot._backend.timeout_s == 0.5  # type: ignore[attr-defined]
    assert connect("nserver://lab/1?tm_s=0", timeout_s=9)._backend.timeout_s == 9  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("nserver:lab", r"nserver://host\[:port\]/id"),
        ("nserver://lab:port/1", "an address is nserver://"),
        ("nserver://lab:99999/1", "an address is nserver://"),
        ("nserver://lab/one", "the robot's number, 1 or more, not '/one'"),
        ("nserver://lab/0", "the robot's number"),
        ("nserver://lab/1/2", "the robot's number"),
        ("nserver://lab/99999999999", "the robot's number"),
        ("nserver://lab/1#2", "the robot's number"),
        ("nserver://lab/#2", "the robot's number"),
        ("nserver://lab/1?timeout=3", "no option 'timeout'; did you mean timeout_s?"),
        ("nserver://lab/1?colour=3", "no option 'colour' There are timeout_s, model"),
        ("nserver://lab/1?timeout_s=soon", "timeout_s is a number of seconds above 0, not 'soon'"),
        ("nserver://lab/1?timeout_s=0", "above 0"),
        ("nserver://lab/1?timeout_s=inf", "above 0"),
        ("nserver://lab/1?model=n300", "no robot model 'n300'"),
        ("nsever://lab/1", "did you mean nserver:"),
        ("localhost:7019", "There are nserver:, replay:, robotd:, serial:, serial[+]rfc2217:, serial[+]socket:, sim:"),
        ("localhost:7019", "did you mean nserver://localhost:7019?"),
        ("lab-2.example.org:65001?model=n200", "did you mean robotd://lab-2.example.org:65001"),
        ("serial+rfc2217://lab", "a host and its port follow: serial[+]rfc2217://host:port"),
        ("serial+socket://lab:1/dev", "a host and its port follow"),
        ("serial+socket://lab:1?baud=9600", "no option 'baud'"),
        ("thesis_room", "such as nserver://localhost:7019/1 or sim:thesis_room"),
        ("serialport:///dev/ttyUSB0", "did you mean serial:"),
        ("serial:/dev/ttyUSB0", "such an address is serial:///dev/ttyUSB0"),
        ("serial://dev/ttyUSB0", "three slashes and a port follow: serial:///dev"),
        ("serial:///", "three slashes"),
        ("serial:///dev/null?baud=fast", "baud is a number of bits a second, not 'fast'"),
        ("serial:///dev/null?baud=0", "baud is a number of bits a second, not '0'"),
        ("serial:///dev/null?model=n15", "no robot model 'n15'"),
        ("serial:///dev/null?retry=2", "no option 'retry'; did you mean retries?"),
        ("serial:///dev/null?reconnect=never", "reconnect is a number of seconds, 0 for none, not 'never'"),
        ("serial:///dev/null?tm_s=1", "tm_s is whole seconds, 2 to 255, or 0 for none, not '1'"),
        ("serial:///dev/null?tm_s=2.5", "tm_s is whole seconds"),
        ("serial:///dev/null?feed=yes", "feed is 1 or 0, not 'yes'"),
        ("robotd:///x", r"a host and its port follow: robotd://host\[:port\]"),
        ("robotd://lab/1", "a host and its port follow"),
        ("robotd://lab?baud=9600", "no option 'baud'"),
        ("nserver://lab/1?retries=2", "no option 'retries'"),
        ("nserver://lab/1?max_speed_in_s=0", "max_speed_in_s is a number above 0"),
    ],
)
def test_invalid_addresses_open_nothing(dialled: list[tuple[str, int]], address: str, message: str) -> None:
    with pytest.raises(AddressError, match=message):
        connect(address)
    assert dialled == []


def test_the_simulation_runs_in_this_process() -> None:
    with connect("sim:thesis_room?seed=4&noisy=1&start=10,20,0,0") as robot:
        assert robot.model is N150
        truth = robot.truth()
        assert (truth.x_in, truth.y_in, truth.seed) == (10, 20, 4)
        first = robot.refresh().clock_s
        assert first is not None
        # Lockstep: an exchange takes 1 ms of simulated time.
        assert robot.refresh().clock_s == pytest.approx(first + 0.001)
        # What the program waits for passes, whatever a call takes.
        robot.sleep(2.5)
        # Two exchanges of 1 ms and the 2.5 s of sleep.
        assert robot.refresh().clock_s == pytest.approx(first + 2.502)
        with pytest.raises(ValueError, match="seconds"):
            robot.sleep(-1)


@pytest.mark.long
def test_sleeps_of_less_than_a_millisecond_add_up() -> None:
    with connect("sim:thesis_room?seed=1") as robot:
        begin_s = robot.refresh().clock_s
        for _ in range(1000):
            robot.sleep(0.0003)
        end_s = robot.refresh().clock_s
    assert begin_s is not None
    # 300 us are less than the 1 ms of a step: the rest must be carried over from sleep to sleep.
    assert end_s == pytest.approx(begin_s + 0.3, abs=0.003)


@pytest.mark.parametrize(
    ("address", "kind"), [("sim:no_such_world", WorldFileError), ("sim:thesis_room?sed=1", AddressError)]
)
def test_errors_of_the_opener_pass_through(address: str, kind: type[Exception]) -> None:
    with pytest.raises(kind):
        connect(address)


def test_the_address_names_the_model_of_a_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nclient.connector.open_in_process", lambda *_: MemoryStream(ScriptedServer()))
    assert connect("sim:thesis_room?robot=n200").model is N200


def test_available_schemes(monkeypatch: pytest.MonkeyPatch) -> None:
    assert {"nserver", "replay", "sim"} <= set(available_schemes())
    monkeypatch.setattr("nclient.transports.stream.entry_points", lambda **_: [])
    assert "sim" not in available_schemes()


def test_a_refused_connection_suggests_nserver() -> None:
    # The port is closed at the end of the block: nothing listens on it then.
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(ConnectionLost, match="is nserver running"):
        connect(f"nserver://127.0.0.1:{port}/1")


def test_a_session_over_tcp() -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, calls=6)) as port, connect(f"nserver://127.0.0.1:{port}/1") as robot:
        assert robot.refresh().speed_factor == 1.0
    assert server.names() == ["conf_tm", "gs", "st", "disconnect_robot"]


# what C programs name


def test_a_machine_name_without_port(dialled: list[tuple[str, int]]) -> None:
    open_machine("lab", 7654, ConnectOptions(robot_id=2))
    assert dialled == [("lab", 7654)]
    assert servers[0].calls[0].args[0] == 2


def test_an_empty_machine_name_is_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[str] = []

    def dial(host: str, port: int, timeout_s: float) -> MemoryStream:
        tried.append(host)
        if host != "own_name":
            raise ConnectionLost(f"{host}:{port} within {timeout_s}")
        return MemoryStream(ScriptedServer())

    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    monkeypatch.setattr("nclient.transports.stream.TcpStream", dial)
    # Old servers listen on the machine's own name and not on localhost.
    monkeypatch.setattr("nclient.transports.stream.names_of_this_machine", lambda: ("localhost", "own_name"))
    assert open_machine("", 7019, ConnectOptions()).port == 7019
    assert is_listening("", 7019)
    assert tried == ["localhost", "own_name"] * 2
    with pytest.raises(ConnectionLost, match="lab"):
        open_machine("lab", 7019, ConnectOptions())
    assert not is_listening("lab", 7019)


def test_the_environment_is_the_default_machine(
    dialled: list[tuple[str, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab:1234")
    open_machine("", 7654, ConnectOptions(robot_id=2))
    assert is_listening("", 7654)
    open_machine("other", 7654, ConnectOptions(robot_id=2))
    monkeypatch.setenv("NOMAD_ROBOT", "lab:1234")
    assert not is_listening("", 7654)
    with pytest.raises(AddressError, match="NOMAD_ROBOT: 'lab:1234'"):
        open_machine("", 7654, ConnectOptions(robot_id=2))
    monkeypatch.setenv("NOMAD_ROBOT", "")
    open_machine("", 7654, ConnectOptions(robot_id=2))
    assert dialled == [("lab", 1234)] * 2 + [("other", 7654), ("localhost", 7654)]


@pytest.mark.long
def test_a_simulation_is_a_machine_name() -> None:
    assert is_listening("sim:thesis_room", 7019)
    assert open_machine("sim:thesis_room", 7019, ConnectOptions(robot_id=1)).port > 0
    with pytest.raises(RobotRefused, match="number 2"):
        open_machine("sim:thesis_room", 7019, ConnectOptions(robot_id=2))


@pytest.mark.parametrize(
    ("name", "host", "port"),
    [
        ("lab:7654", "lab", 7654),
        ("10.0.0.7:7000", "10.0.0.7", 7000),
        ("[::1]:7000", "::1", 7000),
        ("::1", "::1", 7019),
        ("nserver://lab:7654/2", "lab", 7654),
        ("nserver://lab", "lab", 7019),
        ("nserver://lab/", "lab", 7019),
    ],
)
def test_machine_names_with_port_and_addresses(
    dialled: list[tuple[str, int]], name: str, host: str, port: int
) -> None:
    open_machine(name, 7019, ConnectOptions(robot_id=2))
    assert is_listening(name, 7019)
    assert dialled == [(host, port)] * 2
    assert servers[0].calls[0].args[0] == 2


def test_address_and_program_must_agree_on_the_robot(dialled: list[tuple[str, int]]) -> None:
    with pytest.raises(AddressError, match=r"nserver://lab/2' .* robot 1: "):
        open_machine("nserver://lab/2", 7019, ConnectOptions(robot_id=1))
    with pytest.raises(AddressError, match=r"1 or more, .*'/one'"):
        open_machine("nserver://lab/one", 7019, ConnectOptions(robot_id=1))
    assert dialled == []
    assert is_listening("nserver://lab/2", 7019)


def test_an_invalid_machine_address_is_rejected() -> None:
    assert not is_listening("nserver:lab", 7019)
    with pytest.raises(AddressError, match="nserver://host"):
        open_machine("nserver:lab", 7019, ConnectOptions())


# for asyncio


@pytest.mark.long
async def test_connect_async_can_be_awaited_or_entered() -> None:
    robot = await connect_async("sim:thesis_room")
    assert isinstance(robot, AsyncRobot)
    await robot.disconnect()
    async with connect_async("sim:thesis_room") as entered:
        assert isinstance(entered, AsyncRobot)
    assert entered.closed


@pytest.mark.long
def test_ignored_variable_is_reported_once(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    connector._report_ignored_variable.cache_clear()
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab:1234/2")
    for _ in range(2):
        connector.connect("sim:thesis_room").disconnect()
    assert caplog.messages == ["NOMAD_ROBOT=nserver://lab:1234/2 is ignored: the program names sim:thesis_room"]
    monkeypatch.setenv("NOMAD_ROBOT", "sim:thesis_room")
    connector.connect("sim:thesis_room").disconnect()
    connector.connect().disconnect()
    assert len(caplog.messages) == 1
    # Robot 1 is not robot 12.
    monkeypatch.setenv("NOMAD_ROBOT", "nserver://lab:1234/12")
    connector.address_or_default("nserver://lab:1234/1")
    assert len(caplog.messages) == 2
