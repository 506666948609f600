"""The Nserver backend returns the reply of the right call, or closes the session with the reason."""

from __future__ import annotations

import pickle
import socket

import pytest

from nclient.backends.base import LinkStatistics
from nclient.backends.nserver import NserverBackend
from nclient.errors import ConnectionLost, ReplyTimeout, RobotHeld, RobotRefused, WireError
from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.replies import Reply, text_values
from nclient.protocol.types import EVERYTHING, N150, SCOUT, Position
from nclient.transports.stream import Deadline, MemoryStream, TcpStream
from tests.nclient.scripted_server import ScriptedServer, by_script, error, on_socket, simple

GS = Call("gs")
VM = Call("vm", (100, -50, 0))


def connected(server: ScriptedServer, timeout_s: float = 5.0) -> NserverBackend:
    return NserverBackend(MemoryStream(server), robot_id=3, timeout_s=timeout_s, pid=42)


def test_connecting_sends_what_old_clients_send() -> None:
    server = ScriptedServer()
    server.slots = {0: 10, 17: 99}
    backend = connected(server)
    assert server.calls == [Call("connect_robot", (3, 42)), Call("ct", EVERYTHING.smask)]
    assert backend.port == 7019
    assert backend.greeting.slots[17] == 99
    assert backend.wire_state.model is N150
    assert not backend.closed


def test_a_robot_can_be_created_by_connecting() -> None:
    server = ScriptedServer()
    NserverBackend(MemoryStream(server), robot_id=2, create=True, model=SCOUT, pid=42)
    assert server.calls[0] == Call("create_robot", (2, 42))


def test_an_unknown_robot_number_is_a_refusal() -> None:
    # A reply of 0 to connect_robot: there is no such robot.
    server = ScriptedServer({"connect_robot": simple(0)})
    with pytest.raises(RobotRefused, match="number 3"):
        connected(server)
    assert [call.name for call in server.calls] == ["connect_robot"]
    assert server.closed == 1


def test_calls_are_answered_in_order() -> None:
    server = ScriptedServer()
    backend = connected(server)
    server.slots = {17: 5}
    assert backend.execute(VM).slots[17] == 5
    server.slots = {17: 6}
    assert backend.execute(GS).slots[17] == 6
    assert server.calls[2:] == [VM, GS]


def test_a_refusal_leaves_the_session_open() -> None:
    server = ScriptedServer({"vm": error(5)})
    backend = connected(server)
    with pytest.raises(RobotRefused) as refusal:
        backend.execute(VM)
    assert (refusal.value.command, refusal.value.code) == ("vm", 5)
    assert backend.execute(GS).kind == "state"


# Error 7: a person holds the robot. An own message, held_by, returns who; other servers do not have it.
@pytest.mark.parametrize(("reply", "by"), [(simple(*text_values("viewer 1")), "viewer 1"), (error(1), "")])
def test_refusal_of_held_robot_names_the_person(reply: Reply, by: str) -> None:
    server = ScriptedServer({"vm": error(7), "held_by": reply})
    backend = connected(server)
    with pytest.raises(RobotHeld, match="release") as refusal:
        backend.execute(VM)
    assert (refusal.value.command, refusal.value.code, refusal.value.by, refusal.value.robot_id) == ("vm", 7, by, 3)
    # Exceptions are passed between processes.
    assert str(pickle.loads(pickle.dumps(refusal.value))) == str(refusal.value)
    assert backend.execute(GS).kind == "state"
    assert server.names() == ["vm", "held_by", "gs"]


def test_invalid_calls_leave_the_session_open() -> None:
    server = ScriptedServer()
    backend = connected(server)
    with pytest.raises(WireError):
        backend.execute(Call("vm", (1 << 40, 0, 0)))
    with pytest.raises(WireError):
        backend.execute(Call("nonsense"))
    with pytest.raises(RobotRefused, match="robot's own line"):
        backend.execute(Call("conf_ser", (1, 9600)))
    assert backend.execute(GS).kind == "state"
    assert server.names() == ["gs"]


