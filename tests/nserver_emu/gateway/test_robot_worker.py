"""The conversation with a real robot, worked by hand: order, silence and recovery; and once on its own thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import Call
from nserver_emu.gateway.real_robot import (
    MAX_RETRY_PAUSE_S,
    MIN_RETRY_PAUSE_S,
    NO_ANSWER,
    Job,
    JobResult,
    Link,
    RobotWorker,
)
from tests.nserver_emu.gateway.harness import LINE_STATE, ScriptedRobot

GS, ST, VM = Call("gs"), Call("st"), Call("vm", (50, 0, 0))


def opening(_link: Link, again: bool) -> Iterable[Call]:
    # Calls after opening the line; when it is opened again, a stop first.
    return (*((ST,) if again else ()), Call("conf_tm", (5,)))


def run_pending(robot: RobotWorker) -> None:
    while robot.run_next() == 0.0:
        pass


def code(job: Job) -> int | None:
    assert job.result is not None
    return job.result.code


def test_jobs_run_in_order_with_all_their_replies() -> None:
    script, results = ScriptedRobot(), list[str]()
    robot = RobotWorker(lambda: script, opening)
    robot.on_result = lambda: results.append("result")
    # The worker reads the state at the start to check that the robot answers.
    assert script.names() == ["conf_tm", "gs"]
    both = robot.submit((Call("dp", (1, 2)), Call("da", (3, 4))))
    state = robot.submit((GS,))
    assert not robot.finished
    assert robot.run_next() == robot.run_next() == 0.0
    assert robot.run_next() is None
    assert script.names() == ["dp", "da", "gs"]
    assert both.result == JobResult((LINE_STATE, LINE_STATE))
    assert state.result == JobResult((LINE_STATE,))
    assert list(robot.finished) == [both, state]
    assert results == ["result", "result"]


def test_a_stop_goes_first_and_cancels_waiting_motions() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    motion = robot.submit((VM,), moves=True)
    question = robot.submit((Call("get_sn"),))
    stop = robot.submit((ST,))
    run_pending(robot)
    # The stop overtakes; the motion before it is refused, the question is executed.
    assert script.names() == ["st", "get_sn"]
    assert [code(job) for job in (motion, question, stop)] == [5, None, None]


def test_concurrent_refreshes_share_one_reply() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    first, second = robot.refresh(), robot.refresh()
    # Two refreshes before the reply are one job.
    assert first is second
    run_pending(robot)
    assert robot.refresh() is not first
    run_pending(robot)
    assert script.names() == ["gs", "gs"]


@pytest.mark.parametrize(
    ("error", "expected"),
    [(RobotRefused("tk", None), 4), (RobotRefused("pa", 2), 2), (RobotRefused("sp", 5), 5), (WireError("too far"), 2)],
)
def test_a_refused_call_fails_its_own_job_only(error: Exception, expected: int) -> None:
    script = ScriptedRobot(answers={"dp": error})
    robot = RobotWorker(lambda: script)
    refused, state = robot.submit((Call("dp", (1, 2)), GS)), robot.submit((GS,))
    run_pending(robot)
    # The rest of a job is not executed after an error; other jobs are.
    assert (code(refused), code(state)) == (expected, None)
    assert list(robot.finished) == [state]


def test_a_lost_reply_is_error_6_and_the_next_succeeds(caplog: pytest.LogCaptureFixture) -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script, opening)
    script.names()
    script.trouble.append(ReplyTimeout("no answer within 1 s"))
    lost, waiting = robot.submit((VM,), moves=True), robot.submit((GS,))
    assert robot.run_next() == 0.0
    # The waiting job fails too: its client must not wait for a line that may be dead.
    assert [code(job) for job in (lost, waiting)] == [NO_ANSWER, NO_ANSWER]
    # Requests meanwhile fail at once, without a call to the robot.
    assert code(robot.refresh()) == NO_ANSWER
    # The worker asks for the state, and the robot answers again.
    assert robot.run_next() is None
    assert not robot.is_silent
    assert script.names() == ["vm", "gs"]
    job = robot.refresh()
    run_pending(robot)
    assert code(job) is None
    assert [record.message for record in caplog.records] == [
        "the real robot does not answer: no answer within 1 s", "the real robot answers again"
    ]  # fmt: skip


def test_a_stop_during_a_lost_reply_is_sent_next() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    script.trouble.append(ReplyTimeout("no answer"))
    before = robot.submit((GS,))
    robot.run_next()
    stop = robot.submit((ST,))
    run_pending(robot)
    # First a sign of life, then the stop.
    assert script.names() == ["gs", "gs", "st"]
    assert (code(before), code(stop)) == (NO_ANSWER, None)


@pytest.mark.parametrize("silences", [1, 3])
def test_an_unanswered_stop_is_repeated_after_reconnecting(silences: int) -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * silences
    stop = robot.submit((ST,))
    for _ in range(silences):
        robot.run_next()
    assert code(stop) == NO_ANSWER
    assert code(robot.submit((GS,))) == NO_ANSWER
    assert robot.run_next() is None
    # The stop is repeated until it is answered.
    assert script.names() == ["st"] * (silences + 1)


def test_a_stop_while_disconnected_is_sent_later() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.trouble += [ReplyTimeout("no answer")] * 2
    robot.submit((GS,))
    robot.run_next()
    # The pause before the next attempt.
    assert robot.run_next() == MIN_RETRY_PAUSE_S
    script.names()
    assert code(robot.submit((ST,))) == NO_ANSWER
    assert robot.run_next() is None
    assert script.names() == ["st"]


def zeroing_robots() -> tuple[RobotWorker, ScriptedRobot, Job]:
    """A robot on its thread that zeroes and does not end; the one that is there when the line is opened again."""
    zeroing, again = ScriptedRobot(), ScriptedRobot()
    scripts = iter([zeroing, again])
    robot = RobotWorker(lambda: next(scripts), opening)
    begun, broken_off = threading.Event(), threading.Event()

    # The scripted zr blocks the worker's thread until the line is closed.
    def zero() -> None:
        begun.set()
        assert broken_off.wait(10)

    def close() -> None:
        zeroing.closed = True
        broken_off.set()

    zeroing.first = zero
    zeroing.close = close  # type: ignore[method-assign]  # a scripted robot is made to answer otherwise
    robot.start()
    job = robot.submit((Call("zr"),), moves=True)
    assert begun.wait(10)
    return robot, again, job


def test_a_stop_interrupts_a_slow_command(caplog: pytest.LogCaptureFixture) -> None:
    robot, again, zero = zeroing_robots()
    stopped = threading.Event()
    robot.on_result = stopped.set
    # Closing the line is the only method to interrupt a call that waits for its reply.
    stop = robot.submit((ST,))
    while stop.result is None:
        assert stopped.wait(10)
        stopped.clear()
    robot.close()
    assert (code(zero), code(stop)) == (NO_ANSWER, None)
    # The new line: stop, timeout and state, then the stop of the client.
    assert again.names() == ["st", "conf_tm", "gs", "st"]
    assert "zr is interrupted by a stop" in caplog.text


def test_closing_interrupts_a_slow_command_and_stops() -> None:
    robot, again, zero = zeroing_robots()
    robot.close(ST)
    assert code(zero) == NO_ANSWER
    assert again.names() == ["st", "conf_tm", "gs", "st"]
    assert again.closed


def test_no_reply_at_the_start_is_an_error_with_a_remedy() -> None:
    script = ScriptedRobot(answers={"gs": ReplyTimeout("no answer within 1 s")})
    with pytest.raises(ReplyTimeout, match="is it on"):
        RobotWorker(lambda: script)
    assert script.closed
    refusing = ScriptedRobot(answers={"gs": RobotRefused("gs", 3)})
    with pytest.raises(RobotRefused):
        RobotWorker(lambda: refusing)
    assert refusing.closed


def test_retry_pauses_grow_and_a_stop_follows() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script, opening)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * 8
    robot.submit((GS,))
    pauses = [robot.run_next() for _ in range(8)]
    # At once, then 0.5 s, doubled up to the maximum of 8 s.
    assert pauses == [0.0, MIN_RETRY_PAUSE_S, 1.0, 2.0, 4.0, MAX_RETRY_PAUSE_S, MAX_RETRY_PAUSE_S, MAX_RETRY_PAUSE_S]
    assert robot.run_next() is None
    assert not robot.is_silent
    assert script.names()[-3:] == ["st", "conf_tm", "gs"]


def test_a_closed_line_is_reopened() -> None:
    scripts = [ScriptedRobot(), ScriptedRobot(answers={"conf_tm": RobotRefused("conf_tm", None)})]
    # After the loss the first attempt to reopen the line fails, the second succeeds.
    opened = iter([scripts[0], None, scripts[1]])

    def opens() -> ScriptedRobot:
        script = next(opened)
        if script is None:
            raise ConnectionLost("no such port")
        return script

    robot = RobotWorker(opens, opening)
    scripts[0].close()
    lost = robot.refresh()
    assert robot.run_next() == 0.0
    assert code(lost) == NO_ANSWER
    assert robot.run_next() == MIN_RETRY_PAUSE_S
    assert robot.run_next() is None
    assert scripts[1].names() == ["st", "conf_tm", "gs"]


def test_an_unreachable_address_is_an_error() -> None:
    def opens() -> ScriptedRobot:
        raise ConnectionLost("no such port")

    with pytest.raises(ConnectionLost):
        RobotWorker(opens)


def test_close_sends_the_shutdown_calls_and_fails_the_rest() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    waiting = robot.submit((VM,), moves=True)
    robot.close(ST)
    # Closing twice sends one stop.
    robot.close(ST)
    assert script.names() == ["st"]
    assert script.closed
    assert [code(job) for job in (waiting, robot.submit((GS,)), robot.refresh())] == [NO_ANSWER] * 3


def test_close_sends_nothing_to_a_silent_robot() -> None:
    script = ScriptedRobot()
    robot = RobotWorker(lambda: script)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * 2
    robot.submit((GS,))
    robot.run_next()
    script.names()
    robot.close(ST)
    # A robot that does not answer would delay the end.
    assert script.names() == []
    assert script.closed


def test_submit_does_not_block_while_the_thread_waits() -> None:
    script, asked, let, answered = ScriptedRobot(), threading.Event(), threading.Event(), threading.Event()

    # The call blocks in the worker's thread; `submit` has returned long before.
    def waits() -> None:
        asked.set()
        assert let.wait(10)

    robot = RobotWorker(lambda: script)
    script.names()
    script.first = waits
    robot.on_result = answered.set
    robot.start()
    job = robot.submit((GS,))
    assert asked.wait(10)
    assert robot.current_command == "gs"
    assert job.result is None
    let.set()
    assert answered.wait(10)
    assert code(job) is None
    robot.close(ST)
    assert script.names() == ["gs", "st"]
    assert script.closed
    assert robot.current_command is None


def test_an_internal_error_fails_the_job_not_the_thread(caplog: pytest.LogCaptureFixture) -> None:
    # An exception that is no error of a robot: a bug.
    script, answered = ScriptedRobot(answers={"tk": KeyError("ours")}), threading.Event()
    robot = RobotWorker(lambda: script)
    robot.on_result = answered.set
    robot.start()
    with caplog.at_level(logging.ERROR):
        job = robot.submit((Call("tk", ("hello",)),))
        assert answered.wait(10)
        robot.close(ST)
    assert code(job) == NO_ANSWER
    assert "internal error" in caplog.text
