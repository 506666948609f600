"""A simulation out of a stranger's file is tried within bounds: clocks without end, numbers that are none."""

from __future__ import annotations

import json
import sys
from typing import Any

import pytest

from nclient.errors import SnapshotError
from nserver_emu.persistence import snapshot
from nserver_emu.persistence import snapshot as trial
from nserver_emu.persistence.snapshot import Budget, try_out
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.server.inprocess import open_address
from tests.nserver_emu.server.wire_client import simulation


def saved() -> dict[str, Any]:
    whole: dict[str, Any] = json.loads(snapshot.dumps(Emulator(simulation())))
    return whole


def of(whole: dict[str, Any], ending: str) -> dict[str, Any]:
    """What the first object of that class holds."""
    return next(each["of"] for each in whole["objects"] if each["is"].endswith(ending))


def refusal(whole: dict[str, Any]) -> str:
    with pytest.raises(SnapshotError) as refused:
        snapshot.loads(Emulator(simulation()), json.dumps(whole))
    return str(refused.value)


@pytest.mark.parametrize(("ending", "name", "value", "words"), [
    (":SonarRing", "due_ps", -(10**30), "its time has no end"),
    (":Simulation", "_time_ps", 10**30, "its time has no end"),
    (":SonarRing", "_interval_ps", -1, "a ring of sonars without an interval"),
    (":SonarRing", "_interval_ps", 0, "a ring of sonars without an interval"),
    (":Chassis", "_x_in", 1e308, "is damaged: FloatingPointError"),
    (":Encoders", "_x_in", float("inf"), "is damaged: "),
    (":Encoders", "_turret_offset_rad", 10**400, "is damaged: OverflowError"),
])  # fmt: skip
def test_numbers_that_no_simulation_has_are_refused(ending: str, name: str, value: float, words: str) -> None:
    whole = saved()
    assert name in of(whole, ending)
    of(whole, ending)[name] = value
    assert words in refusal(whole)


def test_a_ring_that_is_on_has_an_order() -> None:
    whole = saved()
    ring = of(whole, ":SonarRing")
    whole["objects"].append({"is": "tuple", "of": []})
    ring["_order"] = {"ref": len(whole["objects"]) - 1}
    assert "a ring of sonars without an interval or an order" in refusal(whole)


@pytest.mark.parametrize("damage", [{"is": "deque", "most": 10**30, "of": []}, {"is": "deque", "most": -1, "of": []}])
def test_a_list_of_no_length_is_refused(damage: dict[str, Any]) -> None:
    whole = saved()
    whole["objects"].append(damage)
    of(whole, ":Simulation")["robots"] = {"ref": len(whole["objects"]) - 1}
    assert "is damaged" in refusal(whole)


def test_what_is_sound_passes_and_leaves_no_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    before = sys.getprofile()
    sound = simulation(noisy=True)
    try_out(sound)
    assert sys.getprofile() is before
    monkeypatch.setattr(trial, "CALLS", 10)
    with pytest.raises(SnapshotError, match="its time has no end"):
        try_out(sound)
    assert sys.getprofile() is before


def test_calls_are_counted_and_what_else_happens_is_not() -> None:
    budget = Budget(2)
    for event in ("call", "return", "c_call", "c_return", "c_exception"):
        budget.count(None, event, None)
    assert budget.left == 0
    with pytest.raises(SnapshotError, match="its time has no end"):
        budget.count(None, "call", None)


def test_a_crowd_that_hears_as_measured_is_within_the_bound() -> None:
    try_out(open_address("sim:thesis_room?robots=8&setup=measured").emulator.simulation)
