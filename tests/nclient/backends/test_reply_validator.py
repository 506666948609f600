"""Impossible replies are rejected; those of an unusual robot are accepted the third time."""

from __future__ import annotations

from typing import Any

import pytest

from nclient.backends.wrappers import ReplyValidator
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, SCOUT, Model


def state(clock: int = 1000, volts: tuple[int, int] = (200, 200), **changed: Any) -> Reply:
    """A state packet of a N150 at rest, with some slots changed (s36=..)."""
    # Sonars at 50 in, the bumper bits of a N150 at rest, pose, velocities, motors and compass 0.
    slots = dict.fromkeys(range(17, 33), 50) | {33: 0xF00000} | dict.fromkeys((*range(34, 42), 43), 0)
    return Reply("state", slots | {int(name[1:]): value for name, value in changed.items()}, clock=clock, volts=volts)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"s36": 3599, "s37": 0}, ""),
        ({"s36": 3600}, "steering reads 3600, and a n150's lies from 0 to 3599"),
        ({"s37": -1}, "turret reads -1"),
        ({"s43": 4000}, "compass reads 4000"),
        # 6 to 255 in; 0 is a dead sonar.
        ({"s17": 0, "s18": 6, "s19": 255}, ""),
        ({"s20": 5}, "sonar 3 reads 5"),
        ({"s38": -2000}, ""),
        # 2000 tenths per second: four times the maximum of any model.
        ({"s40": 2001}, "State[40] reads 2001"),
        ({"s33": 0xF00021}, ""),
        # One of the four bits that always read 1 reads 0.
        ({"s33": 0x700021}, "bumper bits 700021"),
        ({"s41": 7}, ""),
        ({"s41": 8}, "the motors' status reads 8"),
    ],
)
def test_ranges(changed: dict[str, Any], expected: str) -> None:
    found = ReplyValidator(N150).find_inconsistency(state(**changed))
    assert found.startswith(expected)
    assert bool(found) == bool(expected)


def test_a_scout_has_other_bits() -> None:
    assert ReplyValidator(SCOUT).find_inconsistency(state(s33=0, s41=0x7F)) == ""
    assert ReplyValidator(SCOUT).find_inconsistency(state(s33=0, s41=0x80))


@pytest.mark.parametrize(
    ("model", "after", "expected"),
    [
        (N150, {"clock": 1000}, ""),
        # 600 s, the longest pause of a program, since the last reply.
        (N150, {"clock": 601_000}, ""),
        (N150, {"clock": 601_001}, "the clock goes from 1000 to 601001"),
        (N150, {"clock": 999}, "the clock goes from 1000 to 999"),
        # 60 at once and 600 a second: 60 + 60 = 120 in 100 ms.
        (N150, {"clock": 1100, "s34": 120}, ""),
        (N150, {"clock": 1100, "s34": 121}, "x jumps from 0 to 121 in 100 ms"),
        # 60 + 600 x 1.1 = 720.
        (N150, {"clock": 2100, "s35": -720}, ""),
        (N150, {"clock": 2100, "s35": -721}, "y jumps"),
        # 100 at once and 1000 a second: 200, across 0; 3400 is -200.
        (N150, {"clock": 1100, "s36": 3400}, ""),
        (N150, {"clock": 1100, "s36": 3399}, "steering jumps from 0 to 3399"),
        (N150, {"clock": 1100, "s37": 201}, "turret jumps"),
        # A Scout turns faster: 100 + 4000 x 0.1 = 500.
        (SCOUT, {"clock": 1100, "s36": 500}, ""),
        (SCOUT, {"clock": 1100, "s36": 501}, "steering jumps"),
        # 64 is the maximum step of a battery byte.
        (N150, {"clock": 1100, "volts": (136, 255)}, ""),
        (N150, {"clock": 1100, "volts": (200, 265)}, "a battery byte goes from 200 to 265"),
        # Without a conf_sn the validator has no interval between two sonars.
        (N150, {"clock": 1100, "s17": 99, "s18": 98, "s19": 97, "s20": 96}, ""),
    ],
)
def test_changes(model: Model, after: dict[str, Any], expected: str) -> None:
    checks = ReplyValidator(model)
    rest: dict[str, Any] = {"s33": model.bumper_rest}
    assert checks.find_inconsistency(state(**rest)) == ""
    found = checks.find_inconsistency(state(**(rest | after)))
    assert found.startswith(expected)
    assert bool(found) == bool(expected)


def test_the_clock_may_run_over() -> None:
    checks = ReplyValidator(N150)
    # The clock has 32 bits.
    assert checks.find_inconsistency(state(clock=(1 << 32) - 10)) == ""
    assert checks.find_inconsistency(state(clock=20)) == ""