def test_a_timeout_closes_the_session() -> None:
    server = ScriptedServer({"vm": None})
    backend = connected(server, timeout_s=0.05)
    with pytest.raises(ReplyTimeout, match=r"vm, .*0\.05 s"):
        backend.execute(VM)
    assert backend.closed
    assert server.closed == 1
    with pytest.raises(ConnectionLost, match=r"gs: vm .*connect again"):
        backend.execute(GS)
    assert server.names() == ["vm"]


@pytest.mark.parametrize(
    "answer",
    [
        # A reply of four words to gs, whose reply is a state.
        pytest.param(codec.encode_tcp_reply(codec.find_command("get_rc"), Reply("configuration", {34: 1}),
                                        ScriptedServer().wire_state), id="another call's answer"),
        # 0x04d2 = 1234: no message type.
        pytest.param(bytes.fromhex("04d2 0001 00000000"), id="an unknown type"),
        # A state reply of 65535 words.
        pytest.param(bytes.fromhex("0050 ffff"), id="an impossible count"),
        # Two simple replies, type 0x52 = 82, to one request.
        pytest.param(bytes.fromhex("0052 0001 00000000") * 2, id="two answers"),
        pytest.param(bytes.fromhex("0052 0001 00000000 00"), id="an answer and a bit"),
    ],
)  # fmt: skip
def test_a_reply_that_does_not_fit_closes_the_session(answer: bytes) -> None:
    backend = connected(ScriptedServer({"gs": answer}))
    with pytest.raises(ConnectionLost, match=r"(?s)gs: .*was closed") as lost:
        backend.execute(GS)
    assert isinstance(lost.value.__cause__, WireError)
    assert backend.closed
    with pytest.raises(ConnectionLost, match=r"gs .*answered by"):
        backend.execute(GS)


def test_a_server_that_is_no_nserver_is_reported() -> None:
    page = ScriptedServer({"connect_robot": b"HTTP/1.1 400 Bad Request\r\n\r\n"})
    with pytest.raises(ConnectionLost, match=r"closed.*an Nserver.* 7019"):
        connected(page)


# TCP is a stream: a segment may end anywhere.
def test_a_reply_may_arrive_byte_by_byte() -> None:
    server = ScriptedServer()

    class Crumbs(MemoryStream):
        def receive(self, deadline: Deadline) -> bytes:
            if not crumbs:
                crumbs.extend(bytes([byte]) for byte in super().receive(deadline))
            return crumbs.pop(0)

    crumbs: list[bytes] = []
    backend = NserverBackend(Crumbs(server))
    assert backend.execute(GS).slots[0] == 10


class Interrupted(MemoryStream):
    """A stream that is interrupted by Ctrl-C."""

    at: str = ""

    def send(self, data: bytes) -> None:
        if self.at == "before sending":
            raise KeyboardInterrupt
        super().send(data)

    def receive(self, deadline: Deadline) -> bytes:
        if self.at == "waiting":
            raise KeyboardInterrupt
        return super().receive(deadline)


def test_a_robot_can_be_stopped_after_ctrl_c() -> None:
    server = ScriptedServer()
    stream = Interrupted(server)
    backend = NserverBackend(stream)
    stream.at = "waiting"
    server.slots = {17: 1}
    # The replies to both vm arrive after Ctrl-C, before the reply to st.
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            backend.execute(VM)
    stream.at = ""
    server.slots = {17: 2}
    assert backend.execute(Call("st")).slots[17] == 2
    assert backend.execute(GS).slots[17] == 2
    # No vm was repeated, and each reply was matched to its own request.
    assert server.names() == ["vm", "vm", "st", "gs"]


