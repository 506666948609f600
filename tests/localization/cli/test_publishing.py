"""Publishing an estimate: the message, the answer, and a viewer that is lost without stopping the robot."""

from __future__ import annotations

import json
import logging
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from localization.filters.base import Place
from localization.filters.belief import Belief
from localization.filters.health import FilterHealth, HealthStatus
from localization.filters.odometry import with_parameters
from localization.filters.update import Refusal
from localization.live.estimate import Echo, Estimate
from localization.live.run import MAX_HYPOTHESES, RETRY_S, Publisher, RunMoment, build_message, parse_answer
from localization.navigation.waypoints import COMMAND_TIMEOUT_S, Navigator
from nclient.errors import AddressError, ConnectionLost
from tests.localization.viewer_stub import page_that


def a_moment(truth: tuple[float, float, float] | None = None) -> RunMoment:
    belief = Belief(np.array([1.0, 2.0, 0.5]), np.diag([0.1, 0.2, 0.3]))
    echoes = (Echo(3, 1.2, 40, Refusal.NONE, -0.5, 2.5), Echo(4, 1.3, 255, Refusal.LIMIT, 0.0))
    return RunMoment(Estimate(1.4, belief, echoes), (1.1, 2.1, 0.4), truth, 1, 0.65)


@contextmanager
def a_page(*answers: tuple[int, str]) -> Iterator[tuple[str, list[Any]]]:
    """A page that answers so, one after the other; its address and what it was reported."""
    left = iter(answers)
    with page_that(lambda _: next(left)) as there:
        yield there


def test_message_of_a_moment() -> None:
    text = build_message(2, a_moment((1, 2, 3)), [(5, 6)])
    assert json.loads(json.dumps(text)) == {
        # turret 0.65 rad in the encoders' frame; the estimate is turned by 0.1 rad against it.
        "robot": 2, "clock_s": 1.4, "pose": [1, 2, 0.5], "turret": 0.75,
        "cov": [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]], "odometry": [1.1, 2.1, 0.4], "truth": [1, 2, 3],
        "echoes": [
            {"sonar": 3, "reading_in": 40, "refusal": "none", "innovation_in": -0.5, "nis": 2.5},
            {"sonar": 4, "reading_in": 255, "refusal": "limit", "innovation_in": 0, "nis": 0},
        ],
        "waypoints": [[5, 6]], "passed": 1, "trust": "OK", "reason": "", "places": [],
    }  # fmt: skip
    assert build_message(1, a_moment(), [])["truth"] is None


def test_health_and_hypotheses_are_published() -> None:
    moment, verdict = a_moment(), FilterHealth(HealthStatus.LOST, "2 places look alike")
    elsewhere = with_parameters(Belief(np.array([7.0, 8.0, -1.0]), np.eye(3)), (0.05,))
    # More hypotheses than a message may have.
    places = (Place(moment.estimate.belief, 0.75), *[Place(elsewhere, 0.01)] * 25)
    text = build_message(1, moment._replace(estimate=moment.estimate._replace(health=verdict, places=places)), [])
    assert (text["trust"], text["reason"]) == ("LOST", "2 places look alike")
    assert text["places"][:2] == [{"pose": [1, 2, 0.5], "share": 0.75}, {"pose": [7, 8, -1], "share": 0.01}]
    assert len(text["places"]) == MAX_HYPOTHESES


def test_message_of_longer_state_has_its_pose() -> None:
    moment = a_moment()
    longer = with_parameters(moment.estimate.belief, (0.05, 0.01))
    text = build_message(1, moment._replace(estimate=moment.estimate._replace(belief=longer)), [])
    assert text["pose"] == [1, 2, 0.5]
    assert text["cov"] == [[0.1, 0, 0], [0, 0.2, 0], [0, 0, 0.3]]


def test_only_waypoints_set_later_are_returned() -> None:
    # The number `set` rises with each change of the waypoints by the page: 4 is the state before the run.
    answers = [{"waypoints": [[9, 9]], "set": 4}, {"waypoints": [[9, 9]], "set": 4}, {"waypoints": [[1, 2]], "set": 5},
               {"waypoints": [], "set": 6}]  # fmt: skip
    with a_page(*((200, json.dumps(answer)) for answer in answers)) as (url, output):
        publisher = Publisher(url)
        found = [publisher.publish({"n": n}) for n in range(4)]
        publisher.close()
    assert found == [None, None, [(1.0, 2.0)], []]
    assert output == [("/publish?token=secret", {"n": n} | ({"began": True} if n == 0 else {})) for n in range(4)]


def test_run_without_waypoints_begins_with_those_of_the_page() -> None:
    answer = (200, json.dumps({"waypoints": [[9, 9]], "set": 4}))
    for own, received in (([], [(9.0, 9.0)]), ([[1.0, 2.0]], None)):
        with a_page(answer) as (url, _):
            publisher = Publisher(url)
            assert publisher.publish({"waypoints": own}) == received
            publisher.close()


