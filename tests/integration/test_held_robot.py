"""A person holds a robot: programs in Python and C are informed, on a simulation and through the gateway to a line."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest

from nclient import RobotHeld, connect
from nserver_emu.control.cli import main as ctl
from tests.clib.clib_build import PLAIN, PROGRAMS, TIMEOUT_S, BuildCache
from tests.clib.conftest import builds  # noqa: F401
from tests.integration.test_doctor_and_stop import nomad
from tests.integration.test_gateway import nserver
from tests.waiting import wait_until

# stdout of `nserver ctl status` is of no interest.
pytestmark = pytest.mark.usefixtures("capsys")


def control(command: str, path: Path, *words: str) -> None:
    assert ctl([command, "--control", str(path), *words]) == 0


@pytest.mark.usefixtures("serial_ports")
def test_gateway_informs_program_of_held_real_robot(tmp_path: Path) -> None:
    link, path = tmp_path / "line", tmp_path / "ctl"
    with (
        nserver("--port", "0", "--serial-link", str(link)) as real,
        nserver("--port", "0", "--real", f"serial://{link}?model=n150", "--control", str(path)) as gateway,
        connect(real.address) as observer,
        connect(gateway.address) as robot,
    ):
        robot.drive(translation_in_s=5)
        wait_until(lambda: observer.refresh().moving)
        control("stop", path)
        with pytest.raises(RobotHeld, match="nserver ctl release 1") as refusal:
            robot.drive(translation_in_s=5)
        assert refusal.value.by == "nserver ctl"
        wait_until(lambda: not observer.refresh().moving)
        # Queries, settings and st still work.
        assert robot.refresh().is_held
        assert not robot.stop().moving
        found = json.loads(nomad("state", gateway.address, "--json").stdout)
        assert found["held"]
        assert nomad("state", gateway.address, "hold").stdout.startswith("hold        HELD")
        with pytest.raises(RobotHeld, match="nserver ctl"):
            robot.wait_until_released(0.0)
        control("release", path)
        assert not robot.wait_until_released(10.0).is_held
        assert robot.held_by() == ""
        robot.drive(translation_in_s=5)


def test_program_of_1998_survives_hold_and_goes_on(builds: BuildCache, tmp_path: Path) -> None:  # noqa: F811
    path = tmp_path / "ctl"
    with nserver("--port", "0", "--lockstep", "0.05", "--control", str(path)) as server:
        control("stop", path)
        program = builds.program(PROGRAMS / "legacy" / "wander.c", PLAIN, flags=("-std=gnu89",))
        environment = os.environ | {"NOMAD_ROBOT": server.address}
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        with subprocess.Popen([program], env=environment, text=True, **pipes) as wander:  # type: ignore[call-overload]
            assert wander.stderr is not None
            # The hold is printed once, however often the program repeats its command.
            assert "error 7" in wander.stderr.readline()
            control("release", path)
            out, rest = wander.communicate(timeout=TIMEOUT_S)
    assert (wander.returncode, rest) == (0, "")
    assert "legs 2" in out
