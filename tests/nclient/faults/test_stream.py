"""A stream with faults, on simulated time: late, lost, refused and hung up, as the plan says and not otherwise."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.faults.inject import LINE_NAK, MAX_SLEEP_S, FaultyLine, FaultyStream, Injector, LineLanguage
from nclient.faults.plan import Blackout, Corrupt, Delay, Direction, Drop, Fault, HangUp, Nak, Plan, Rule, When
from nclient.protocol.serial_framing import build_frame
from nclient.transports.stream import Deadline

GS, VM = build_frame(7), build_frame(5, bytes(6))
REQUEST, REPLY = Direction.REQUEST, Direction.REPLY


class Echo:
    """A stream that gives back what it is sent, in the pieces that `cut` makes; nothing takes time."""

    def __init__(self, cut: int = 1000) -> None:
        self.sent: list[bytes] = []
        self.closed = 0
        self._cut = cut
        self._coming: deque[bytes] = deque()

    def send(self, data: bytes) -> None:
        self.sent.append(data)
        self._coming.extend(data[k : k + self._cut] for k in range(0, len(data), self._cut))

    def receive(self, deadline: Deadline) -> bytes:
        del deadline
        if not self._coming:
            raise ReplyTimeout("silence")
        return self._coming.popleft()

    def close(self) -> None:
        self.closed += 1


class Clock:
    """Time that goes by sleeping only."""

    def __init__(self) -> None:
        self.now_s = 50.0
        self.naps: list[float] = []
        self.then: Callable[[], None] = lambda: None

    def now(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.naps.append(seconds)
        self.now_s += seconds
        self.then()


class Rig:
    """A faulty stream around an echo."""

    def __init__(
        self, fault: Fault, direction: Direction = REPLY, when: When | None = None, command: str = "gs", cut: int = 1000
    ) -> None:
        rule = Rule("it", (fault,), when or When(), (command,), frozenset({direction}))
        self.clock, self.echo = Clock(), Echo(cut)
        self.injector = Injector(Plan((rule,)), "serial", self.clock.now())
        line = FaultyLine(LineLanguage(), lambda: self.injector)
        self.stream = FaultyStream(self.echo, line, self.clock.now, self.clock.sleep)

    def ask(self, data: bytes = GS, patience_s: float = 100.0) -> bytes:
        self.stream.send(data)
        return self.stream.receive(Deadline.after(patience_s))


def test_without_a_rule_that_strikes_everything_passes() -> None:
    rig = Rig(Drop(), command="st", cut=3)
    assert rig.ask() == GS
    assert rig.ask(GS + VM) == GS
    assert rig.stream.receive(Deadline.after(0)) == VM
    assert rig.clock.naps == []


def test_lost_reply_and_lost_request() -> None:
    rig = Rig(Drop(), when=When(every=2))
    assert rig.ask() == GS
    with pytest.raises(ReplyTimeout, match="silence"):
        rig.ask()
    rig = Rig(Drop(), direction=REQUEST)
    with pytest.raises(ReplyTimeout):
        rig.ask()
    assert rig.echo.sent == []
    assert rig.injector.counts["it"] == {"seen": 1, "drop": 1}


def test_delayed_reply_arrives_when_due_or_after_the_timeout() -> None:
    rig = Rig(Delay(2.0))
    assert rig.ask() == GS
    assert rig.clock.now_s == pytest.approx(52.0)
    # Long waits are cut up, so that closing from another thread ends them.
    assert max(rig.clock.naps) <= MAX_SLEEP_S
    with pytest.raises(ReplyTimeout, match="delayed on purpose"):
        rig.ask(patience_s=0.5)
    # The caller's deadline of 0.5 s is earlier than the delay of 2 s.
    assert rig.clock.now_s == pytest.approx(52.5, abs=0.1)
    with pytest.raises(ReplyTimeout):
        rig.stream.receive(Deadline.after(-1))
    # The delayed reply is still delivered when it is due.
    rig.clock.sleep(5.0)
    assert rig.stream.receive(Deadline.after(0)) == GS


def test_a_late_reply_holds_back_those_behind_it() -> None:
    rig = Rig(Delay(2.0), when=When(at=(1,)))
    rig.stream.send(GS)
    rig.stream.send(VM)
    assert rig.stream.receive(Deadline.after(100)) == GS
    assert rig.stream.receive(Deadline.after(100)) == VM
    # 2 s for both: VM waits behind GS, and has no delay of its own.
    assert rig.clock.now_s == pytest.approx(52.0)


def test_a_late_request_is_sent_late() -> None:
    rig = Rig(Delay(3.0), direction=REQUEST)
    assert rig.ask() == GS
    assert rig.clock.naps == [3.0]


def test_a_refused_request_is_not_sent_and_answered_by_a_nak() -> None:
    rig = Rig(Nak(), direction=REQUEST)
    assert rig.ask() == LINE_NAK
    assert rig.echo.sent == []
    assert rig.ask(VM) == VM


def test_a_corrupted_request_is_sent_corrupted() -> None:
    rig = Rig(Corrupt(place=4), direction=REQUEST)
    rig.stream.send(GS)
    (sent,) = rig.echo.sent
    # Byte 4 alone differs.
    assert (sent[:4] + sent[5:], sent[4] == GS[4]) == (GS[:4] + GS[5:], False)


def test_a_silence_is_over_by_the_clock() -> None:
    rig = Rig(Blackout(1.0), when=When(at=(1,)))
    with pytest.raises(ReplyTimeout):
        rig.ask()
    with pytest.raises(ReplyTimeout):
        rig.ask(VM)
    rig.clock.sleep(1.0)
    assert rig.ask() == GS
    # The frame that began the silence counts as "silence", and the one dropped within it as "swallowed".
    assert rig.injector.counts["it"] == {"seen": 2, "silence": 1, "swallowed": 1}


def test_hang_up_in_a_reply_delivers_the_bytes_before_it() -> None:
    rig = Rig(HangUp(4))
    # The first four bytes of the reply, and then the end of the connection.
    assert rig.ask() == GS[:4]
    with pytest.raises(ConnectionLost, match="on purpose"):
        rig.stream.receive(Deadline.after(0))
    with pytest.raises(ConnectionLost, match="on purpose"):
        rig.stream.send(GS)
    assert rig.echo.closed == 1


@pytest.mark.parametrize(("keep", "sent"), [(2, [GS[:2]]), (0, [])])
def test_hang_up_in_a_request_ends_the_waiting_receive(keep: int, sent: list[bytes]) -> None:
    rig = Rig(HangUp(keep), direction=REQUEST)
    rig.stream.send(GS)
    assert rig.echo.sent == sent
    with pytest.raises(ConnectionLost, match="on purpose"):
        rig.stream.receive(Deadline.after(0))


def test_half_a_frame_comes_as_it_is_when_the_time_is_over() -> None:
    rig = Rig(Drop())
    rig.echo.send(GS[:5])
    assert rig.stream.receive(Deadline.after(0)) == GS[:5]


def test_closing_is_closing() -> None:
    rig = Rig(Delay(2.0))
    rig.stream.send(GS)
    rig.stream.close()
    rig.stream.close()
    with pytest.raises(ConnectionLost, match="this end"):
        rig.stream.receive(Deadline.after(100))
    assert rig.echo.closed == 2


def test_a_close_while_it_waits_ends_the_waiting() -> None:
    rig = Rig(Delay(20.0))
    rig.stream.send(GS)
    rig.clock.then = lambda: rig.stream.close() if rig.clock.now_s > 51.0 else None
    with pytest.raises(ConnectionLost):
        rig.stream.receive(Deadline.after(100))
    # Closed after 1 s of the 20 s.
    assert rig.clock.now_s == pytest.approx(51.0, abs=0.1)
