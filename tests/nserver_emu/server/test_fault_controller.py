"""The plan in force: one injector a line, counts that outlive a plan's neighbours, and lines that must be there."""

from __future__ import annotations

import pytest

from nclient.errors import FaultPlanError
from nclient.faults.plan import Direction, Drop, Plan, Rule, When
from nserver_emu.server.serial_session import FaultController

LINES = ("nserver", "serial:1", "robotd:2")


def controller_with(*rules: Rule) -> FaultController:
    controller = FaultController(lambda: 100.0)
    controller.put(Plan(rules), LINES)
    return controller


def test_without_a_plan_nothing_happens_anywhere() -> None:
    controller = FaultController(lambda: 0.0)
    assert not controller.acts_on("serial:1")
    assert controller.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 0.0)[0].data == b"x"
    assert controller.counts() == {}


def test_each_line_has_one_injector_of_its_own() -> None:
    controller = controller_with(Rule("it", (Drop(),), lines=("serial", "nserver")))
    assert [controller.acts_on(line) for line in LINES] == [True, True, False]
    assert controller.injector("serial:1") is controller.injector("serial:1")
    assert not controller.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 100.0)
    counts = {"nserver": {"it": {"seen": 0, "drop": 0}}, "serial:1": {"it": {"seen": 1, "drop": 1}}}
    assert controller.counts() == counts
    controller.reset()
    assert controller.counts()["serial:1"]["it"]["drop"] == 0


def test_times_count_from_when_the_plan_came_into_force() -> None:
    controller = controller_with(Rule("it", (Drop(),), When(from_s=1.0)))
    assert controller.injector("nserver").process_frame(b"x", "", Direction.REPLY, 100.9)
    assert not controller.injector("nserver").process_frame(b"x", "", Direction.REPLY, 101.0)


def test_a_missing_line_is_named_and_the_old_plan_stays() -> None:
    before = Plan((Rule("before", (Drop(),)),))
    controller = controller_with(*before.rules)
    for line in ("serial:3", "sim"):
        with pytest.raises(FaultPlanError, match=f"there is no {line}"):
            controller.put(Plan((Rule("it", (Drop(),), lines=(line,)),)), LINES)
    assert controller.plan == before
    controller.clear()
    assert not controller.acts_on("nserver")