# Part of a request may have been sent: the stream cannot be continued.
def test_an_interrupted_send_closes_the_session() -> None:
    server = ScriptedServer()
    stream = Interrupted(server)
    backend = NserverBackend(stream)
    stream.at = "before sending"
    with pytest.raises(KeyboardInterrupt):
        backend.execute(VM)
    assert backend.closed
    with pytest.raises(ConnectionLost, match="cut off"):
        backend.execute(GS)


def test_close_sends_disconnect_once() -> None:
    server = ScriptedServer()
    backend = connected(server)
    backend.close()
    backend.close()
    assert server.names() == ["disconnect_robot"]
    assert server.last() == Call("disconnect_robot", (3, 42))
    with pytest.raises(ConnectionLost):
        backend.execute(GS)


# disconnect_robot would be sent into an exchange that is not finished.
def test_close_with_an_outstanding_reply_sends_nothing() -> None:
    server = ScriptedServer()
    stream = Interrupted(server)
    backend = NserverBackend(stream)
    stream.at = "waiting"
    with pytest.raises(KeyboardInterrupt):
        backend.execute(GS)
    backend.close()
    assert server.names() == ["gs"]
    assert backend.closed


def test_disconnect_works_on_a_lost_connection() -> None:
    server = ScriptedServer()
    stream = MemoryStream(server)
    backend = NserverBackend(stream)
    stream.close()
    assert backend.execute(Call("disconnect_robot", (1, 1))).values == ()
    assert backend.closed


class DeadlineRecorder(MemoryStream):
    """Record the maximum time for each reply."""

    def receive(self, deadline: Deadline) -> bytes:
        seen.append(deadline.remaining())
        return super().receive(deadline)


seen: list[float] = []


@pytest.mark.parametrize(
    ("call", "speed", "timeout_s"),
    [
        (GS, 10, 2.0),
        # State[0] = 1: a tenth of real time, so that zr may take ten times as long.
        (GS, 1, 2.0),
        (Call("zr"), 10, 120.0),
        (Call("zr"), 1, 1200.0),
        # 20 s of ws and the ordinary 2 s.
        (Call("ws", (1, 1, 1, 20)), 10, 22.0),
        (Call("ws", (1, 1, 1, 20)), 5, 42.0),
        # Faster than real time: the limit is not shortened.
        (Call("ws", (1, 1, 1, 20)), 50, 22.0),
        # Paused: no factor can be given.
        (Call("ws", (1, 1, 1, 20)), 0, 22.0),
        (Call("ws", (1, 1, 1, -1)), 10, 2.0),
        (Call("arm_zr", (0,)), 10, 30.0),
        # A click in a window has 120 s.
        (Call("get_robot_conf"), 10, 120.0),
    ],
)
def test_timeouts_depend_on_command_and_server_speed(
    monkeypatch: pytest.MonkeyPatch, call: Call, speed: int, timeout_s: float
) -> None:
    monkeypatch.setattr("time.monotonic", lambda: 1000.0)
    server = ScriptedServer()
    server.slots = {0: speed}
    backend = NserverBackend(DeadlineRecorder(server), timeout_s=2.0)
    backend.execute(call)
    assert seen[-1] == timeout_s


def test_a_faster_server_shortens_the_timeout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("time.monotonic", lambda: 1000.0)
    server = ScriptedServer()
    server.slots = {0: 1}
    backend = NserverBackend(DeadlineRecorder(server), timeout_s=2.0)
    # The speed in the last reply counts, twice real time, and not the one at the start.
    server.slots = {0: 20}
    backend.execute(GS)
    backend.execute(Call("ws", (1, 0, 0, 20)))
    assert seen[-1] == 22.0


# over real sockets


def over_tcp(port: int, timeout_s: float = 5.0) -> NserverBackend:
    return NserverBackend(TcpStream("127.0.0.1", port), timeout_s=timeout_s)


