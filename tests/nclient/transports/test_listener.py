"""Listeners accept one connection after the other, on a TCP port and on a pseudo-terminal."""

from __future__ import annotations

import os
import socket
import struct
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from nclient.errors import ConnectionLost, ReplyTimeout
from nclient.transports.listener import MAX_PENDING, QUEUE_FULL, PtyListener, TcpListener
from nclient.transports.stream import Deadline, TcpStream

Dial = Callable[..., socket.socket]


# TCP


def test_tcp_connections_are_served_one_after_the_other() -> None:
    listener = TcpListener("127.0.0.1", 0)
    try:
        assert listener.name == f"127.0.0.1:{listener.port}"
        for data in (b"one", b"two"):
            client = TcpStream("127.0.0.1", listener.port)
            stream = listener.accept()
            client.send(data)
            assert stream.receive(Deadline.after(5)) == data
            stream.send(data * 2)
            assert client.receive(Deadline.after(5)) == data * 2
            client.close()
            with pytest.raises(ConnectionLost, match="disconnected"):
                stream.receive(Deadline.after(5))
            stream.close()
        # The port is in use.
        with pytest.raises(ConnectionLost, match="port 0 takes"):
            TcpListener("127.0.0.1", listener.port)
    finally:
        listener.close()
        listener.close()
    with pytest.raises(ConnectionLost):
        TcpStream("127.0.0.1", listener.port)


def test_tcp_over_ipv6() -> None:
    if not socket.has_ipv6:
        pytest.skip("no IPv6 in this Python")
    try:
        listener = TcpListener("::1", 0)
    except ConnectionLost:
        pytest.skip("no IPv6 loopback on this machine")
    assert listener.name == f"[::1]:{listener.port}"
    listener.close()


# the queue of pending TCP connections


@pytest.fixture(name="rejected")
def _rejected() -> list[tuple[str, str]]:
    """Return the list of rejected clients, with reasons."""
    return []


@pytest.fixture(name="reasons")
def _reasons() -> dict[str, str]:
    """Return the reasons for rejection by client address."""
    return {}


@pytest.fixture(name="listener")
def _listener(rejected: list[tuple[str, str]], reasons: dict[str, str]) -> Iterator[TcpListener]:
    listener = TcpListener(
        "127.0.0.1", 0, lambda host, _local: reasons.get(host, ""), lambda *client: rejected.append(client)
    )
    yield listener
    listener.close()


@pytest.fixture(name="dial")
def _dial(listener: TcpListener) -> Iterator[Dial]:
    with ExitStack() as clients:
        def dial(data: bytes = b"") -> socket.socket:
            client = clients.enter_context(socket.create_connection(("127.0.0.1", listener.port), 10))
            client.sendall(data)
            return client

        yield dial


def wait_until(condition: Callable[[], bool]) -> None:
    """Poll a condition: what was sent over loopback arrives a moment later."""
    deadline = Deadline.after(10)
    while not condition():
        assert deadline.remaining()
        time.sleep(0.001)


def receive_once(listener: TcpListener) -> bytes:
    """Accept a connection, return what it receives first, and close it."""
    stream = listener.accept()
    try:
        return stream.receive(Deadline.after(10))
    finally:
        stream.close()


def is_closed(client: socket.socket) -> bool:
    try:
        return client.recv(1) == b""
    except ConnectionResetError:
        return True


def test_an_idle_connection_is_accepted_if_it_is_the_only_one(listener: TcpListener, dial: Dial) -> None:
    assert not listener.has_pending_request()
    client = dial()
    assert not listener.has_pending_request()
    stream = listener.accept()
    client.sendall(b"first")
    assert stream.receive(Deadline.after(10)) == b"first"
    stream.close()


def test_accept_waits_for_a_connection(listener: TcpListener, dial: Dial) -> None:
    timer = threading.Timer(0.05, dial, (b"here I am",))
    timer.start()
    stream = listener.accept()
    timer.join()
    assert stream.receive(Deadline.after(10)) == b"here I am"
    stream.close()


def test_connections_with_data_precede_idle_ones(listener: TcpListener, dial: Dial) -> None:
    # Two idle connections before two with data.
    dial(), dial(), dial(b"one"), dial(b"two")
    wait_until(listener.has_pending_request)
    for data in (b"one", b"two"):
        assert receive_once(listener) == data
    assert not listener.has_pending_request()


def test_clients_that_disconnect_leave_the_queue(listener: TcpListener, dial: Dial) -> None:
    closing, resetting = dial(), dial()
    assert not listener.has_pending_request()
    closing.close()
    # With a linger time of 0 closing sends a reset instead of an end.
    resetting.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    resetting.close()
    assert not listener.has_pending_request()
    last = dial()
    stream = listener.accept()
    last.sendall(b"last")
    assert stream.receive(Deadline.after(10)) == b"last"
    stream.close()


