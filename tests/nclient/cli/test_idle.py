"""Idle timer of a client: requests restart it, and a client that waits for a slow reply is not idle."""

from __future__ import annotations

import pytest

from nclient.cli.serving import NO_LIMIT, IdleMonitor, IdleTimer
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, serial_wire_state, tcp_wire_state
from nclient.recording.recorder import SERIAL, TCP

STATE = Reply("state", {34: 7}, clock=20)


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def conversation(line: str) -> tuple[Clock, IdleTimer, IdleMonitor]:
    """Return clock, timer and monitor of a client with an idle limit of 5 s."""
    clock = Clock()
    idle_timer = IdleTimer(5.0, clock)
    return clock, idle_timer, IdleMonitor(idle_timer, line, N150)


def captured(line: str, name: str, *args: int) -> bytes:
    call = Call(name, args)
    return codec.encode_tcp_request(call) if line == TCP else codec.encode_serial_request(call, serial_wire_state(N150))


def answer(line: str, name: str) -> bytes:
    row = BY_NAME[name]
    return codec.encode_tcp_reply(row, STATE, tcp_wire_state(N150)) if line == TCP else \
        codec.encode_serial_reply(row, STATE, serial_wire_state(N150))


def lasts_s(idle_timer: IdleTimer, clock: Clock) -> int:
    """Return the seconds until the timer expires."""
    seconds = 0
    while not idle_timer.expired and seconds < 1000:
        clock.now_s += 1.0
        seconds += 1
    return seconds


def test_timer_restarts_with_every_request() -> None:
    clock = Clock()
    idle_timer = IdleTimer(5.0, clock)
    assert lasts_s(idle_timer, clock) == 5
    idle_timer.request_received()
    assert lasts_s(idle_timer, clock) == 5
    assert idle_timer.expired


def test_without_a_limit_it_is_never_too_long() -> None:
    clock = Clock()
    assert lasts_s(IdleTimer(NO_LIMIT, clock), clock) == 1000


@pytest.mark.parametrize("line", [TCP, SERIAL])
@pytest.mark.parametrize(("name", "args", "seconds"), [
    # 5 s limit; ws may take its 40 s, and zr the 120 s of the protocol, before the limit starts.
    ("gs", (), 5), ("vm", (10, 0, 0), 5), ("ws", (1, 1, 1, 40), 45), ("zr", (), 125),
])
def test_waiting_for_a_slow_reply_is_not_idle(
    line: str, name: str, args: tuple[int, ...], seconds: int
) -> None:
    clock, idle_timer, monitor = conversation(line)
    # In two parts: the time of the reply counts from the part that completes the request.
    for part in (captured(line, name, *args)[:3], captured(line, name, *args)[3:]):
        monitor.to_robot(part)
    assert lasts_s(idle_timer, clock) == seconds
    monitor.to_robot(captured(line, name, *args))
    clock.now_s += 2.0
    monitor.to_host(answer(line, name)[:5])
    # A reply to ws or zr restarts the timer; one to gs does not, and 2 of the 5 s are over.
    monitor.to_host(answer(line, name)[5:])
    # What is answered at once is not waited for.
    assert lasts_s(idle_timer, clock) == (3 if seconds == 5 else 5)


def test_a_click_in_the_window_may_be_long_in_coming() -> None:
    clock, idle_timer, monitor = conversation(TCP)
    monitor.to_robot(captured(TCP, "get_robot_conf"))
    # A click in the window may take 120 s, and the limit of 5 s follows.
    assert lasts_s(idle_timer, clock) == 125


def test_other_events_do_not_end_the_wait() -> None:
    clock, idle_timer, monitor = conversation(SERIAL)
    monitor.to_robot(captured(SERIAL, "ws", 1, 1, 1, 40))
    # A short request during the wait does not shorten it.
    monitor.to_robot(captured(SERIAL, "gs"))
    assert lasts_s(idle_timer, clock) == 45


@pytest.mark.parametrize("line", [TCP, SERIAL])
def test_noise_counts_as_request_but_not_as_reply(line: str) -> None:
    clock, idle_timer, monitor = conversation(line)
    clock.now_s += 3.0
    # Bytes from the robot alone do not make the client active: 5 - 3 = 2 s are left.
    monitor.to_host(answer(line, "gs"))
    assert lasts_s(idle_timer, clock) == 2
    monitor.to_robot(b"GET / HTTP/1.0\r\n\r\n")
    assert lasts_s(idle_timer, clock) == 5


def test_incomplete_reply_does_not_end_the_waiting() -> None:
    clock, idle_timer, monitor = conversation(SERIAL)
    monitor.to_robot(captured(SERIAL, "ws", 1, 1, 1, 40))
    # Noise, and a reply whose last byte is missing.
    monitor.to_host(b"\xff\x00\x13" + answer(SERIAL, "ws")[:-1])
    assert lasts_s(idle_timer, clock) == 45