def test_refusal_of_first_message_raises_with_reason() -> None:
    with a_page((403, "the token is wrong")) as (url, _), pytest.raises(ConnectionLost, match="token is wrong"):
        Publisher(url).publish({})


def test_lost_viewer_is_logged_and_retried(caplog: pytest.LogCaptureFixture) -> None:
    now_s = 0.0
    # Messages at 1 s and at the first retry fail; between them nothing is sent.
    fine, sent = (200, '{"waypoints": null, "set": 0}'), (200, '{"waypoints": [[3, 4]], "set": 1}')
    with a_page(fine, (500, ""), (200, "{}"), sent) as (url, output):
        publisher = Publisher(url, lambda: now_s)
        found = []
        # Times relative to the failure at 1 s.
        for now_s in (0.0, 1.0, 2.0, 1.0 + RETRY_S, 1.0 + 1.5 * RETRY_S, 1.0 + 2 * RETRY_S):
            found.append(publisher.publish({"at": now_s}))
        publisher.close()
    assert [text["at"] for _, text in output] == [0.0, 1.0, 1.0 + RETRY_S, 1.0 + 2 * RETRY_S]
    assert found == [None] * 5 + [[(3.0, 4.0)]]
    words = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert len(words) == 2
    assert "is lost, retrying" in words[0]
    assert "is connected again" in words[1]


@pytest.mark.parametrize(("ends_s", "last"), [(1.5, 1.5), (1.0, 1.0)])
# The last message was not sent, or failed: in both cases it is sent when the run ends.
def test_last_missed_message_is_sent_on_close(ends_s: float, last: float) -> None:
    """Else it would go on showing a robot on its path that has arrived: whatever was lost, and when."""
    now_s, fine = 0.0, (200, '{"waypoints": null, "set": 0}')
    with a_page(fine, (500, ""), fine) as (url, output):
        publisher = Publisher(url, lambda: now_s)
        for now_s in (0.0, 1.0, ends_s):
            publisher.publish({"at": now_s})
        publisher.close()
        publisher.close()
    assert [text["at"] for _, text in output] == [0.0, 1.0, last]


def test_silent_viewer_delays_robot_only_briefly() -> None:
    with a_page((200, '{"waypoints": null, "set": 0}')) as (url, _):
        publisher = Publisher(url)
        publisher.publish({})
        publisher.close()
    # The port accepts the connection, and nothing replies.
    with socket.create_server(("127.0.0.1", int(url.split(":")[2].split("/")[0]))):  # takes it, and states nothing
        began = time.monotonic()
        assert publisher.publish({}) is None
        assert time.monotonic() - began < COMMAND_TIMEOUT_S / 2
        publisher.close()


def test_answer_is_waypoints_and_their_version() -> None:
    assert parse_answer(b'{"waypoints": [[1, 2.5]], "set": 3}') == ([(1.0, 2.5)], 3)
    assert parse_answer(b'{"waypoints": null, "set": 0}') == ([], 0)


@pytest.mark.parametrize("answer", [
    # No JSON, other types, infinite and huge numbers, and nesting beyond the recursion limit.
    b"", b"\xff", b"3", b"null", b"{}", b'{"set": 1}', b'{"waypoints": [], "set": "often"}', b"[" * 100_000,
    b'{"waypoints": [], "set": Infinity}', b'{"waypoints": [[NaN, 1]], "set": 1}', b'{"waypoints": [[1]], "set": 1}',
    b'{"waypoints": [[1' + b"0" * 400 + b', 1]], "set": 1}', b'{"waypoints": 1e999, "set": 1}',
])  # fmt: skip
def test_invalid_answers_raise_value_error(answer: bytes) -> None:
    with pytest.raises(ValueError, match="invalid answer"):
        parse_answer(answer)


@pytest.mark.parametrize("url", ["", "127.0.0.1:7080", "http://127.0.0.1/?token=x", "http://h:7080/", "http://h:x/?token=y"])
def test_an_address_that_is_no_page_s_is_reported(url: str) -> None:
    with pytest.raises(AddressError, match="nserver --viewer printed"):
        Publisher(url)


def test_a_navigator_can_be_sent_elsewhere() -> None:
    navigator = Navigator([(0, 0), (50, 0)])
    navigator.command(np.zeros(3))
    assert navigator.passed == 1
    navigator.set_waypoints([(0, 40)])
    assert navigator.passed == 0
    assert not navigator.finished
    command = navigator.command(np.array([0.0, 0.0, 0.0]))
    assert command is not None
    assert command.steering_rad_s > 0
    assert navigator.command(np.array([0.0, 40.0, 0.0])) is None


def test_navigator_with_stays_accepts_new_waypoints() -> None:
    navigator = Navigator([(0, 0)], stays=True)
    assert navigator.command(np.zeros(3)) == (0.0, 0.0)
    assert navigator.finished
    navigator.set_waypoints([])
    assert navigator.command(np.zeros(3)) == (0.0, 0.0)
    navigator.set_waypoints([(0, 40)])
    command = navigator.command(np.zeros(3))
    assert command is not None
    assert command.steering_rad_s > 0
