"""One mission on three addresses: in process, over TCP, on a pseudo-terminal; and how it ends."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from nclient import connect
from tests.programs import forked, ports
from tests.programs.forked import Forked

TIMEOUT_S = 60.0
MISSION = """
title = "Short drive"
map = "thesis_room"
time_limit_s = 120

[[step]]
do = "go_to"
to_in = [16, 8]
time_limit_s = 60
retries = 1

[[step]]
do = "look"

[[step]]
do = "turn"
heading_deg = 90
"""


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    path = tmp_path / "little.toml"
    path.write_text(MISSION)
    return path


@pytest.fixture
def server(tmp_path: Path) -> Iterator[dict[str, str]]:
    """Run a server with a serial line and yield its listening addresses."""
    words = ("--port", "0", "--noisy", "--seed", "2", "--serial-link", str(tmp_path / "nomad"))
    with Forked("nserver", "thesis_room", *words) as process:
        try:
            lines = [process.stdout.readline().split() for _ in range(2)]
            yield {kind: where for _, kind, where in lines}
        finally:
            process.terminate()
            process.wait(TIMEOUT_S)


def address_of(kind: str, server: dict[str, str]) -> str:
    if kind == "sim":
        return "sim:thesis_room?noisy=1&seed=2"
    if kind == "nserver":
        return f"nserver://{server['nserver']}/1?timeout_s=20"
    return f"serial://{server['serial']}?model=n150&timeout_s=5"


def run(mission: Path, address: str, *words: str) -> dict[str, Any]:
    line = ("mission", str(mission), address, "--json", "--sonars", "rays", *words)
    done = forked.run_forked("nomad", *line, timeout=TIMEOUT_S)
    assert done.returncode == 0, done.stdout + done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("kind", ["sim", "nserver", "serial", "portable serial"])
def test_mission_is_equal_on_every_address(
    kind: str, server: dict[str, str], mission: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "portable serial":
        monkeypatch.setenv(ports.VARIABLE, "1")
    report = run(mission, address_of(kind, server))
    assert report["ending"] == "done"
    assert [step["do"] for step in report["steps"]] == ["go_to", "look", "turn"]
    assert (report["pose"]["x_in"], report["pose"]["y_in"]) == pytest.approx((16.0, 8.0), abs=1.3)
    assert report["pose"]["heading_deg"] == pytest.approx(90.0, abs=5.0)
    assert report["touches"] == 0
    assert (report["truth"] is None) == kind.endswith("serial")
    if kind != "sim":
        with connect(f"nserver://{server['nserver']}/1") as robot:
            truth = robot.truth()
            assert (truth.x_in, truth.y_in) == pytest.approx((16.0, 8.0), abs=2.0)
            assert not robot.refresh().moving


def test_interrupted_mission_stops_robot_and_reports(server: dict[str, str], tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    far = tmp_path / "far.toml"
    far.write_text(MISSION.replace("[16, 8]", "[80, 80]"))
    line = ("mission", str(far), address_of("nserver", server), "--report", str(report))
    with connect(f"nserver://{server['nserver']}/1") as watching:
        with Forked("nomad", *line, stderr=True) as process:
            until_s = time.monotonic() + TIMEOUT_S
            while watching.refresh().translation_in_s < 1.0:
                assert time.monotonic() < until_s
                time.sleep(0.05)
            os.kill(process.pid, signal.SIGINT)
            output, _ = process.communicate(timeout=TIMEOUT_S)
        assert process.returncode == 130
        until_s = time.monotonic() + TIMEOUT_S
        while watching.refresh().moving:
            assert time.monotonic() < until_s
            time.sleep(0.05)
    assert "interrupted" in output
    written = json.loads(report.read_text())
    assert (written["ending"], written["steps"][0]["ending"]) == ("interrupted", "interrupted")
