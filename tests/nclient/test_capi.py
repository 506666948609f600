"""The C mirror against the recorded exchanges: the bytes it sends, and what it then holds, call by call."""

from __future__ import annotations

import inspect
import socket
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from nclient import RobotRefused, WireError, capi
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol.commands import COMMANDS, Call, Command
from nclient.protocol.replies import Reply
from nclient.protocol.types import EVERYTHING, SCOUT, serial_wire_state
from tests.nclient.protocol.recorded import TCP, TCP_SESSIONS
from tests.nclient.scripted_server import ScriptedServer, by_script, error, on_socket, simple

TYPE_OF_THE_RECORDER = 200


@pytest.fixture(autouse=True)
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The mirror as it is when a program starts; its settings put back afterwards."""
    for name in ("SERVER_MACHINE_NAME", "SERV_TCP_PORT", "ANSWER_TIMEOUT_S"):
        monkeypatch.setattr(capi, name, getattr(capi, name))
    monkeypatch.delenv("NOMAD_ROBOT", raising=False)
    monkeypatch.setattr(capi, "_backend", None)
    monkeypatch.setattr(capi, "_error", None)
    monkeypatch.setattr(capi, "_client_state", type(capi._client_state)())
    capi.State[:] = [0] * 45
    capi.Smask[:] = EVERYTHING.smask
    # A count, and 482 readings of two numbers.
    capi.Laser[:] = [0] * 965
    yield
    capi.disconnect_robot(1)


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> ScriptedServer:
    """A script that answers in this process; connect_robot finds it by the address toy:."""
    script = ScriptedServer()

    class Point:
        name, value = "toy", "toys:open_toy"

        def load(self) -> Callable[[str], ScriptedServer]:
            return lambda _: script

    monkeypatch.setattr("nclient.transports.stream.entry_points", lambda **_: [Point()])
    monkeypatch.setattr(capi, "SERVER_MACHINE_NAME", "toy:")
    return script


def use(port: int) -> None:
    """Point the mirror at a port of this machine."""
    capi.SERVER_MACHINE_NAME = "127.0.0.1"
    capi.SERV_TCP_PORT = port


# the recorded sessions


def replay(cases: list[dict[str, Any]]) -> Callable[[socket.socket], None]:
    """A talk that answers each request as the recorder did, and insists on its bytes."""

    def talk(connection: socket.socket) -> None:
        for case in cases:
            for exchange in case["exchanges"]:
                wanted = bytes.fromhex(exchange["request"])
                request = b""
                while len(request) < len(wanted):
                    data = connection.recv(len(wanted) - len(request))
                    assert data, f"hung up in {case['call']}"
                    request += data
                # Every byte must be that of the C library, apart from those that it leaves undefined.
                assert comparable(case, request) == comparable(case, wanted), case["call"]
                connection.sendall(bytes.fromhex(exchange.get("reply", "")))
        assert connection.recv(1) == b""

    return talk


def comparable(case: dict[str, Any], request: bytes) -> bytes:
    """A request without what a C client leaves undefined: process id, unused words."""
    # Types 0x66 = 102 and 0x67 = 103, connect and disconnect: the last word is the process number.
    if request[:2] in (b"\0\x66", b"\0\x67"):
        return request[:-4]
    # A line uses five of the eight words.
    if case["call"] == "motion_check" and case["args"][0] == 0:
        return request[:-12]
    if case["call"] == "tk":
        # The last word of the text holds its end and NUL in the low bytes; the rest of it is undefined.
        used = len(case["args"]) % 4 + 1
        return request[:-4] + request[-used:]
    return request


def play(case: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """Make the recorded call through the mirror; what it returned, and what its output lists hold."""
    name, args = case["call"], case["args"]
    # Longer than any list that a C function fills.
    out: list[Any] = [0] * 40
    match name:
        case "mask":
            capi.Smask[:] = args
            return capi.ct(), {}
        case "conf_ir" | "conf_sn":
            return getattr(capi, name)(args[0], args[1:]), {}
        case "get_rpx" | "get_robot_conf":
            return getattr(capi, name)(out), {"obs": out}
        case "add_obstacle" | "delete_obstacle":
            # A C program passes an array that may be longer than the vertices in it.
            return getattr(capi, name)([*args, *[0] * 12]), {}
        case "move_obstacle":
            obs = [*args[:-2], *[0] * 14]
            return capi.move_obstacle(obs, *args[-2:]), {"obs": obs}
        case "predict_sensors":
            state, laser = [0] * 45, [0] * 965
            x, y, th, tu = args
            returned = capi.predict_sensors(x, y, th, tu, state, laser)
            return returned, {"pred_state": state, "pred_laser": laser[: 1 + laser[0]]}
        case "motion_check":
            # The recording has thousandths; unused arguments are 0.
            a1, a2, a3, a4, a5, a6, a7 = [number / 1000 for number in args[1:]] + [0.0] * (8 - len(args))
            collide = [0.0, 0.0, 0.0]
            return capi.motion_check(args[0], a1, a2, a3, a4, a5, a6, a7, collide), {"collide": collide}
        case "special_request":
            # C programs build the packet's header themselves: length low and high, serial number, type.
            return capi.special_request([4 + len(args), 0, 0, TYPE_OF_THE_RECORDER, *args], out), {"special": out}
        case "arm_ws":
            lift, grip, timeout = args
            returned = capi.arm_ws(lift, grip, timeout, out)
            assert out[0] == case["decoded"]["remain"]
            return returned, {}
        case "tk":
            return capi.tk(args), {}
        case _:
            return getattr(capi, name)(*args), {}


@pytest.mark.parametrize("session", TCP_SESSIONS)
def test_recorded_sessions_give_the_same_state(session: str) -> None:
    cases = TCP[session]
    with on_socket(replay(cases)) as port:
        use(port)
        for case in cases:
            returned, outputs = play(case)
            check_held(case, returned)
            # Lists that the C functions fill: as many numbers as were recorded.
            for name, value in outputs.items():
                assert value[: len(case["decoded"][name])] == case["decoded"][name], (case["call"], name)
    assert len(cases) > 20


def check_held(case: dict[str, Any], returned: int) -> None:
    call, decoded = case["call"], case["decoded"]
    assert returned == decoded.get("arm", decoded["return"]), call
    assert capi.State == decoded["State"], call
    assert capi.posDataCheck() == decoded["pos"]
    assert capi.voltCpuGet() == pytest.approx(decoded["volt_cpu"], abs=1e-5)
    assert capi.voltMotorGet() == pytest.approx(decoded["volt_motor"], abs=1e-5)
    if "Laser" in decoded:
        assert capi.Laser[: len(decoded["Laser"])] == decoded["Laser"], call
    if decoded.get("time"):
        assert capi.posTimeGet() == decoded["time"], call
    check_stamps(decoded)


def check_stamps(decoded: dict[str, Any]) -> None:
    for key, get in {
        "pos_sonar_0": lambda out: capi.posSonarGet(out, 0),
        "pos_sonar_15": lambda out: capi.posSonarGet(out, 15),
        "pos_ir_0": lambda out: capi.posInfraredGet(out, 0),
        "pos_bumper": capi.posBumperGet,
        "pos_laser": capi.posLaserGet,
        "pos_compass": capi.posCompassGet,
    }.items():
        if any(decoded.get(key, ())):
            taken = [0] * 9
            assert get(taken) == 1
            assert taken == decoded[key]


def test_recorded_sessions_have_stamps_of_every_kind() -> None:
    seen = {key for session in TCP_SESSIONS for case in TCP[session] for key in case["decoded"] if "pos_" in key}
    assert seen == {"pos_sonar_0", "pos_sonar_15", "pos_ir_0", "pos_bumper", "pos_laser", "pos_compass"}


# every command


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row.name)
def test_every_command_has_its_function(row: Command) -> None:
    function = getattr(capi, row.name, None)
    assert function is not None, f"no capi.{row.name}"
    assert function.__doc__
    assert row.name in capi.__all__


def test_every_name_of_the_header_exists() -> None:
    for name in ("posDataRequest", "posDataCheck", "posInfraredRingGet", "posInfraredGet", "posSonarRingGet",
                 "posSonarGet", "posBumperGet", "posLaserGet", "posCompassGet", "posTimeGet", "voltCpuGet",
                 "voltMotorGet", "scout_vm", "server_is_running", "State", "Smask", "Laser", "TRUE", "FALSE"):
        assert name in capi.__all__
        assert hasattr(capi, name)


def test_arguments_are_truncated_as_in_c(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    # C converts a double that is passed as an int by cutting off its fraction.
    assert capi.vm(10.9, -10.9, True) == capi.TRUE  # type: ignore[arg-type]
    assert server.last() == Call("vm", (10, -10, 1))


# the Scout's arithmetic


@pytest.mark.parametrize(
    # 450 tenths of a degree x 0.118597 = 53.4 tenths of an inch a wheel; 8 tenths give 0.9, which is cut off to 0.
    ("trans", "steer", "right", "left"), [(100, 0, 100, 100), (0, 450, 53, -53), (100, -450, 47, 153), (0, 8, 0, 0)]
)
def test_wheel_velocities_of_a_scout(server: ScriptedServer, trans: int, steer: int, right: int, left: int) -> None:
    assert capi.connect_robot(1)
    assert (capi.RIGHT(trans, steer), capi.LEFT(trans, steer)) == (right, left)
    assert capi.scout_vm(trans, steer)
    assert server.last() == Call("vm", (right, left, 0))
    assert capi.scout_pr(trans, steer)
    assert server.last() == Call("pr", (right, left, 0))


# Travel of a wheel for a degree of turn: half the track of 13.590 in, times pi / 180.
def test_the_rotation_constant_is_half_the_track() -> None:
    assert pytest.approx(13.590 / 2 * 3.14159265 / 180, rel=1e-4) == capi.ROTATION_CONSTANT


# failing as C does


def test_every_call_is_false_before_connecting(capsys: pytest.CaptureFixture[str]) -> None:
    # Values of the lists must not change by a call that fails.
    out: list[Any] = [9] * 9
    assert [capi.gs(), capi.vm(1, 2, 3), capi.tk("x"), capi.ct(), capi.get_rpx(out)] == [capi.FALSE] * 5
    assert [capi.disconnect_robot(1), capi.predict_sensors(0, 0, 0, 0, out, out)] == [0, 0]
    assert [capi.motion_check(0, 0, 0, 0, 0, 0, 0, 0, out), capi.sim_truth(out), capi.arm_zr(0)] == [0, 0, 0]
    assert out == [9] * 9
    assert (capi.posTimeGet(), capi.voltCpuGet(), capi.voltMotorGet()) == (0, 0.0, 0.0)
    assert isinstance(capi.last_error(), ConnectionLost)
    assert capsys.readouterr() == ("", "")


def test_a_refusal_is_false_with_its_code_in_state_44(server: ScriptedServer) -> None:
    assert capi.last_error() is None
    server.slots = {0: 10, 17: 80}
    assert capi.connect_robot(1) == 7019
    server.answers["vm"] = error(5)
    state = capi.State
    assert capi.vm(1, 1, 1) == capi.FALSE
    # Error 5 in State[44], and the sonar as before.
    assert (state[44], state[17]) == (5, 80)
    assert isinstance(capi.last_error(), RobotRefused)
    assert capi.gs() == capi.TRUE
    assert state[44] == 0
    # Programs hold references to the State array: it must be changed in place.
    assert state is capi.State


class Mute:
    """A backend that greets with nothing, as a robot's own line may, and refuses whatever is asked."""

    wire_state, greeting, port, closed = serial_wire_state(SCOUT), None, 1, False

    def execute(self, call: Call) -> Reply:
        raise RobotRefused(call.name, 4)

    def close(self) -> None:
        self.closed = True


