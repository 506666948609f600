"""A cable under a plan: both directions, around a paced cable or none, with a plan that changes while it lies there."""

from __future__ import annotations

import pytest

from nclient.faults.inject import LINE_NAK, Injector, LineLanguage, TcpLanguage
from nclient.faults.plan import BOTH, Corrupt, Delay, Direction, Drop, Fault, HangUp, Nak, Plan, Rule, When
from nclient.protocol.serial_framing import build_frame
from nserver_emu.server.serial_session import MAX_IN_TRANSIT, Arrival, FaultyChannel, RateLimitedChannel

GS, VM = build_frame(7), build_frame(5, bytes(6))
REQUEST = frozenset({Direction.REQUEST})


class Bench:
    """A cable, and the plan that can be changed under it."""

    def __init__(self, *rules: Rule, paced: bool = False, tcp: bool = False) -> None:
        self.injector = Injector(Plan(rules), "serial:1")
        inner = RateLimitedChannel(38400) if paced else None
        self.cable = FaultyChannel(TcpLanguage(False) if tcp else LineLanguage(), lambda: self.injector, inner)

    def come(self, now_s: float) -> list[Arrival]:
        found = []
        while arrival := self.cable.arrived(now_s):
            found.append(arrival)
        return found

    def robot(self, now_s: float) -> bytes:
        return b"".join(arrival.data for arrival in self.come(now_s) if arrival.to_robot)


def rule(fault: Fault, when: When | None = None, directions: frozenset[Direction] = BOTH) -> Rule:
    return Rule("it", (fault,), when or When(), ("gs",), directions)


def test_what_no_rule_strikes_passes_at_once_and_in_order() -> None:
    bench = Bench(rule(Drop()))
    bench.cable.to_robot(VM, 1.0)
    bench.cable.to_host(VM, 1.0)
    due = [bench.cable.due_s]
    assert bench.come(1.0) == [Arrival(1.0, VM, True), Arrival(1.0, VM, False)]
    assert [*due, bench.cable.due_s] == [1.0, None]
    assert not bench.cable.full


def test_the_plan_applies_to_both_directions() -> None:
    bench = Bench(rule(Drop()))
    bench.cable.to_robot(GS + VM, 0.0)
    # The dropped gs is missing in both directions, vm is not matched by the rule.
    bench.cable.to_host(VM + GS, 0.0)
    assert bench.come(0.0) == [Arrival(0.0, VM, True), Arrival(0.0, VM, False)]
    bench.cable.to_robot(VM + VM + VM, 1.0)
    assert bench.come(1.0) == [Arrival(1.0, VM * 3, True)]
    # `seen` counts the frames that the rule matches: one in each direction.
    assert bench.injector.counts["it"] == {"seen": 2, "drop": 2}


def test_a_delay_holds_up_one_direction_and_not_the_other() -> None:
    bench = Bench(rule(Delay(2.0), directions=REQUEST))
    bench.cable.to_robot(GS, 1.0)
    # A later request without delay must not overtake: order on a line is fixed.
    bench.cable.to_robot(VM, 1.5)
    bench.cable.to_host(GS, 1.5)
    assert bench.come(1.5) == [Arrival(1.5, GS, False)]
    assert bench.cable.due_s == 3.0
    assert bench.come(2.9) == []
    assert bench.come(3.0) == [Arrival(3.0, GS + VM, True)]


def test_a_refused_request_is_answered_and_does_not_arrive() -> None:
    bench = Bench(rule(Nak(), directions=REQUEST))
    # The injector answers in place of the robot.
    bench.cable.to_robot(GS, 1.0)
    assert bench.come(1.0) == [Arrival(1.0, LINE_NAK, False)]


def test_a_new_plan_counts_at_once() -> None:
    bench = Bench(rule(Drop()))
    bench.cable.to_robot(GS, 0.0)
    bench.injector = Injector(Plan(), "serial:1")
    bench.cable.to_robot(GS, 0.0)
    assert bench.robot(0.0) == GS


def test_around_a_paced_cable_the_rate_holds() -> None:
    # The corrupted byte is the checksum; the time of arrival does not change.
    plain, bench = RateLimitedChannel(38400), Bench(rule(Corrupt(place=4)), paced=True)
    for cable in (plain, bench.cable):
        cable.to_robot(GS, 1.0)
    (arrival,) = bench.come(1.1)
    expected = plain.arrived(1.1)
    assert expected is not None
    assert arrival.at_s == expected.at_s
    assert arrival.data[:4] == GS[:4]
    assert arrival.data != GS


@pytest.mark.parametrize(("paced", "keep"), [(False, 3), (True, 3), (False, 0)])
def test_a_hang_up_comes_after_what_was_sent_before_it(paced: bool, keep: int) -> None:
    bench = Bench(rule(HangUp(keep)), paced=paced)
    # The frame is cut after `keep` bytes; what follows it is lost.
    bench.cable.to_host(VM + GS + VM, 1.0)
    arrivals = bench.come(1.0)
    if paced:
        assert arrivals == []
        arrivals = bench.come(2.0)
    assert b"".join(arrival.data for arrival in arrivals) == VM + GS[:keep]
    assert [arrival.hang_up for arrival in arrivals][-2:] == [False, True]
    assert bench.cable.due_s is None
    # After the hang-up the channel serves the next connection.
    bench.cable.to_host(VM, 5.0)
    assert bench.come(6.0)[0].data == VM


def test_half_a_request_goes_as_it_is_after_a_while_on_a_line() -> None:
    bench = Bench(rule(Drop()))
    bench.cable.to_robot(GS[:4], 1.0)
    # 0.25 s after its last byte half a request is passed on, as the robot on a real line would receive it.
    assert (bench.come(1.0), bench.cable.due_s) == ([], 1.25)
    assert bench.robot(1.25) == GS[:4]
    assert bench.cable.due_s is None
    bench.cable.to_robot(VM[:4], 2.0)
    bench.cable.to_robot(VM[4:], 2.1)
    assert bench.robot(2.1) == VM
    assert bench.cable.due_s is None


def test_half_a_request_over_tcp_waits_for_the_rest() -> None:
    bench = Bench(rule(Drop()), tcp=True)
    # TCP has no such timeout: segments may be far apart.
    bench.cable.to_robot(b"\0\x0c\0", 1.0)
    assert bench.cable.due_s is None


def test_a_cable_with_too_much_in_it_is_full() -> None:
    bench = Bench(rule(Delay(100.0)))
    bench.cable.to_host(GS * (MAX_IN_TRANSIT // len(GS) + 1), 0.0)
    assert bench.cable.full
    assert bench.come(100.0)
    assert not bench.cable.full
