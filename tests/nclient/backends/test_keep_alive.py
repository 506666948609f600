"""KeepAlive sets the motion timeout, sends gs in time, and passes errors of its thread to the next call."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from nclient.backends.base import KeepAlive
from nclient.backends.nserver import NserverBackend
from nclient.backends.wrappers import BumperStop, RetryingBackend
from nclient.errors import BumperHit, ConnectionLost, ReplyTimeout
from nclient.protocol.commands import Call
from nclient.protocol.types import N200
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_line import ScriptedLine, direct_on, spoiled
from tests.nclient.scripted_server import ScriptedServer, error

GS, VM = Call("gs"), Call("vm", (100, 0, 0))


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def keep_alive_on(robot: ScriptedLine, clock: Clock, **options: Any) -> KeepAlive:
    """Return a keep-alive without its thread: tests call `poll`."""
    return KeepAlive(direct_on(robot), feeds=False, clock=clock, **options)


# 5 s is the default; a connection without a greeting of its own takes that of conf_tm.
def test_the_timeout_is_set_on_connecting() -> None:
    robot = ScriptedLine()
    backend = keep_alive_on(robot, Clock())
    assert robot.calls == [Call("conf_tm", (5,))]
    assert backend.greeting is not None
    assert backend.greeting.slots[17] == 57
    robot = ScriptedLine(model=N200)
    inner = direct_on(robot)
    assert KeepAlive(inner, 9, feeds=False).greeting is inner.greeting
    assert robot.calls[-1] == Call("conf_tm", (9,))


# Three requests in each timeout of 6 s: one may be lost.
def test_gs_is_sent_after_a_third_of_the_timeout() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = keep_alive_on(robot, clock, timeout_s=6)
    robot.calls.clear()
    clock.now_s = 1.9
    assert backend.poll() == pytest.approx(0.1)
    assert robot.calls == []
    clock.now_s = 2.0
    assert backend.poll() == 2.0
    assert robot.names() == ["gs"]
    # The program's own request counts: the next gs is due 2 s after it.
    clock.now_s = 3.0
    backend.execute(VM)
    assert backend.poll() == 2.0
    assert robot.names() == ["gs", "vm"]


def test_the_interval_can_be_shortened() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = keep_alive_on(robot, clock, at_least_every_s=0.2)
    clock.now_s = 0.2
    assert backend.poll() == 0.2
    assert robot.names() == ["conf_tm", "gs"]


# State[0] is the speed times 10: at 100 the simulation runs ten times as fast, so that its timeout is over earlier.
@pytest.mark.parametrize(("speed", "interval_s"), [(10, 2.0), (5, 2.0), (100, 0.2), (9999, 0.005)])
def test_a_faster_simulation_shortens_the_interval(speed: int, interval_s: float) -> None:
    server, clock = ScriptedServer(), Clock()
    server.slots = {0: speed}
    backend = KeepAlive(NserverBackend(MemoryStream(server)), 6, feeds=False, clock=clock)
    clock.now_s = 2.0
    assert backend.poll() == pytest.approx(interval_s)
    assert server.names() == ["conf_tm", "gs"]


def test_nothing_is_sent_while_time_stands_still() -> None:
    server, clock = ScriptedServer(), Clock()
    # State[0] = 0: paused. The motion timeout runs on simulated time.
    server.slots = {0: 0}
    backend = KeepAlive(NserverBackend(MemoryStream(server)), feeds=False, clock=clock)
    clock.now_s = 100.0
    backend.poll()
    assert server.names() == ["conf_tm"]
    server.slots = {0: 10}
    backend.execute(GS)
    clock.now_s = 200.0
    backend.poll()
    assert server.names() == ["conf_tm", "gs", "gs"]


def test_a_program_that_sends_conf_tm_takes_over() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = keep_alive_on(robot, clock)
    # From here on the program decides about the timeout.
    backend.execute(Call("conf_tm", (1,)))
    clock.now_s = 100.0
    backend.poll()
    backend.execute(Call("ws", (1, 1, 1, 20)))
    assert robot.names() == ["conf_tm", "conf_tm", "ws"]
    # ws is not split: no keep-alive needs to get through.
    assert robot.calls[-1].args == (1, 1, 1, 20)


# An old server refuses conf_tm.
def test_no_thread_without_motion_timeout() -> None:
    server, clock = ScriptedServer({"conf_tm": error(1)}), Clock()
    backend = KeepAlive(NserverBackend(MemoryStream(server)), clock=clock)
    assert not backend._thread.is_alive()
    assert backend.execute(GS).kind == "state"


def test_nothing_is_sent_during_a_call() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = keep_alive_on(robot, clock)
    clock.now_s = 100.0
    # A request in progress feeds the timeout itself, and the poll must not wait for it.
    with backend._lock:
        backend.poll()
    assert robot.names() == ["conf_tm"]


def test_a_restarted_robot_gets_its_timeout_again() -> None:
    robot = ScriptedLine()
    # A robot that has run for 500 s.
    robot.clock = 500_000
    inner = direct_on(robot)
    backend = KeepAlive(RetryingBackend(inner, 2), feeds=False, clock=Clock())
    backend.execute(GS)
    # It restarts: its clock is behind. The next conf_tm is lost, in all three attempts.
    robot.clock = 100
    robot.answers["conf_tm"] = [None, None, None]
    robot.calls.clear()
    backend.execute(GS)
    backend.execute(VM)
    backend.execute(GS)
    names = [name for name in robot.names() if name not in ("get_ra", "get_rv", "get_rc")]
    # Three gs until the clock's jump is accepted; three lost conf_tm; the next reply triggers a new one.
    assert names == [*["gs"] * 3, *["conf_tm"] * 3, "vm", "conf_tm", "gs"]
    # A timeout of 0 was set by the program: it is not replaced after a restart.
    backend.execute(Call("conf_tm", (0,)))
    robot.clock = 0
    robot.calls.clear()
    backend.execute(GS)
    assert set(robot.names()) == {"gs"}


# errors in the thread


def test_the_next_call_raises_a_loss() -> None:
    robot, clock = ScriptedLine(), Clock()
    stream = MemoryStream(robot)
    inner = direct_on(robot)
    inner._line._stream = stream
    backend = KeepAlive(inner, feeds=False, clock=clock)
    stream.close()
    for now_s in (10.0, 20.0):
        # Errors in the thread have no caller: the next call raises the first of them.
        clock.now_s = now_s
        backend.poll()
    with pytest.raises(ConnectionLost, match="gs: this end"):
        backend.execute(VM)
    # It is raised once; from here on the calls fail by themselves.
    with pytest.raises(ConnectionLost, match="vm: "):
        backend.execute(VM)


def test_a_lost_reply_is_raised_only_if_it_closes() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = keep_alive_on(robot, clock)
    # On a serial line a lost reply leaves the session open: the next poll makes up for it.
    robot.answers["gs"] = [spoiled(robot.frame("gs"))]
    clock.now_s = 10.0
    backend.poll()
    assert backend.execute(VM).kind == "state"
    server = ScriptedServer()
    backend = KeepAlive(NserverBackend(MemoryStream(server)), feeds=False, clock=clock)
    # Over TCP it closes the session, and the next call must raise the reason.
    server.answers["gs"] = None
    clock.now_s = 20.0
    backend.poll()
    with pytest.raises(ReplyTimeout, match="gs"):
        backend.execute(VM)


def test_the_next_call_raises_a_bumper_hit() -> None:
    robot, clock = ScriptedLine(), Clock()
    backend = KeepAlive(BumperStop(direct_on(robot)), feeds=False, clock=clock)
    robot.slots[41] = 1
    backend.execute(VM)
    robot.slots[33] |= 1
    clock.now_s = 10.0
    # The contact shows in the reply to the thread's gs, and st is sent at once.
    backend.poll()
    assert robot.names() == ["conf_tm", "vm", "gs", "st"]
    with pytest.raises(BumperHit, match="gs: bumper 0"):
        backend.execute(GS)
    assert backend.execute(GS).slots[33] & 1


# ws


def moving(robot: ScriptedLine, motors: int) -> Any:
    return robot.state()._replace(slots={**robot.slots, 41: motors})


def test_ws_is_split_until_the_axes_are_still() -> None:
    robot = ScriptedLine()
    backend = keep_alive_on(robot, Clock())
    # Motor bits 5 and 6 contain translation or turret; 2 is steering alone, which ws did not name.
    robot.answers["ws"] = [moving(robot, 5), moving(robot, 6), moving(robot, 2)]
    assert backend.execute(Call("ws", (1, 0, 1, 20))).slots[41] == 2
    assert [call.args for call in robot.calls[1:]] == [(1, 0, 1, 2)] * 3


def test_ws_ends_when_its_time_is_over() -> None:
    robot = ScriptedLine()
    backend = keep_alive_on(robot, Clock())
    robot.answers["ws"] = moving(robot, 7)
    # Pieces of 2 s, which is half the timeout of 5 s, rounded down.
    for timeout_s, pieces in ((5, [2, 2, 1]), (2, [2]), (0, [0]), (-1, [0])):
        robot.calls.clear()
        backend.execute(Call("ws", (1, 1, 1, timeout_s)))
        assert [call.args[3] for call in robot.calls] == pieces


def test_a_malformed_ws_is_left_to_the_inner_backend() -> None:
    with pytest.raises(ValueError, match="ws takes 4"):
        keep_alive_on(ScriptedLine(), Clock()).execute(Call("ws", (1,)))


# the thread


def test_the_thread_sends_gs_and_ends_on_close(monkeypatch: pytest.MonkeyPatch) -> None:
    fed, robot = threading.Event(), ScriptedLine()
    answer = robot.send

    def send(data: bytes) -> None:
        answer(data)
        # The second gs shows that the thread goes on after the first.
        if robot.names().count("gs") > 1:
            fed.set()

    monkeypatch.setattr(robot, "send", send)
    backend = KeepAlive(direct_on(robot), at_least_every_s=0.01)
    assert fed.wait(10)
    backend.close()
    assert not backend._thread.is_alive()
    assert backend.closed
    assert robot.closed == 1
    backend.close()


def test_the_thread_stops_a_dropped_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    closed, robot = threading.Event(), ScriptedLine()
    monkeypatch.setattr(robot, "close", closed.set)
    backend = KeepAlive(direct_on(robot))
    # No reference remains: the finalizer ends the thread, which stops the robot and closes the line.
    del backend
    assert closed.wait(10)
    assert robot.names()[-1] == "st"


def test_a_dropped_robot_is_dropped_during_a_poll(monkeypatch: pytest.MonkeyPatch) -> None:
    closed, polled, robot = threading.Event(), threading.Event(), ScriptedLine()
    backend = [KeepAlive(direct_on(robot), at_least_every_s=0.01)]
    answer = robot.send

    def send(data: bytes) -> None:
        answer(data)
        # The last reference is dropped while the thread itself uses the backend.
        if robot.names()[-1] == "gs":
            backend.clear()
            polled.set()

    monkeypatch.setattr(robot, "send", send)
    monkeypatch.setattr(robot, "close", closed.set)
    assert polled.wait(10)
    assert closed.wait(10)
    assert robot.names()[-1] == "st"
