"""Requests are repeated if that is safe, up to a number of retries; motions never."""

from __future__ import annotations

import pytest

from nclient.backends.base import Backend, Wrapper
from nclient.backends.nserver import NserverBackend
from nclient.backends.wrappers import RetryingBackend, may_be_repeated
from nclient.errors import ConnectionLost, ReplyTimeout, RobotRefused
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.types import N200
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_line import NAK, ScriptedLine, direct_on, spoiled
from tests.nclient.scripted_server import ScriptedServer


def test_motions_and_speech_may_not_be_repeated() -> None:
    # Each of them moves something, sets a pose, or speaks: executed twice it has another effect.
    never = {"vm", "pr", "pa", "mv", "zr", "ws", "dp", "da", "place_robot", "tk", "arm_zr", "arm_mv", "arm_ws",
             "special_request"}  # fmt: skip
    on_a_line = {name for name, row in BY_NAME.items() if row.line_type is not None or name == "place_robot"}
    assert {name for name in on_a_line if not may_be_repeated(name)} == never


@pytest.mark.parametrize("trouble", [None, NAK, "spoiled"])
def test_a_query_is_repeated(trouble: str | bytes | None) -> None:
    robot = ScriptedLine()
    bad = spoiled(robot.frame("gs")) if isinstance(trouble, str) else trouble
    robot.answers["gs"] = [bad, bad]
    backend = RetryingBackend(direct_on(robot), 2)
    assert backend.execute(Call("gs")).slots[17] == 57
    assert robot.names().count("gs") == 3
    assert backend.link is not None
    assert backend.link.retries == 2


def test_the_number_of_retries_is_limited() -> None:
    robot = ScriptedLine({"get_sn": [NAK] * 3})
    backend = RetryingBackend(direct_on(robot), 2)
    with pytest.raises(RobotRefused, match="get_sn"):
        backend.execute(Call("get_sn"))
    assert robot.names() == ["get_sn"] * 3
    # 0 retries: one attempt.
    robot.answers["get_sn"] = [None] * 3
    with pytest.raises(ReplyTimeout):
        RetryingBackend(direct_on(robot), 0).execute(Call("get_sn"))
    assert robot.names() == ["get_sn"] * 4


def test_a_motion_is_sent_once() -> None:
    for trouble in (None, NAK):
        robot = ScriptedLine({"pr": [trouble]})
        with pytest.raises((ReplyTimeout, RobotRefused)):
            RetryingBackend(direct_on(robot), 2).execute(Call("pr", (100, 0, 0)))
        assert robot.names() == ["pr"]


def test_refusals_of_this_side_are_not_repeated() -> None:
    backend = RetryingBackend(direct_on(ScriptedLine(model=N200)), 2)
    with pytest.raises(RobotRefused, match="not have it"):
        backend.execute(Call("conf_ser", (1, 9600)))
    assert backend.link is not None
    assert backend.link.retries == 0


# An answer that is missing over TCP closes the session: there is no second attempt.
def test_nothing_is_repeated_on_a_closed_link() -> None:
    stream = MemoryStream(ScriptedLine())
    backend = RetryingBackend(direct_on(ScriptedLine()), 2)
    stream.close()
    server = ScriptedServer({"gs": None})
    backend = RetryingBackend(NserverBackend(MemoryStream(server)), 2)
    with pytest.raises(ReplyTimeout):
        backend.execute(Call("gs"))
    assert server.names() == ["gs"]
    with pytest.raises(ConnectionLost):
        backend.execute(Call("gs"))


def test_a_wrapper_passes_everything_else_on() -> None:
    robot = ScriptedLine(model=N200)
    inner = direct_on(robot)
    backend = RetryingBackend(inner, 2)
    assert backend.wire_state is inner.wire_state
    assert backend.greeting is inner.greeting
    assert (backend.port, backend.closed, backend.link) == (1, False, inner.link)
    backend.close()
    assert (backend.closed, inner.closed) == (True, True)


class Uncounted(Wrapper):
    """A backend without statistics."""

    def __init__(self, inner: Backend) -> None:
        super().__init__(inner)
        self.link = None


def test_retries_work_without_statistics() -> None:
    robot = ScriptedLine({"gs": [None]})
    backend = RetryingBackend(Uncounted(direct_on(robot)), 2)
    assert backend.execute(Call("gs")).kind == "state"
    assert backend.link is None
    assert robot.names().count("gs") == 2
