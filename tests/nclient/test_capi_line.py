"""The C mirror on a robot's own line, against the recorded exchanges of the direct library: bytes, State, answers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from nclient import capi
from nclient.errors import AddressError, RobotRefused
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N200, SCOUT
from nclient.transports.stream import MemoryStream
from tests.nclient.protocol.recorded import LINE_SESSIONS, SERIAL, model_of
from tests.nclient.scripted_line import NAK, RecordedRobot, ScriptedLine

TYPE_OF_THE_RECORDER = 200


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The mirror as it is when a program starts."""
    monkeypatch.setattr(capi, "SERVER_MACHINE_NAME", "")
    monkeypatch.setattr(capi, "_backend", None)
    monkeypatch.setattr(capi, "_error", None)
    monkeypatch.setattr(capi, "_client_state", type(capi._client_state)())
    capi.State[:] = [0] * 45
    capi.Smask[:] = EVERYTHING.smask
    capi.Laser[:] = [0] * 965
    yield
    capi.disconnect_robot(1)


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Return the lines that were opened; `peers[0]` answers the next one."""
    calls: list[tuple[Any, ...]] = []
    peers.clear()

    def opens(*where: Any, **_: Any) -> MemoryStream:
        calls.append(where)
        return MemoryStream(peers.pop(0))

    monkeypatch.setattr("nclient.transports.serial.SerialStream", opens)
    monkeypatch.setattr("nclient.transports.stream.TcpStream", opens)
    return calls


peers: list[Any] = []


def play(case: dict[str, Any]) -> int:
    """Make the recorded call through the mirror; what it returned."""
    name, args = case["call"], case["args"]
    out: list[Any] = [0] * 40
    match name:
        case "mask":
            capi.Smask[:] = args
            return capi.ct()
        case "conf_ir" | "conf_sn":
            return int(getattr(capi, name)(args[0], args[1:]))
        case "special_request":
            returned = capi.special_request([4 + len(args), 0, 0, TYPE_OF_THE_RECORDER, *args], out)
            special = case["decoded"]["special"]
            # The C buffer is longer than the packet.
            assert out[: len(special)] == special[: len(out)]
            return returned
        case "tk":
            return capi.tk(args)
        case _:
            return int(getattr(capi, name)(*args))


@pytest.mark.parametrize("session", LINE_SESSIONS)
def test_recorded_sessions_give_the_same_state(session: str, opened: list[tuple[Any, ...]]) -> None:
    first, *cases = SERIAL[session]
    peers.append(RecordedRobot(session))
    number = model_of(session).number
    device, conn = ("lab", 65001) if session.endswith("_tcp") else ("/dev/ttyUSB0", 38400)
    assert capi.connect_robot(1, number, device, conn) == 1
    assert opened[0][:2] == (device, conn)
    # A N200 answers ct while connecting: its state is the first recorded one.
    check_held(first)
    for case in cases:
        assert play(case) == case["decoded"].get("arm", case["decoded"]["return"]), case["call"]
        check_held(case)
    assert capi.disconnect_robot(1) == capi.TRUE


def check_held(case: dict[str, Any]) -> None:
    decoded = case["decoded"]
    assert capi.State == decoded["State"], case["call"]
    assert capi.posDataCheck() == decoded["pos"]
    if "Laser" in decoded:
        assert capi.Laser[: len(decoded["Laser"])] == decoded["Laser"]
    if decoded.get("time"):
        assert capi.posTimeGet() == decoded["time"]
        assert capi.voltCpuGet() == pytest.approx(decoded["volt_cpu"], abs=1e-5)
        assert capi.voltMotorGet() == pytest.approx(decoded["volt_motor"], abs=1e-5)
    for key, get in {"pos_sonar_0": lambda out: capi.posSonarGet(out, 0), "pos_bumper": capi.posBumperGet}.items():
        if any(decoded.get(key, ())):
            taken = [0] * 9
            assert get(taken) == 1
            assert taken == decoded[key]


def test_models_have_the_numbers_of_the_header(opened: list[tuple[Any, ...]]) -> None:
    assert (capi.MODEL_N200, capi.MODEL_N150, capi.MODEL_SCOUT) == (0, 1, 2)
    peers.append(ScriptedLine(model=SCOUT))
    assert capi.connect_robot(1, capi.MODEL_SCOUT, "/dev/ttyS0", 9600)
    assert opened == [("/dev/ttyS0", 9600)]
    assert capi.connect_robot(1, 7, "/dev/ttyS0", 9600) == capi.FALSE
    assert isinstance(capi.last_error(), AddressError)


def test_bumper_bits_are_raw_and_a_nak_is_success(opened: list[tuple[Any, ...]]) -> None:
    peers.append(ScriptedLine({"vm": NAK}))
    assert capi.connect_robot(1, capi.MODEL_N150, "/dev/ttyUSB0", 38400)
    assert capi.gs() == capi.TRUE
    # The four bits that always read 1 are not removed for C programs.
    assert capi.State[33] == 0xF00000
    before = list(capi.State)
    # The C library returns 1 on a NAK, and leaves State as it is.
    assert capi.vm(100, 0, 0) == capi.TRUE
    assert capi.State == before
    assert isinstance(capi.last_error(), RobotRefused)
    # Commands of an Nserver do not exist on a serial line.
    assert capi.real_robot() == capi.FALSE
    assert capi.get_bp() == capi.TRUE
    assert opened


def test_the_mask_of_an_n200_is_that_of_its_handshake(opened: list[tuple[Any, ...]]) -> None:
    robot = ScriptedLine(model=N200)
    peers.append(robot)
    assert capi.connect_robot(1, capi.MODEL_N200, "/dev/ttyUSB0", 38400)
    assert capi.Smask == list(EVERYTHING.smask)
    assert capi.pa(100, 0, 0) == capi.TRUE
    assert robot.names() == ["ct", "pa"]
    assert opened


def test_an_address_of_a_line_is_a_machine_name(opened: list[tuple[Any, ...]]) -> None:
    robot = ScriptedLine()
    peers.extend([robot, ScriptedLine()])
    capi.SERVER_MACHINE_NAME = "serial:///dev/ttyUSB0?model=n150&tm_s=0"
    assert capi.connect_robot(1) == 1
    assert capi.server_is_running() == capi.TRUE
    assert capi.gs() == capi.TRUE
    # server_is_running opens a line of its own.
    assert len(opened) == 2


def test_numbers_out_of_range_are_clamped(opened: list[tuple[Any, ...]]) -> None:
    robot = ScriptedLine()
    peers.append(robot)
    assert capi.connect_robot(1, capi.MODEL_N150, "/dev/ttyUSB0", 38400)
    assert capi.pr(40_000, -40_000, 1) == capi.TRUE
    assert capi.sp(-5, 70_000, 450) == capi.TRUE
    assert capi.conf_tm(300) == capi.TRUE
    assert capi.place_robot(40_000, 1, 2, 3) == capi.TRUE
    # Sign-magnitude of 16 bits, unsigned 16 bits, one byte.
    assert robot.calls == [
        Call("pr", (32767, -32767, 1)), Call("sp", (0, 65535, 450)), Call("conf_tm", (255,)),
        Call("dp", (32767, 1)), Call("da", (2, 3)),
    ]  # fmt: skip
    assert opened


def test_a_wait_above_255_seconds_is_split(opened: list[tuple[Any, ...]]) -> None:
    robot = ScriptedLine()
    robot.slots[41] = 1
    peers.append(robot)
    assert capi.connect_robot(1, capi.MODEL_N150, "/dev/ttyUSB0", 38400)
    assert capi.ws(1, 1, 1, 600) == capi.TRUE
    # 600 s in pieces of at most 255 s, as one byte holds; the motor bit never clears.
    assert [call.args[3] for call in robot.calls] == [255, 255, 90]
    assert opened
