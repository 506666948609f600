"""The plan in force: one injector a line, counts that outlive a plan's neighbours, and lines that must be there."""

from __future__ import annotations

import pytest

from nclient.errors import FaultPlanError
from nclient.faults.plan import Direction, Drop, Plan, Rule, When
from nserver_emu.server.link import FaultController

LINES = ("nserver", "serial:1", "robotd:2")


def desk_with(*rules: Rule) -> FaultController:
    desk = FaultController(lambda: 100.0)
    desk.put(Plan(rules), LINES)
    return desk


def test_without_a_plan_nothing_happens_anywhere() -> None:
    desk = FaultController(lambda: 0.0)
    assert not desk.acts_on("serial:1")
    assert desk.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 0.0)[0].data == b"x"
    assert desk.counts() == {}


def test_each_line_has_one_injector_of_its_own() -> None:
    desk = desk_with(Rule("it", (Drop(),), lines=("serial", "nserver")))
    assert [desk.acts_on(line) for line in LINES] == [True, True, False]
    assert desk.injector("serial:1") is desk.injector("serial:1")
    assert not desk.injector("serial:1").process_frame(b"x", "gs", Direction.REPLY, 100.0)
    assert desk.counts() == {"nserver": {"it": {"seen": 0, "drop": 0}}, "serial:1": {"it": {"seen": 1, "drop": 1}}}
    desk.reset()
    assert desk.counts()["serial:1"]["it"]["drop"] == 0


def test_times_count_from_when_the_plan_came_into_force() -> None:
    desk = desk_with(Rule("it", (Drop(),), When(from_s=1.0)))
    assert desk.injector("nserver").process_frame(b"x", "", Direction.REPLY, 100.9)
    assert not desk.injector("nserver").process_frame(b"x", "", Direction.REPLY, 101.0)


def test_a_line_that_is_not_there_is_named_and_the_plan_before_stays() -> None:
    before = Plan((Rule("before", (Drop(),)),))
    desk = desk_with(*before.rules)
    for line in ("serial:3", "sim"):
        with pytest.raises(FaultPlanError, match=f"there is no {line}"):
            desk.put(Plan((Rule("it", (Drop(),), lines=(line,)),)), LINES)
    assert desk.plan == before
    desk.clear()
    assert not desk.acts_on("nserver")
