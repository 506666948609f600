"""A lost link is raised once and reopened with growing pauses; settings are restored."""

from __future__ import annotations

import threading

import pytest

from nclient.backends.base import Backend, LinkStatistics
from nclient.backends.direct import DirectBackend
from nclient.backends.nserver import NserverBackend
from nclient.backends.wrappers import ReconnectingBackend
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING, N200, serial_wire_state
from nclient.transports.stream import MemoryStream
from tests.nclient.scripted_line import ScriptedLine
from tests.nclient.scripted_server import ScriptedServer

GS = Call("gs")


class Cable:
    """A robot that can be pulled and plugged in again; each opening is a new stream to it."""

    def __init__(self) -> None:
        self.robot = ScriptedLine(model=N200)
        self.plugged = True
        self.link = LinkStatistics()
        self.now_s = 0.0
        self.waits: list[float] = []
        self.streams: list[MemoryStream] = []

    def open(self) -> Backend:
        if not self.plugged:
            raise ConnectionLost("there is no port")
        self.streams.append(MemoryStream(self.robot))
        return DirectBackend(self.streams[-1], N200, link=self.link)

    def pull(self) -> None:
        self.plugged = False
        self.streams[-1].close()

    def wait(self, seconds: float) -> None:
        self.waits.append(round(seconds, 6))
        self.now_s += seconds

    def backend(self) -> ReconnectingBackend:
        return ReconnectingBackend(self.open(), self.open, 1.0, clock=lambda: self.now_s, wait=self.wait)


def test_the_call_after_a_loss_reconnects() -> None:
    cable = Cable()
    backend = cable.backend()
    backend.execute(GS)
    cable.pull()
    with pytest.raises(ConnectionLost, match="this end"):
        # The command was not executed, or its reply is lost: it is raised, and never repeated.
        backend.execute(Call("vm", (100, 0, 0)))
    assert not backend.closed
    cable.plugged = True
    assert backend.execute(GS).kind == "state"
    assert (cable.link.losses, cable.link.reconnects) == (1, 1)
    # Reconnecting restores settings; the vm is not sent again.
    assert "vm" not in cable.robot.names()
    assert len(cable.streams) == 2


def test_pauses_double_up_to_a_maximum() -> None:
    cable = Cable()
    backend = cable.backend()
    cable.pull()
    for _ in range(7):
        with pytest.raises(ConnectionLost):
            backend.execute(GS)
    # Doubled from 0.1 s to the maximum of 1 s; the first failure is the loss itself.
    assert cable.waits == [0.1, 0.2, 0.4, 0.8, 1.0, 1.0]
    with pytest.raises(ConnectionLost, match=r"gs: .* 1 s: .*no port"):
        backend.execute(GS)
    cable.plugged = True
    backend.execute(GS)
    # After a success the pauses start at 0.1 s again.
    cable.pull()
    cable.plugged = True
    cable.waits.clear()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    backend.execute(GS)
    assert cable.waits == [0.1]


def test_an_elapsed_pause_is_skipped() -> None:
    cable = Cable()
    backend = cable.backend()
    cable.pull()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    # The program paused for longer than the pause would last.
    cable.now_s += 60
    cable.plugged = True
    backend.execute(GS)
    assert cable.waits == [0.0]


def test_mask_timeout_and_speeds_are_restored() -> None:
    cable = Cable()
    backend = cable.backend()
    stamped = Call("ct", EVERYTHING.with_position(2).smask)
    for call in (Call("conf_tm", (5,)), stamped, Call("vm", (50, 0, 0)), Call("sp", (100, 100, 100))):
        backend.execute(call)
    cable.pull()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    cable.plugged = True
    cable.robot.calls.clear()
    assert "sonar_0" in backend.execute(GS).stamps
    # The first ct belongs to connecting; the second one is the program's, with its stamps.
    assert cable.robot.names() == ["ct", "ct", "conf_tm", "sp", "gs"]
    assert cable.robot.calls[1] == stamped


def test_a_laser_mode_is_restored() -> None:
    cable = Cable()
    backend = cable.backend()
    lines = Call("conf_ls", (33, 20, 20, 60, 4))
    backend.execute(lines)
    cable.pull()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    # It was switched off, too.
    cable.robot.wire_state = serial_wire_state(N200)
    cable.plugged = True
    cable.robot.laser = (0,)
    cable.robot.calls.clear()
    backend.execute(GS)
    assert cable.robot.calls == [Call("ct", EVERYTHING.smask), lines, GS]
    cable.robot.laser = (1, 10, 20, 30, -40)
    assert backend.execute(GS).laser == (1, 10, 20, 30, -40)


def test_a_failed_restore_closes_the_new_session() -> None:
    cable = Cable()
    backend = cable.backend()
    backend.execute(Call("conf_tm", (5,)))
    cable.pull()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    cable.plugged = True
    # The new connection opens, but conf_tm is not answered.
    cable.robot.answers["conf_tm"] = [None]
    with pytest.raises(ConnectionLost, match=r"not back .*conf_tm"):
        backend.execute(GS)
    # The first stream, and the half restored second one.
    assert cable.robot.closed == 2
    assert backend.execute(GS).kind == "state"


def test_the_robot_number_is_restored_over_tcp() -> None:
    servers = [ScriptedServer(), ScriptedServer()]
    streams = [MemoryStream(server) for server in servers]
    link = LinkStatistics()
    opened = iter(streams)

    def opens() -> Backend:
        return NserverBackend(next(opened), pid=1, link=link)

    backend = ReconnectingBackend(opens(), opens, wait=lambda _: None)
    backend.execute(Call("create_robot", (3, 1)))
    servers[0].answers["gs"] = None
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    assert backend.execute(GS).kind == "state"
    assert servers[1].names() == ["connect_robot", "gs"]
    # connect_robot(3): the robot of the new connection is the one that the program had created.
    assert servers[1].calls[2].args == (3, 1)
    assert (link.losses, link.reconnects) == (1, 1)
    backend.execute(Call("disconnect_robot", (3, 1)))
    assert backend.closed


def test_close_ends_reconnecting() -> None:
    cable = Cable()
    backend = cable.backend()
    backend.close()
    assert backend.closed
    with pytest.raises(ConnectionLost, match="this side closed"):
        backend.execute(GS)
    assert (cable.link.losses, len(cable.streams)) == (0, 1)


def test_close_ends_the_pause_before_an_attempt() -> None:
    cable = Cable()
    backend = ReconnectingBackend(cable.open(), cable.open, 60.0, clock=lambda: 0.0)
    cable.pull()
    for _ in range(2):
        with pytest.raises(ConnectionLost):
            backend.execute(GS)
    cable.plugged = True
    # The next attempt is due in 60 s, on a clock that stands still.
    backend._next_attempt_s = 60.0
    closing = threading.Timer(0.05, backend.close)
    closing.start()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    closing.join()
    # No stream is left open.
    assert cable.streams[-1]._peer is None


def test_reconnecting_works_without_statistics() -> None:
    streams = [MemoryStream(ScriptedServer()), MemoryStream(ScriptedServer())]
    opened = iter(streams)

    def opens() -> Backend:
        return NserverBackend(next(opened), pid=1)

    backend = ReconnectingBackend(opens(), opens, wait=lambda _: None)
    streams[0].close()
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    assert backend.execute(GS).kind == "state"
    assert backend.link is None
