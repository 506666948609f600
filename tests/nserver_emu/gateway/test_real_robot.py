"""The conversation with a real robot, worked by hand: order, silence and recovery; and once on its own thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import Call
from nserver_emu.gateway.robot_worker import FIRST_PAUSE_S, LONGEST_PAUSE_S, NO_ANSWER, Outcome, RealRobot, Ticket
from nserver_emu.gateway.translate import Link
from tests.nserver_emu.gateway.real_robots import LINE_STATE, ScriptedRobot

GS, ST, VM = Call("gs"), Call("st"), Call("vm", (50, 0, 0))


def opening(_link: Link, again: bool) -> Iterable[Call]:
    return (*((ST,) if again else ()), Call("conf_tm", (5,)))


def work(robot: RealRobot) -> None:
    while robot.work() == 0.0:
        pass


def code(ticket: Ticket) -> int | None:
    assert ticket.outcome is not None
    return ticket.outcome.code


def test_calls_are_said_in_turn_and_a_ticket_has_all_its_replies() -> None:
    script, heard = ScriptedRobot(), list[str]()
    robot = RealRobot(lambda: script, opening)
    robot.news = lambda: heard.append("news")
    assert script.names() == ["conf_tm", "gs"]
    both = robot.submit((Call("dp", (1, 2)), Call("da", (3, 4))))
    state = robot.submit((GS,))
    assert not robot.finished
    assert robot.work() == robot.work() == 0.0
    assert robot.work() is None
    assert script.names() == ["dp", "da", "gs"]
    assert both.outcome == Outcome((LINE_STATE, LINE_STATE))
    assert state.outcome == Outcome((LINE_STATE,))
    assert list(robot.finished) == [both, state]
    assert heard == ["news", "news"]


def test_a_stop_goes_first_and_voids_the_motions_that_wait() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    motion = robot.submit((VM,), moves=True)
    question = robot.submit((Call("get_sn"),))
    stop = robot.submit((ST,))
    work(robot)
    assert script.names() == ["st", "get_sn"]
    assert [code(ticket) for ticket in (motion, question, stop)] == [5, None, None]


def test_who_asks_for_the_state_together_is_answered_together() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    first, second = robot.refresh(), robot.refresh()
    assert first is second
    work(robot)
    assert robot.refresh() is not first
    work(robot)
    assert script.names() == ["gs", "gs"]


@pytest.mark.parametrize(
    ("error", "expected"),
    [(RobotRefused("tk", None), 4), (RobotRefused("pa", 2), 2), (RobotRefused("sp", 5), 5), (WireError("too far"), 2)],
)
def test_what_the_robot_refuses_or_no_line_can_carry_costs_the_asker_only(error: Exception, expected: int) -> None:
    script = ScriptedRobot(answers={"dp": error})
    robot = RealRobot(lambda: script)
    refused, state = robot.submit((Call("dp", (1, 2)), GS)), robot.submit((GS,))
    work(robot)
    assert (code(refused), code(state)) == (expected, None)
    assert list(robot.finished) == [state]


def test_one_lost_answer_is_error_6_and_the_next_question_is_answered(caplog: pytest.LogCaptureFixture) -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script, opening)
    script.names()
    script.trouble.append(ReplyTimeout("no answer within 1 s"))
    lost, waiting = robot.submit((VM,), moves=True), robot.submit((GS,))
    assert robot.work() == 0.0
    assert [code(ticket) for ticket in (lost, waiting)] == [NO_ANSWER, NO_ANSWER]
    assert code(robot.refresh()) == NO_ANSWER
    assert robot.work() is None
    assert not robot.silent
    assert script.names() == ["vm", "gs"]
    ticket = robot.refresh()
    work(robot)
    assert code(ticket) is None
    assert [record.message for record in caplog.records] == [
        "the real robot does not answer: no answer within 1 s", "the real robot answers again"
    ]  # fmt: skip


def test_a_stop_that_comes_while_an_answer_is_missed_is_said_at_once_after() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    script.trouble.append(ReplyTimeout("no answer"))
    before = robot.submit((GS,))
    robot.work()
    stop = robot.submit((ST,))
    work(robot)
    assert script.names() == ["gs", "gs", "st"]
    assert (code(before), code(stop)) == (NO_ANSWER, None)


@pytest.mark.parametrize("silences", [1, 3])
def test_a_stop_that_got_no_answer_is_said_again_when_the_robot_is_back(silences: int) -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * silences
    stop = robot.submit((ST,))
    for _ in range(silences):
        robot.work()
    assert code(stop) == NO_ANSWER
    assert code(robot.submit((GS,))) == NO_ANSWER
    assert robot.work() is None
    assert script.names() == ["st"] * (silences + 1)


def test_a_stop_for_a_robot_that_is_away_is_owed() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.trouble += [ReplyTimeout("no answer")] * 2
    robot.submit((GS,))
    robot.work()
    assert robot.work() == FIRST_PAUSE_S
    script.names()
    assert code(robot.submit((ST,))) == NO_ANSWER
    assert robot.work() is None
    assert script.names() == ["st"]


def zeroing_robots() -> tuple[RealRobot, ScriptedRobot, Ticket]:
    """A robot on its thread that zeroes and does not end; the one that is there when the line is opened again."""
    zeroing, again = ScriptedRobot(), ScriptedRobot()
    scripts = iter([zeroing, again])
    robot = RealRobot(lambda: next(scripts), opening)
    begun, broken_off = threading.Event(), threading.Event()

    def zero() -> None:
        begun.set()
        assert broken_off.wait(10)

    def close() -> None:
        zeroing.closed = True
        broken_off.set()

    zeroing.first = zero
    zeroing.close = close  # type: ignore[method-assign]  # a scripted robot is made to answer otherwise
    robot.start()
    ticket = robot.submit((Call("zr"),), moves=True)
    assert begun.wait(10)
    return robot, again, ticket


def test_a_stop_breaks_off_what_keeps_the_line_for_long(caplog: pytest.LogCaptureFixture) -> None:
    robot, again, zero = zeroing_robots()
    stopped = threading.Event()
    robot.news = stopped.set
    stop = robot.submit((ST,))
    while stop.outcome is None:
        assert stopped.wait(10)
        stopped.clear()
    robot.close()
    assert (code(zero), code(stop)) == (NO_ANSWER, None)
    assert again.names() == ["st", "conf_tm", "gs", "st"]
    assert "zr is broken off by a stop" in caplog.text


def test_the_end_breaks_it_off_as_well_and_leaves_a_robot_that_stands() -> None:
    robot, again, zero = zeroing_robots()
    robot.close(ST)
    assert code(zero) == NO_ANSWER
    assert again.names() == ["st", "conf_tm", "gs", "st"]
    assert again.closed


def test_who_does_not_answer_at_the_start_is_an_error_that_says_what_to_look_at() -> None:
    script = ScriptedRobot(answers={"gs": ReplyTimeout("no answer within 1 s")})
    with pytest.raises(ReplyTimeout, match="is it on, is its cable in"):
        RealRobot(lambda: script)
    assert script.closed
    refusing = ScriptedRobot(answers={"gs": RobotRefused("gs", 3)})
    with pytest.raises(RobotRefused):
        RealRobot(lambda: refusing)
    assert refusing.closed


def test_a_robot_that_stays_silent_is_tried_ever_more_rarely_and_stopped_when_it_is_back() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script, opening)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * 8
    robot.submit((GS,))
    pauses = [robot.work() for _ in range(8)]
    assert pauses == [0.0, FIRST_PAUSE_S, 1.0, 2.0, 4.0, LONGEST_PAUSE_S, LONGEST_PAUSE_S, LONGEST_PAUSE_S]
    assert robot.work() is None
    assert not robot.silent
    assert script.names()[-3:] == ["st", "conf_tm", "gs"]


def test_a_line_that_is_gone_is_opened_again() -> None:
    scripts = [ScriptedRobot(), ScriptedRobot(answers={"conf_tm": RobotRefused("conf_tm", None)})]
    opened = iter([scripts[0], None, scripts[1]])

    def opens() -> ScriptedRobot:
        script = next(opened)
        if script is None:
            raise ConnectionLost("no such port")
        return script

    robot = RealRobot(opens, opening)
    scripts[0].close()
    lost = robot.refresh()
    assert robot.work() == 0.0
    assert code(lost) == NO_ANSWER
    assert robot.work() == FIRST_PAUSE_S
    assert robot.work() is None
    assert scripts[1].names() == ["st", "conf_tm", "gs"]


def test_who_cannot_be_reached_at_the_start_is_an_error() -> None:
    def opens() -> ScriptedRobot:
        raise ConnectionLost("no such port")

    with pytest.raises(ConnectionLost):
        RealRobot(opens)


def test_the_end_says_its_last_words_and_answers_nobody_more() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    waiting = robot.submit((VM,), moves=True)
    robot.close(ST)
    robot.close(ST)
    assert script.names() == ["st"]
    assert script.closed
    assert [code(ticket) for ticket in (waiting, robot.submit((GS,)), robot.refresh())] == [NO_ANSWER] * 3


def test_a_silent_robot_has_no_last_words() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
    script.names()
    script.trouble += [ReplyTimeout("no answer")] * 2
    robot.submit((GS,))
    robot.work()
    script.names()
    robot.close(ST)
    assert script.names() == []
    assert script.closed


def test_on_a_thread_nobody_waits_but_it() -> None:
    script, asked, let, answered = ScriptedRobot(), threading.Event(), threading.Event(), threading.Event()

    def waits() -> None:
        asked.set()
        assert let.wait(10)

    robot = RealRobot(lambda: script)
    script.names()
    script.first = waits
    robot.news = answered.set
    robot.start()
    ticket = robot.submit((GS,))
    assert asked.wait(10)
    assert robot.saying == "gs"
    assert ticket.outcome is None
    let.set()
    assert answered.wait(10)
    assert code(ticket) is None
    robot.close(ST)
    assert script.names() == ["gs", "st"]
    assert script.closed
    assert robot.saying is None


def test_a_fault_of_ours_costs_an_answer_and_not_the_thread(caplog: pytest.LogCaptureFixture) -> None:
    script, answered = ScriptedRobot(answers={"tk": KeyError("ours")}), threading.Event()
    robot = RealRobot(lambda: script)
    robot.news = answered.set
    robot.start()
    with caplog.at_level(logging.ERROR):
        ticket = robot.submit((Call("tk", ("hello",)),))
        assert answered.wait(10)
        robot.close(ST)
    assert code(ticket) == NO_ANSWER
    assert "fault of ours" in caplog.text
