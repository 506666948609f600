"""TCP streams over loopback: data, deadlines, closing, and errors that name host and port."""

from __future__ import annotations

import socket
import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from nclient import connect
from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.stream import ROBOT_LINE, Deadline, TcpStream, names_of_this_machine
from tests.nclient.scripted_server import on_socket


def free_port() -> int:
    # The port was free a moment ago: nothing listens on it.
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port: int = listener.getsockname()[1]
    return port


def drain(connection: socket.socket) -> None:
    while connection.recv(1024):
        pass


def echo(connection: socket.socket) -> None:
    while data := connection.recv(1024):
        connection.sendall(data)


def test_bytes_pass_in_both_directions() -> None:
    with on_socket(echo) as port:
        stream = TcpStream("127.0.0.1", port)
        stream.send(b"hello")
        got = stream.receive(Deadline.after(5))
        while len(got) < 5:
            got += stream.receive(Deadline.after(5))
        assert got == b"hello"
        stream.close()


def test_nagle_is_off() -> None:
    with on_socket(drain) as port:
        stream = TcpStream("127.0.0.1", port)
        assert stream._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)
        stream.close()


def test_a_timeout_leaves_the_stream_usable() -> None:
    with on_socket(echo) as port:
        stream = TcpStream("127.0.0.1", port)
        with pytest.raises(ReplyTimeout, match=f"127.0.0.1:{port}"):
            stream.receive(Deadline.after(0.02))
        with pytest.raises(ReplyTimeout):
            stream.receive(Deadline.after(0))
        stream.send(b"x")
        assert stream.receive(Deadline.after(5)) == b"x"
        stream.close()


def test_a_past_deadline_still_returns_what_arrived() -> None:
    with on_socket(lambda connection: connection.sendall(b"early")) as port:
        stream = TcpStream("127.0.0.1", port)
        stream._socket.settimeout(5)
        # MSG_PEEK waits until the data has arrived, and leaves it in the socket.
        assert stream._socket.recv(5, socket.MSG_PEEK) == b"early"
        assert stream.receive(Deadline.after(-1)) == b"early"
        stream.close()


def test_a_closed_connection_is_lost_and_named() -> None:
    with on_socket(socket.socket.close) as port:
        stream = TcpStream("127.0.0.1", port)
        with pytest.raises(ConnectionLost, match=rf"127\.0\.0\.1:{port} is gone: .*closed"):
            stream.receive(Deadline.after(5))
        stream.close()


def test_a_reset_connection_is_lost() -> None:
    def reset(connection: socket.socket) -> None:
        connection.recv(1)
        # A linger time of 0: closing sends a reset instead of an end.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")

    with on_socket(reset) as port:
        stream = TcpStream("127.0.0.1", port)
        stream.send(b"x")
        with pytest.raises(ConnectionLost, match="reset"):
            stream.receive(Deadline.after(5))
        stream.close()


def test_a_closed_stream_neither_sends_nor_receives() -> None:
    with on_socket(drain) as port:
        stream = TcpStream("127.0.0.1", port)
        stream.close()
        stream.close()
        with pytest.raises(ConnectionLost):
            stream.send(b"x")
        with pytest.raises(ConnectionLost):
            stream.receive(Deadline.after(5))


def test_closing_wakes_a_receiver_on_another_thread() -> None:
    outcome: list[BaseException] = []
    waiting = threading.Event()

    class Announced(Deadline):
        def remaining(self) -> float:
            waiting.set()
            return super().remaining()

    def receive() -> None:
        try:
            stream.receive(Announced.after(30))
        except ConnectionLost as error:
            outcome.append(error)

    with on_socket(drain) as port:
        stream = TcpStream("127.0.0.1", port)
        receiver = threading.Thread(target=receive)
        receiver.start()
        # The receiver thread is about to wait, or waits.
        assert waiting.wait(5)
        stream.close()
        receiver.join(10)
    assert not receiver.is_alive()
    assert len(outcome) == 1


def test_a_refused_connection_names_host_port_and_remedy() -> None:
    port = free_port()
    with pytest.raises(ConnectionLost, match=rf"no answer .*127\.0\.0\.1:{port} .*`nserver --port {port}`"):
        TcpStream("127.0.0.1", port)


def test_a_serial_line_over_tcp_has_its_own_remedy() -> None:
    port = free_port()
    with pytest.raises(ConnectionLost, match=f"`nserver --robotd {port}`"):
        TcpStream("127.0.0.1", port, served_by=ROBOT_LINE)


@pytest.mark.parametrize(("host", "port", "message"), [
    # A label of more than 63 characters, which no DNS name has, and a port beyond 16 bits.
    ("x" * 80 + ".example", 7019, "there is no host 'xxxx"), ("127.0.0.1", 70000, "127.0.0.1:70000"),
])
def test_invalid_hosts_and_ports_are_lost_connections(host: str, port: int, message: str) -> None:
    with pytest.raises(ConnectionLost, match=message):
        TcpStream(host, port)


def test_an_unknown_host_name_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object) -> None:
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "create_connection", unknown)
    with pytest.raises(ConnectionLost, match=r"host 'lab'"):
        TcpStream("lab", 7019)


def test_an_ipv6_host_is_named_in_brackets() -> None:
    port = free_port()
    with pytest.raises(ConnectionLost, match=rf"at \[::1\]:{port}"):
        TcpStream("::1", port)


def test_names_of_this_machine_begin_with_loopback() -> None:
    assert names_of_this_machine() == ("localhost", socket.gethostname())


def test_a_connection_closed_at_once_hints_at_admission() -> None:
    def reject() -> None:
        # As a server whose --allow does not list the client.
        listener.accept()[0].close()

    with socket.create_server(("127.0.0.1", 0)) as listener, ThreadPoolExecutor(1) as thread:
        closing = thread.submit(reject)
        with pytest.raises(ConnectionLost, match=r"connect_robot: .*--allow"):
            connect(f"nserver://127.0.0.1:{listener.getsockname()[1]}")
        closing.result(10)
