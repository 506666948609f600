"""The benchmark runs and prints its results. Times are not checked."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "batch.py"


@pytest.mark.usefixtures("plain_batch")
def test_json_has_figures_references_and_targets(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    script = importlib.import_module("batch")
    assert script.main(["--json", "--robots", "20", "--steps", "2", "--rounds", "1"]) == 0
    # Small numbers: the test checks the form of the results, as a loaded machine would make any time wrong.
    found = json.loads(capsys.readouterr().out)
    assert len(found) == 2
    for result in found.values():
        assert (result["robots"], result["walls"], result["target_robot_steps_per_s"]) == (20, 50, 300_000)
        assert 0 < result["bytes_per_robot"] <= result["target_bytes_per_robot"] == 4096
        assert result["cpu_us_per_robot_step"] > 0.0


@pytest.mark.usefixtures("plain_batch")
def test_rays_are_measured_without_programs_that_are_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    # As if none of the other simulators were installed.
    for name in ("vmas", "kheperax", "torch", "jax"):
        monkeypatch.setitem(sys.modules, name, None)
    script = importlib.import_module("batch_rays")
    assert script.main(["--robots", "3", "--rounds", "1", "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert list(found) == ["batch"]
    assert found["batch"]["cpu_ns_per_ray"] > 0.0
    assert "install the package vmas" in err
    assert "install the package kheperax" in err