def test_connecting_without_a_state(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capi, "open_machine", lambda *_: Mute())
    capi.State[17] = 5
    assert capi.connect_robot(1) == 1
    assert capi.State[17] == 5
    assert capi.gs() == capi.FALSE
    assert (capi.State[17], capi.State[44]) == (5, 4)
    assert capi.Laser[0] == 0


# After a missing reply the next one could be the wrong one: the connection is closed.
def test_a_timeout_is_false_and_so_is_every_later_call(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    server.answers["gs"] = None
    assert capi.gs() == capi.FALSE
    assert isinstance(capi.last_error(), ReplyTimeout)
    assert capi.st() == capi.FALSE
    assert capi.disconnect_robot(1) == capi.FALSE


def test_values_that_cannot_be_encoded_are_false(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    assert capi.vm(1 << 40, 0, 0) == capi.FALSE
    assert isinstance(capi.last_error(), WireError)
    assert capi.special_request([1, 2], []) == capi.FALSE
    assert capi.add_obstacle([]) == capi.FALSE
    assert server.names() == []


@pytest.mark.parametrize("mode", [6, 7, 8])
# Modes 6 to 8 of any axis, pa and conf_ser are refused by the C library itself.
@pytest.mark.parametrize("axis", [0, 2, 4])
def test_refused_modes_are_not_sent(server: ScriptedServer, mode: int, axis: int) -> None:
    assert capi.connect_robot(1)
    modes = [0] * 6
    modes[axis] = mode
    assert capi.mv(*modes) == capi.FALSE
    assert capi.pa(1, 2, 3) == capi.FALSE
    assert capi.conf_ser(1, 9600) == capi.FALSE
    assert server.names() == []


def test_an_unknown_robot_number_is_false(server: ScriptedServer) -> None:
    server.answers["connect_robot"] = simple(0)
    assert capi.connect_robot(9) == capi.FALSE
    assert str(capi.last_error()).endswith("the server has no robot number 9")
    assert capi.gs() == capi.FALSE


def test_a_robot_that_cannot_be_created_is_false(server: ScriptedServer) -> None:
    server.answers["create_robot"] = simple(0)
    assert capi.create_robot(9) == capi.FALSE
    assert "the server makes no robot number 9: no room for one more, or no more are made" in str(capi.last_error())


def test_a_missing_server_is_false() -> None:
    # The port is closed again at the end of the block: nothing listens on it then.
    with socket.create_server(("127.0.0.1", 0)) as listener:
        use(listener.getsockname()[1])
        assert capi.server_is_running() == capi.TRUE
    assert capi.server_is_running() == capi.FALSE
    assert capi.connect_robot(1) == capi.FALSE
    assert isinstance(capi.last_error(), ConnectionLost)


# connecting, masks, stamps


def test_the_environment_is_the_default_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    server = ScriptedServer()
    with on_socket(by_script(server, 3)) as port:
        monkeypatch.setenv("NOMAD_ROBOT", f"nserver://127.0.0.1:{port}/2?tm_s=0")
        # A port where nothing listens: the environment must win.
        capi.SERV_TCP_PORT = 1
        assert capi.connect_robot(1) == capi.FALSE
        assert str(capi.last_error()).startswith(f"NOMAD_ROBOT: 'nserver://127.0.0.1:{port}/2?tm_s=0' names robot 2, ")
        assert capi.connect_robot(2) == 7019
        assert capi.disconnect_robot(2)
    assert server.calls[0].args[0] == 2


@pytest.mark.parametrize("connects", [capi.connect_robot, capi.create_robot])
def test_an_address_of_another_robot_is_refused(connects: Callable[[int], int]) -> None:
    capi.SERVER_MACHINE_NAME = "nserver://localhost:1/2"
    assert connects(1) == capi.FALSE
    assert "names robot 2, the program asks for robot 1" in str(capi.last_error())
    assert connects(2) == capi.FALSE
    assert "no answer at localhost:1" in str(capi.last_error())


def test_reconnecting_resets_the_mask(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    capi.Smask[17] = 0
    assert capi.ct()
    assert capi.connect_robot(2)
    # One robot at a time: connecting again ends the first connection.
    assert server.closed == 1
    assert [call.name for call in server.calls] == [
        "connect_robot", "ct", "ct", "disconnect_robot", "connect_robot", "ct",
    ]  # fmt: skip
    assert server.last().args == EVERYTHING.smask == tuple(capi.Smask)


def test_a_robot_can_be_created(server: ScriptedServer) -> None:
    assert capi.create_robot(4) == 7019
    assert [call.name for call in server.calls] == ["create_robot", "ct"]


def test_mask_values_become_zero_or_one(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    capi.Smask[3] = 0
    capi.Smask[4] = 255
    # C programs set mask entries to any value other than 0.
    assert capi.ct()
    assert server.last().args[2:5] == (1, 0, 1)


@pytest.mark.parametrize("bits", [-1, 32])
def test_unknown_position_bits_are_false(server: ScriptedServer, bits: int) -> None:
    assert capi.connect_robot(1)
    assert capi.posDataRequest(bits) == capi.FALSE
    assert capi.posDataCheck() == 0
    assert server.names() == []


def test_rings_of_stamps_have_sixteen_times_nine_numbers(server: ScriptedServer) -> None:
    assert capi.connect_robot(1)
    assert capi.posDataRequest(1 + 2)
    assert capi.posDataCheck() == 3
    sonars: list[Any] = [None] * 16
    infrareds: list[Any] = [None] * 16
    assert capi.posSonarRingGet(sonars) == capi.posInfraredRingGet(infrareds) == capi.TRUE
    # A row of nine zeros for each sensor: no reading has arrived.
    assert sonars == infrareds == [[0] * 9] * 16
    assert server.last().args[0] == 3


@pytest.mark.parametrize("number", [-1, 16])
def test_stamps_of_missing_sensors_are_false(number: int) -> None:
    out = [7] * 9
    assert capi.posSonarGet(out, number) == capi.posInfraredGet(out, number) == capi.FALSE
    assert out == [7] * 9


def test_commands_of_this_simulation(server: ScriptedServer) -> None:
    server.answers["sim_truth"] = Reply("truth", values=(1, 2, 3, 4, 5, 6, 7, 8))
    assert capi.connect_robot(1)
    out = [0] * 10
    assert capi.sim_truth(out) == capi.TRUE
    assert out == [1, 2, 3, 4, 5, 6, 7, 8, 0, 0]
    assert capi.sim_control(3, 25) == capi.TRUE
    assert server.last() == Call("sim_control", (3, 25))


# a C program, line by line


def test_the_program_in_the_docstring_runs(capsys: pytest.CaptureFixture[str]) -> None:
    server = ScriptedServer()
    server.slots = {0: 10, 17: 80, 34: 123}

    def talk(connection: socket.socket) -> None:
        # Eight calls in all; the sonar's reading falls below the program's limit after the fifth.
        by_script(server, calls=5)(connection)
        server.slots[17] = 20
        by_script(server, calls=8)(connection)

    program = docstring_program()
    assert len(program.splitlines()) == 12
    with on_socket(talk) as port:
        exec(program.replace('"lab"', '"127.0.0.1"').replace("7654", str(port)), {})
    assert capsys.readouterr().out == "stopped at 123 0 tenths of an inch\n"
    assert server.names() == ["sp", "vm", "gs", "gs", "st", "disconnect_robot"]


def docstring_program() -> str:
    text = inspect.cleandoc(capi.__doc__ or "")
    lines = [line.removeprefix("    ") for line in text.splitlines()[2:] if line.startswith("    ")]
    return "\n".join(lines)


def test_a_program_drives_the_simulation() -> None:
    capi.SERVER_MACHINE_NAME = "sim:thesis_room"
    assert capi.server_is_running()
    assert capi.connect_robot(1)
    assert capi.pr(50, 0, 0)
    assert capi.ws(1, 1, 1, 20)
    assert capi.State[34] == 50
    # A N150 has no laser: error 4.
    assert capi.get_ls() == capi.FALSE
    assert capi.State[44] == 4
    assert capi.disconnect_robot(1)
