"""The conversation with a real robot, worked by hand: order, silence and recovery; and once on its own thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterable

import pytest
from real_robots import LINE_STATE, ScriptedRobot

from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused, WireError
from nclient.protocol.commands import Call
from nserver_emu.gateway.real_robot import FIRST_PAUSE_S, LONGEST_PAUSE_S, NO_ANSWER, Outcome, RealRobot, Ticket
from nserver_emu.gateway.robot_state import Link

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
    assert script.names() == ["conf_tm"]
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
    motion = robot.submit((VM,), moves=True)
    question = robot.submit((Call("get_sn"),))
    stop = robot.submit((ST,))
    work(robot)
    assert script.names() == ["st", "get_sn"]
    assert [code(ticket) for ticket in (motion, question, stop)] == [5, None, None]


def test_who_asks_for_the_state_together_is_answered_together() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
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
    assert code(robot.submit((ST,))) == NO_ANSWER
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
    waiting = robot.submit((VM,), moves=True)
    robot.close(ST)
    robot.close(ST)
    assert script.names() == ["st"]
    assert script.closed
    assert [code(ticket) for ticket in (waiting, robot.submit((GS,)), robot.refresh())] == [NO_ANSWER] * 3


def test_a_silent_robot_has_no_last_words() -> None:
    script = ScriptedRobot()
    robot = RealRobot(lambda: script)
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

    script.first = waits
    robot = RealRobot(lambda: script)
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
