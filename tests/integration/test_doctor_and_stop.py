"""nomad doctor and nomad stop as programs on a robot's own line, with and without faults."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from tests.programs.forked import Forked

NOMAD = [
    sys.executable, "-c",
    "import sys; from nclient.cli.main import main; from tests.programs.ports import select_ports; "
    "select_ports(); sys.exit(main())",
]  # fmt: skip
FAULTS = """
seed = 3
[[rule]]
do = "drop"
every = 3
"""


@contextlib.contextmanager
def robot_on_a_line(link: Path) -> Iterator[tuple[str, str]]:
    """Run a server with a pseudo-terminal and yield the addresses of both."""
    with Forked("nserver", "--port", "0", "--noisy", "--serial-link", str(link)) as daemon:
        try:
            places = dict(daemon.stdout.readline().split()[1:] for _ in range(2))
            yield f"nserver://{places['nserver']}", f"serial://{places['serial']}?model=n150"
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.returncode == 0


def nomad(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*NOMAD, *words], capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.usefixtures("serial_ports")
def test_a_robot_on_its_own_line(tmp_path: Path) -> None:
    with robot_on_a_line(tmp_path / "robot") as (tcp, line):
        done = nomad("doctor", line, "--exchanges", "60", "--json")
        found = {finding["what"]: finding["grade"] for finding in json.loads(done.stdout)["findings"]}
        assert done.returncode == 0
        assert {found[what] for what in ("firmware", "line", "motion", "clock", "bumpers", "computer")} == {"OK"}
        with connect(tcp) as driver:
            driver.drive(translation_in_s=5)
            assert nomad("stop", line).stdout.startswith("stands still at x ")
            assert not driver.refresh().moving


@pytest.mark.usefixtures("serial_ports")
def test_doctor_on_line_that_drops_every_third_frame(tmp_path: Path) -> None:
    plan = tmp_path / "faults.toml"
    plan.write_text(FAULTS)
    with robot_on_a_line(tmp_path / "robot") as (tcp, line):
        noisy = f"{line}&faults={plan}&timeout_s=0.3"
        with connect(tcp) as driver:
            driver.drive(translation_in_s=5)
            done = nomad("stop", noisy)
            assert (done.returncode, done.stdout.partition(" at ")[0]) == (0, "stands still")
            assert not driver.refresh().moving
        done = nomad("doctor", noisy, "--exchanges", "12")
        assert done.returncode == 1
        assert done.stdout.startswith("FAIL  link         ")