def test_a_call_notices_that_the_server_disconnects() -> None:
    def talk(connection: socket.socket) -> None:
        # connect_robot and ct are answered, the third request is read, and the socket is closed.
        by_script(ScriptedServer(), calls=2)(connection)
        connection.recv(65536)

    with on_socket(talk) as port:
        backend = over_tcp(port)
        with pytest.raises(ConnectionLost, match=f"vm: 127.0.0.1:{port} is gone"):
            backend.execute(VM)
    assert backend.closed


def test_the_next_call_notices_a_dead_server() -> None:
    with on_socket(by_script(ScriptedServer(), calls=2)) as port:
        backend = over_tcp(port)
    with pytest.raises(ConnectionLost):
        backend.execute(GS)
    assert backend.closed


def test_half_a_reply_then_close_is_a_lost_connection() -> None:
    server = ScriptedServer()

    def talk(connection: socket.socket) -> None:
        by_script(server, calls=2)(connection)
        server.send(connection.recv(65536))
        # The first 50 bytes of a state reply, which has 200 or more.
        connection.sendall(server.receive()[:50])

    with on_socket(talk) as port:
        backend = over_tcp(port)
        with pytest.raises(ConnectionLost, match="gs: "):
            backend.execute(GS)
    assert backend.closed


def test_half_a_reply_then_silence_is_a_timeout() -> None:
    server = ScriptedServer()

    def talk(connection: socket.socket) -> None:
        by_script(server, calls=2)(connection)
        server.send(connection.recv(65536))
        connection.sendall(server.receive()[:50])
        # The other end waits until the client gives up.
        assert connection.recv(1) == b""

    with on_socket(talk) as port:
        backend = over_tcp(port)
        backend.timeout_s = 0.05
        with pytest.raises(ReplyTimeout):
            backend.execute(GS)
    assert backend.closed


def test_an_unanswered_connect_is_a_timeout() -> None:
    with on_socket(_swallow) as port, pytest.raises(ReplyTimeout):
        over_tcp(port, timeout_s=0.05)


def test_an_error_over_a_socket_leaves_it_usable() -> None:
    server = ScriptedServer({"dp": error(2)})
    with on_socket(by_script(server, calls=4)) as port:
        backend = over_tcp(port)
        with pytest.raises(RobotRefused):
            backend.execute(Call("dp", (1, 2)))
        assert backend.execute(GS).kind == "state"
        backend.close()


def _swallow(connection: socket.socket) -> None:
    while connection.recv(1024):
        pass


def test_exchanges_are_counted_if_statistics_are_given() -> None:
    link = LinkStatistics()
    server = ScriptedServer()
    backend = NserverBackend(MemoryStream(server), link=link)
    assert backend.link is link
    assert NserverBackend(MemoryStream(ScriptedServer())).link is None
    backend.execute(GS)
    # connect_robot, ct and gs.
    assert (link.exchanges, link.answers, link.frames) == (3, 3, 3)
    server.answers["gs"] = None
    with pytest.raises(ReplyTimeout):
        backend.execute(GS)
    assert (link.exchanges, link.answers, link.timeouts) == (4, 3, 1)


def test_a_state_with_the_same_bytes_is_the_same_reply() -> None:
    server = ScriptedServer()
    backend = connected(server)
    first = backend.execute(GS)
    # Unchanged bytes return the same object: they are not decoded again.
    assert backend.execute(VM) is first
    server.slots = {17: 6}
    changed = backend.execute(GS)
    assert changed.slots[17] == 6
    # The bytes of the first reply again: equal, but only the last one is cached.
    server.slots = {0: 10}
    assert backend.execute(GS) == first


def test_a_reply_in_another_form_is_read_anew() -> None:
    server = ScriptedServer()
    backend = connected(server)
    first = backend.execute(GS)
    # The format of the next reply has changed, so that equal bytes could have another meaning.
    backend.execute(Call("ct", EVERYTHING.with_position(Position.COMPASS).smask))
    assert list(backend.execute(GS).stamps) == ["compass"]
    assert not first.stamps
