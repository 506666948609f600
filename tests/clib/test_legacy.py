"""Programs in the style of the 1990s, compiled unchanged, drive the simulator over TCP and on a serial line.

All use one server, whose simulated time advances with their requests, so that the load of the machine has no effect.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.clib.clib_build import NARROW, PLAIN, PROGRAMS, TIMEOUT_S, BuildCache, BuildKind, run_nserver

# As compilers of the 1990s: functions without prototypes, and int by default.
OLD = ("-std=gnu89",)
LEGACY = PROGRAMS / "legacy"


@pytest.fixture(scope="module")
def lockstep_server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """Yield the port of a server with two robots and the serial link of the first; each request takes 0.05 s."""
    link = tmp_path_factory.mktemp("line") / "nomad"
    starts = ("--start", "0,0,0,0", "--start", "60,85,0,0")
    with run_nserver("--lockstep", "0.05", "--robots", "2", *starts, "--serial-link", str(link)) as port:
        yield port, link


def run_program(program: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a program without NOMAD_ROBOT in its environment, except from `variables`."""
    environment = {name: value for name, value in os.environ.items() if name != "NOMAD_ROBOT"} | variables
    return subprocess.run([str(program), *words], env=environment, capture_output=True, text=True,
                          timeout=TIMEOUT_S, check=False)  # fmt: skip


def test_tour_with_server(kind: BuildKind, lockstep_server: tuple[str, Path], builds: BuildCache) -> None:
    port, _ = lockstep_server
    done = run_program(builds.program(LEGACY / "tour.c", kind, flags=OLD), "127.0.0.1", port, "2")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:4] == [
        "start: x 300 y 700 steer 0 turret 0",
        "forward: x 540 y 700 steer 0 turret 0",
        "turned: x 540 y 700 steer 900 turret 900",
        "back: x 540 y 600 steer 900 turret 900",
    ]
    assert re.fullmatch(r"nearest \d+ \d+", lines[4])
    # vm at -5 in/s, a full battery, and a N150 has no infrared (error 4).
    assert lines[5:] == ["robots 2", "moving -50", "battery 12.0 clock runs", "error 4"]
    assert done.stderr == "Nclient: get_ir: error 4, not on this robot\n"


@pytest.mark.parametrize("width", [PLAIN, NARROW], ids=lambda kind: kind.name)
@pytest.mark.parametrize("library", ["nclient", "ndirect"])
def test_wander_with_address_from_environment(
    width: BuildKind, library: str, lockstep_server: tuple[str, Path], builds: BuildCache, skip_unbuildable: None
) -> None:
    del skip_unbuildable
    port, link = lockstep_server
    address = f"nserver://127.0.0.1:{port}/1" if library == "nclient" else f"serial://{link}?model=n150&baud=38400"
    check_wander(run_program(builds.program(LEGACY / "wander.c", width, library, OLD), NOMAD_ROBOT=address))


def test_wander_with_line_from_arguments(lockstep_server: tuple[str, Path], builds: BuildCache) -> None:
    _, link = lockstep_server
    check_wander(run_program(builds.program(LEGACY / "wander.c", PLAIN, "ndirect", OLD), str(link), "38400"))


def check_wander(done: subprocess.CompletedProcess[str]) -> None:
    assert (done.returncode, done.stderr) == (0, "")
    still, moved = done.stdout.splitlines()
    assert still == "still 0 0 0"
    found = re.fullmatch(r"way (\d+) legs 2 interrupted often", moved)
    assert found
    assert int(found[1]) > 10
