"""The C library and nclient.capi make the same calls to a simulated N200 and must have the same state after each.

Simulated time is paused. The calls are made twice before, so that both clients find the robot in the state in which
they leave it. The recorded sessions are an oracle for the state of the old library; here laser data, stamps and masks
come from the server of this project.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nclient import capi
from nclient.protocol.types import EVERYTHING
from tests.clib.clib_build import PROGRAMS, SANITIZED, BuildCache, run_calls, run_nserver
from tests.waiting import CLOSE_NOTICED_S

# A mask with two of three entries on.
PARTIAL = [int(k % 3 != 1) for k in range(44)]
CALLS = ["gs", "posDataRequest 31", "get_ir", "get_sn", "get_bp", "get_cp", "get_rc", "get_rv", "get_ra",
             "conf_sg 50 4 30", "conf_ls 33 20 20 20 4", "gs", "get_sg", "conf_ls 51 20 20 100 4", "gs", "get_rc",
             "mask 6 " + " ".join(map(str, PARTIAL[1:])), "gs", "get_sn", "dp 123 -456", "da 900 1800",
             "sp 100 100 100", "conf_tm 3", "conf_sn 15 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15", "vm 0 0 0",
             "tk hello"]  # fmt: skip
SERVER_CALLS = ["get_ls", "gs", "conf_ls 33 20 20 20 4", "get_ls", "gs", "conf_ls 35 20 20 20 4", "get_ls", "gs",
               # vm at 10000 in/s is clamped, and quit_server is refused by the setup.
               "get_robot_conf", "get_rpx", "vm 100000 0 0", "quit_server", "place_robot 300 300 100 200", "gs",
               "add_obstacle 3 500 500 550 500 500 550", "move_obstacle 3 500 500 550 500 500 550 10 -10",
               "new_world", "draw_line 0 0 10 10 1", "refresh_all", "real_robot", "simulated_robot"]  # fmt: skip


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    link = tmp_path_factory.mktemp("line") / "nomad"
    with run_nserver("--robot", "n200", "--paused", "--start", "40,40,30,10", "--serial-link", str(link)) as port:
        yield port, link


def capi_states(calls: list[str]) -> Iterator[dict[str, Any]]:
    """Yield the state of nclient.capi after each call."""
    for line in calls:
        name, *words = line.split()
        numbers: list[Any] = [int(word) for word in words if word.lstrip("-").isdecimal()]
        out = [0] * 31
        match name:
            case "mask":
                capi.Smask[:] = numbers
                returned = capi.ct()
            case "conf_sn":
                returned = capi.conf_sn(numbers[0], numbers[1:])
            case "tk":
                returned = capi.tk(words[0])
            case "get_rpx" | "get_robot_conf":
                returned = getattr(capi, name)(out)
            case "add_obstacle":
                returned = capi.add_obstacle(numbers)
            case "move_obstacle":
                out[: len(numbers) - 2] = numbers[:-2]
                returned = capi.move_obstacle(out, *numbers[-2:])
            case _:
                returned = getattr(capi, name)(*numbers)
        yield {"return": returned, "pos": capi.posDataCheck(), "time": capi.posTimeGet(), "State": list(capi.State),
               # A count and the first readings: the whole array is compared by the recorded sessions.
               "Laser": capi.Laser[:7], "volt_cpu": pytest.approx(capi.voltCpuGet(), abs=1e-4),
               "volt_motor": pytest.approx(capi.voltMotorGet(), abs=1e-4), **stamps(),
               **({"obs": out} if name.startswith("get_r") and out != [0] * 31 else {})}  # fmt: skip


def stamps() -> dict[str, list[int]]:
    single: dict[str, list[int]] = {name: [0] * 9 for name in ("bumper", "laser", "compass")}
    capi.posBumperGet(single["bumper"])
    capi.posLaserGet(single["laser"])
    capi.posCompassGet(single["compass"])
    rings: list[list[list[int]]] = [[[0] * 9] * 16, [[0] * 9] * 16]
    capi.posSonarRingGet(rings[0])
    capi.posInfraredRingGet(rings[1])
    sonars, infrareds = rings
    return {"pos_sonar_0": sonars[0], "pos_sonar_15": sonars[15], "pos_ir_0": infrareds[0], "pos_ir_15": infrareds[15],
            **{f"pos_{name}": stamp for name, stamp in single.items()}}  # fmt: skip


@pytest.fixture
def fresh_capi(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Reset nclient.capi to its initial state."""
    monkeypatch.setattr(capi, "SERVER_MACHINE_NAME", "127.0.0.1")
    monkeypatch.setattr(capi, "SERV_TCP_PORT", 7019)
    monkeypatch.setattr(capi, "_client_state", type(capi._client_state)())
    capi.State[:], capi.Laser[:], capi.Smask[:] = [0] * 45, [0] * 965, EVERYTHING.smask
    yield
    capi.disconnect_robot(1)


def assert_equal_states(calls: list[str], states: list[dict[str, Any]], expected: list[dict[str, Any]]) -> None:
    for call, c, python in zip(calls, states, expected, strict=True):
        assert {name: c[name] for name in python} == python, call


@pytest.mark.usefixtures("fresh_capi")
def test_c_and_python_agree_over_tcp(robot: tuple[str, Path], builds: BuildCache) -> None:
    calls = ["connect_robot 1", *CALLS, *SERVER_CALLS]
    program = str(builds.program(PROGRAMS / "replay.c", SANITIZED))
    # The third run is compared: after two runs the robot is in the state in which each run leaves it.
    *_, (*states, _) = [run_calls([program, robot[0]], "\n".join((*calls, ""))) for _ in range(3)]
    capi.SERV_TCP_PORT = int(robot[0])
    assert_equal_states(calls, states, list(capi_states(calls)))
    # Only the calls that the server refuses return 0.
    assert sum(after["return"] == 0 for after in states) < 5
    # The laser of the N200 has readings: all zeros would be equal in both clients, too.
    assert any(after["Laser"][0] for after in states)


@pytest.mark.usefixtures("fresh_capi")
def test_c_and_python_agree_on_a_line(robot: tuple[str, Path], builds: BuildCache) -> None:
    program = str(builds.program(PROGRAMS / "replay.c", SANITIZED, "ndirect"))
    words = [program, str(capi.MODEL_N200), str(robot[1]), "38400"]
    for _ in range(3):
        *states, _ = run_calls(words, "\n".join(("connect_robot 1", *CALLS, "")))
        # The server closes the line a moment after the program has ended.
        time.sleep(CLOSE_NOTICED_S)
    assert capi.connect_robot(1, capi.MODEL_N200, str(robot[1]), 38400)
    assert_equal_states(CALLS, states[1:], list(capi_states(CALLS)))
    assert all(after["return"] for after in states)
