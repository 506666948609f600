"""Programs as they were written in the 1990s, compiled as they are, drive the emulator: over TCP and on a line.

One daemon for all; its time goes on by their questions, so that a busy machine changes nothing.
"""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from building import NARROW, PATIENCE_S, PLAIN, PROGRAMS, Kind, Workshop, daemon

OLD = ("-std=gnu89",)
LEGACY = PROGRAMS / "legacy"


@pytest.fixture(scope="module")
def in_lockstep(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path]]:
    """A port of two robots and a link of the first; a twentieth of a second passes a question, however busy we are."""
    link = tmp_path_factory.mktemp("line") / "nomad"
    starts = ("--start", "0,0,0,0", "--start", "60,85,0,0")
    with daemon("--lockstep", "0.05", "--robots", "2", *starts, "--serial-link", str(link)) as port:
        yield port, link


def says(program: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """What a program says, with nothing of the tester's own environment that names a robot."""
    environment = {name: value for name, value in os.environ.items() if name != "NOMAD_ROBOT"} | variables
    return subprocess.run([str(program), *words], env=environment, capture_output=True, text=True,
                          timeout=PATIENCE_S, check=False)  # fmt: skip


def test_a_tour_with_a_server(kind: Kind, in_lockstep: tuple[str, Path], workshop: Workshop) -> None:
    port, _ = in_lockstep
    done = says(workshop.program(LEGACY / "tour.c", kind, flags=OLD), "127.0.0.1", port, "2")
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[:4] == [
        "start: x 300 y 700 steer 0 turret 0",
        "forward: x 540 y 700 steer 0 turret 0",
        "turned: x 540 y 700 steer 900 turret 900",
        "back: x 540 y 600 steer 900 turret 900",
    ]
    assert re.fullmatch(r"nearest \d+ \d+", lines[4])
    assert lines[5:] == ["robots 2", "moving -50", "battery 12.0 clock runs", "error 4"]
    assert done.stderr == "Nclient: get_ir: refused with error 4, not on this robot\n"


@pytest.mark.parametrize("width", [PLAIN, NARROW], ids=lambda kind: kind.name)
@pytest.mark.parametrize("library", ["nclient", "ndirect"])
def test_wandering_by_its_number_alone(
    width: Kind, library: str, in_lockstep: tuple[str, Path], workshop: Workshop, can_build: None
) -> None:
    del can_build
    port, link = in_lockstep
    address = f"nserver://127.0.0.1:{port}/1" if library == "nclient" else f"serial://{link}?model=n150&baud=38400"
    wandered(says(workshop.program(LEGACY / "wander.c", width, library, OLD), NOMAD_ROBOT=address))


def test_wandering_as_the_direct_library_names_a_line(in_lockstep: tuple[str, Path], workshop: Workshop) -> None:
    _, link = in_lockstep
    wandered(says(workshop.program(LEGACY / "wander.c", PLAIN, "ndirect", OLD), str(link), "38400"))


def wandered(done: subprocess.CompletedProcess[str]) -> None:
    assert (done.returncode, done.stderr) == (0, "")
    still, way = done.stdout.splitlines()
    assert still == "still 0 0 0"
    found = re.fullmatch(r"way (\d+) legs 2 interrupted often", way)
    assert found
    assert int(found[1]) > 10