def test_refused_clients_are_closed_and_reported(
    listener: TcpListener, dial: Dial, rejected: list[tuple[str, str]], reasons: dict[str, str]
) -> None:
    reasons["127.0.0.1"] = "because"
    outsiders = [dial(b"let me in") for _ in range(2)]
    # Polling the queue is what accepts and rejects.
    wait_until(lambda: not listener.has_pending_request() and len(rejected) == 2)
    assert all(map(is_closed, outsiders))
    assert rejected == [("127.0.0.1", "because")] * 2
    reasons.clear()
    dial(b"mine")
    assert receive_once(listener) == b"mine"


def test_a_full_queue_drops_an_idle_connection_for_a_request(
    listener: TcpListener, dial: Dial, rejected: list[tuple[str, str]]
) -> None:
    # Idle connections fill the queue; the oldest one is closed for a request such as st.
    idle = [dial() for _ in range(MAX_PENDING)]
    assert not listener.has_pending_request()
    dial(b"stop")
    wait_until(listener.has_pending_request)
    assert is_closed(idle[0])
    assert rejected == [("127.0.0.1", QUEUE_FULL)]
    assert receive_once(listener) == b"stop"


def test_a_full_queue_of_active_connections_rejects_the_newest(
    listener: TcpListener, dial: Dial, rejected: list[tuple[str, str]]
) -> None:
    # All pending connections have sent something: the new one is rejected.
    for _ in range(MAX_PENDING):
        dial(b"request")
        wait_until(listener.has_pending_request)
    last = dial(b"one too many")
    wait_until(lambda: listener.has_pending_request() and bool(rejected))
    assert is_closed(last)
    assert rejected == [("127.0.0.1", QUEUE_FULL)]


def test_closing_the_listener_closes_pending_connections(listener: TcpListener, dial: Dial) -> None:
    pending = dial()
    assert not listener.has_pending_request()
    listener.close()
    assert is_closed(pending)


# pseudo-terminals


def open_terminal(link: Path) -> int:
    fd = os.open(link, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def test_pty_connections_are_served_one_after_the_other(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    # A link of an earlier run that leads nowhere is replaced.
    link.symlink_to("/nowhere")
    listener = PtyListener(link)
    try:
        clients: list[int] = []
        for _ in range(2):
            clients.clear()
            # The client opens the terminal while `accept` waits for it.
            timer = threading.Timer(0.05, lambda: clients.append(open_terminal(link)))
            timer.start()
            stream = listener.accept()
            timer.join()
            with pytest.raises(ReplyTimeout):
                stream.receive(Deadline.after(0))
            os.write(clients[0], bytes(range(256)))
            assert stream.receive(Deadline.after(5)) == bytes(range(256))
            # NUL, Ctrl-C, Ctrl-D, Ctrl-Q, Ctrl-S, Ctrl-Z: a terminal in another mode would act on them.
            stream.send(b"\x00\x03\x04\x11\x13\x1a\xff")
            assert os.read(clients[0], 100) == b"\x00\x03\x04\x11\x13\x1a\xff"
            os.close(clients[0])
            with pytest.raises(ConnectionLost, match="disconnected"):
                stream.receive(Deadline.after(5))
            stream.close()
    finally:
        listener.close()
        listener.close()
    assert not link.is_symlink()


def test_a_pty_drops_what_its_client_does_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nclient.transports.listener._SEND_TIMEOUT_S", 0.05)
    listener = PtyListener(tmp_path / "robot")
    try:
        fd = open_terminal(tmp_path / "robot")
        # The client reads nothing: the terminal's buffer is full after some kilobytes.
        listener.accept().send(bytes(1_000_000))
        os.close(fd)
    finally:
        listener.close()


def test_a_pty_stream_ends_with_its_listener(tmp_path: Path) -> None:
    listener = PtyListener(tmp_path / "robot")
    fd = open_terminal(tmp_path / "robot")
    stream = listener.accept()
    listener.close()
    os.close(fd)
    with pytest.raises(ConnectionLost, match="disconnected"):
        stream.send(b"late")
    with pytest.raises(ConnectionLost, match="disconnected"):
        stream.receive(Deadline.after(5))


def test_a_pty_does_not_replace_files_of_others(tmp_path: Path) -> None:
    existing = tmp_path / "file"
    existing.write_text("mine")
    with pytest.raises(ConnectionLost, match="no symbolic link"):
        PtyListener(existing)
    with pytest.raises(ConnectionLost, match="cannot make"):
        PtyListener(tmp_path / "no" / "robot")
    listener = PtyListener(tmp_path / "robot")
    (tmp_path / "robot").unlink()
    # Another program has put its own link at this place.
    (tmp_path / "robot").symlink_to("/elsewhere")
    listener.close()
    assert (tmp_path / "robot").is_symlink()
