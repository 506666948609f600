"""Who looks at the robot while somebody types: only when let, and what is shown of troubles."""

from __future__ import annotations

import time
from collections.abc import Callable

from nclient.backends.nserver import NserverBackend
from nclient.cli.shell import StatusPoller
from nclient.cli.shell_session import Session
from nclient.transports.memory import MemoryStream
from tests.nclient.scripted_server import ScriptedServer


def watched(server: ScriptedServer, every_s: float = 0.002) -> tuple[Session, StatusPoller]:
    session = Session(NserverBackend(MemoryStream(server)), lambda _: None)
    return session, StatusPoller(session, every_s)


def until(true: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 10
    while not true():
        assert time.monotonic() < deadline_s
        time.sleep(0.001)


def test_it_looks_only_while_it_is_let() -> None:
    server = ScriptedServer()
    _, watcher = watched(server)
    assert server.names() == []
    server.slots[34] = 240
    watcher.begin()
    until(lambda: "x 24.0 in" in watcher.line())
    watcher.pause()
    time.sleep(0.02)
    looked = len(server.names())
    time.sleep(0.02)
    assert len(server.names()) == looked > 0
    watcher.close()
    assert set(server.names()) == {"gs"}


def test_it_leaves_a_robot_alone_whose_time_out_is_tried() -> None:
    server = ScriptedServer()
    session, watcher = watched(server)
    session.user_set_timeout = True
    watcher.begin()
    time.sleep(0.02)
    watcher.close()
    assert server.names() == []


def test_one_that_never_looks_shows_what_is_known() -> None:
    server = ScriptedServer()
    session, watcher = watched(server, every_s=0)
    watcher.begin()
    list(session.run("gs"))
    assert watcher.line().startswith("x 0.0 in")
    watcher.close()
    assert server.names() == ["gs"]


def test_a_refusal_is_shown_and_goes_with_the_next_answer() -> None:
    from tests.nclient.scripted_server import error

    server = ScriptedServer({"gs": error(6)})
    _, watcher = watched(server)
    watcher.begin()
    until(lambda: watcher.line().startswith("gs was refused: the real robot did not answer (error 6) | last known: x"))
    del server.answers["gs"]
    until(lambda: watcher.line().startswith("x 0.0 in"))
    watcher.close()


def test_a_lost_robot_is_told_and_looked_at_no_more() -> None:
    session, watcher = watched(ScriptedServer())
    session.robot.disconnect()
    watcher.begin()
    until(lambda: "connect again | last known:" in watcher.line())
    until(lambda: not watcher._thread.is_alive())
    watcher.close()