def test_sonars_change_no_faster_than_they_fire() -> None:
    checks = ReplyValidator(N150)
    sixty: dict[str, Any] = {f"s{slot}": 60 for slot in range(17, 33)}
    checks.find_inconsistency(state())
    # Rate 15 is 60 ms a sonar.
    checks.update_from_request(Call("conf_sn", (15, *range(16))))
    # conf_sn restarts the ring: all sonars may change once.
    assert checks.find_inconsistency(state(1001, **sixty)) == ""
    # In 60 ms one sonar fires, two more at the ends of the interval; s20 and higher, back at 50, are more than three.
    assert checks.find_inconsistency(state(1061, s17=61, s18=61, s19=61)) != ""
    three = sixty | {"s17": 61, "s18": 61, "s19": 61}
    assert checks.find_inconsistency(state(1061, **three)) == ""
    six = three | {"s20": 61, "s21": 61, "s22": 61}
    # No time has passed, which allows two changes.
    assert checks.find_inconsistency(state(1061, **six)).startswith("3 sonars changed in 0")


@pytest.mark.parametrize("name", ["dp", "da", "zr"])
# Commands that set the pose: the next change is no motion.
def test_what_is_set_is_no_jump(name: str) -> None:
    checks = ReplyValidator(N150)
    checks.update_from_request(Call(name))
    checks.find_inconsistency(state())
    checks.update_from_request(Call(name))
    assert checks.find_inconsistency(state(1016, s34=5000, s36=1800)) == ""
    assert checks.find_inconsistency(state(1032, s34=0)) != ""


def test_replies_without_clock_have_range_checks_only() -> None:
    checks = ReplyValidator(N150)
    checks.find_inconsistency(state())
    # Without a clock there is no time between two replies: ranges only.
    assert checks.find_inconsistency(Reply("configuration", {34: 9000, 35: 0, 36: 0, 37: 0})) == ""
    assert checks.find_inconsistency(Reply("configuration", {34: 0, 35: 0, 36: 9000, 37: 0})) != ""
    assert checks.find_inconsistency(Reply("sonar", dict.fromkeys(range(17, 33), 99), clock=1200)) == ""
    assert checks.find_inconsistency(state(1200, s34=10)) == ""


def test_the_third_inconsistent_reply_is_accepted() -> None:
    checks = ReplyValidator(N150)
    for clock in (1000, 1016):
        assert checks.find_inconsistency(state(clock, s43=-1)).startswith("compass")
        # Counted for each kind of reply: a good velocity reply in between does not reset the count.
        assert checks.find_inconsistency(Reply("velocity", {38: 0, 39: 0, 40: 0})) == ""
    assert checks.find_inconsistency(state(1032, s43=-1)) == ""
    # The third one is accepted, and so are those after it, until a consistent reply.
    assert checks.find_inconsistency(state(1048, s43=-2)) == ""
    assert checks.find_inconsistency(state(1064)) == ""
    assert checks.find_inconsistency(state(1080, s43=-1)) != ""


# A robot that was restarted looks like a corrupt clock at first.
def test_a_reset_clock_is_accepted_the_third_time() -> None:
    checks = ReplyValidator(N150)
    checks.find_inconsistency(state(90_000))
    assert checks.find_inconsistency(state(10)) != ""
    assert checks.find_inconsistency(state(26)) != ""
    assert checks.find_inconsistency(state(42)) == ""
    assert checks.find_inconsistency(state(58)) == ""
    assert checks.find_inconsistency(state(40)) != ""


@pytest.mark.parametrize(("model", "bits", "other"), [(N150, 0, "model=scout"), (SCOUT, 0xF0, "model=n150")])
def test_bumper_bits_of_another_model_are_never_accepted(model: Model, bits: int, other: str) -> None:
    checks = ReplyValidator(model)
    for clock in range(1000, 1160, 16):
        found = checks.find_inconsistency(state(clock, s33=bits))
        assert found.startswith("bumper bits")
        assert f"is it a {model.name}?" in found
        assert other in found


def test_bits_that_were_valid_once_can_change() -> None:
    checks = ReplyValidator(N150)
    assert checks.find_inconsistency(state(1000)) == ""
    # Once the model is certain, other bits may be accepted as those of a broken bumper.
    assert [bool(checks.find_inconsistency(state(clock, s33=0))) for clock in (1016, 1032, 1048)] == [True, True, False]
    checks = ReplyValidator(SCOUT)
    assert checks.find_inconsistency(state(1000, s33=0)) == ""
    assert checks.find_inconsistency(state(1016, s33=0xF0)) == ""
