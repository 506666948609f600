"""StatusPoller: polls only while the prompt waits, and shows errors."""

from __future__ import annotations

import time
from collections.abc import Callable

from nclient.backends.nserver import NserverBackend
from nclient.cli.shell import StatusPoller
from nclient.cli.shell_session import Session
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_server import ScriptedServer


def watched(server: ScriptedServer, every_s: float = 0.002) -> tuple[Session, StatusPoller]:
    session = Session(NserverBackend(MemoryStream(server)), lambda _: None)
    return session, StatusPoller(session, every_s)


# The poller has a thread of its own: the test waits for its effect, for 10 s at most.
def until(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 10
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.001)


def test_it_looks_only_while_it_is_let() -> None:
    server = ScriptedServer()
    _, poller = watched(server)
    assert server.names() == []
    server.slots[34] = 240
    poller.begin()
    until(lambda: "x 24.0 in" in poller.line())
    poller.pause()
    # Time for a request in progress to end, before requests are counted.
    time.sleep(0.02)
    looked = len(server.names())
    time.sleep(0.02)
    assert len(server.names()) == looked > 0
    poller.close()
    assert set(server.names()) == {"gs"}


def test_it_leaves_a_robot_alone_whose_time_out_is_tried() -> None:
    # gs would feed the motion timeout that the user wants to see expire.
    server = ScriptedServer()
    session, poller = watched(server)
    session.user_set_timeout = True
    poller.begin()
    time.sleep(0.02)
    poller.close()
    assert server.names() == []


def test_one_that_never_looks_shows_what_is_known() -> None:
    server = ScriptedServer()
    session, poller = watched(server, every_s=0)
    poller.begin()
    list(session.run("gs"))
    assert poller.line().startswith("x 0.0 in")
    poller.close()
    assert server.names() == ["gs"]


def test_a_refusal_is_shown_and_goes_with_the_next_answer() -> None:
    from tests.nclient.scripted_server import error

    server = ScriptedServer({"gs": error(6)})
    _, poller = watched(server)
    poller.begin()
    until(lambda: poller.line().startswith("gs was refused: the real robot did not answer (error 6) | last known: x"))
    del server.answers["gs"]
    until(lambda: poller.line().startswith("x 0.0 in"))
    poller.close()


def test_lost_robot_is_reported_and_no_longer_polled() -> None:
    session, poller = watched(ScriptedServer())
    session.robot.disconnect()
    poller.begin()
    until(lambda: "connect again | last known:" in poller.line())
    until(lambda: not poller._thread.is_alive())
    poller.close()
