"""Listener of `nomad bridge` and `nomad play`: warnings, rejected clients, end of idle sessions."""

from __future__ import annotations

import argparse
import socket
import threading
import time
from pathlib import Path

import pytest

from nclient.cli.serving import (
    DEFAULT_IDLE_LIMIT_S,
    POLL_INTERVAL_S,
    BridgeCommand,
    ClientSession,
    PlayCommand,
    open_listener,
    serve_clients,
)
from nclient.transports.stream import ByteStream, Deadline

both = pytest.mark.parametrize("command", [BridgeCommand, PlayCommand])


def options(*words: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    BridgeCommand.add_arguments(parser)
    return parser.parse_args(["nserver://localhost", *words])


@both
def test_both_have_the_options(command: type[BridgeCommand | PlayCommand]) -> None:
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    given = parser.parse_args(["x", "--listen", "0", "--allow", "10.0.0.0/8", "--allow", "::1"])
    assert [str(network) for network in given.allow] == ["10.0.0.0/8", "::1/128"]
    assert given.limit_silent == DEFAULT_IDLE_LIMIT_S
    with pytest.raises(SystemExit):
        parser.parse_args(["x", "--listen", "0", "--limit-silent", "-1"])


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (("--listen", "0"), ""),
        (
            ("--listen", "0", "--bind", "0.0.0.0"),
            "any client that reaches it may drive the robots; --allow ADDRESS/BITS restricts",
        ),
        (
            ("--listen", "0", "--bind", "0.0.0.0", "--allow", "10.0.0.0/8"),
            "client from 10.0.0.0/8 may drive the robots;",
        ),
    ],
)
def test_a_port_open_to_the_network_is_warned_of(
    words: tuple[str, ...], reported: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_listener(options(*words), "bridge"):
        captured = capsys.readouterr()
    assert captured.out.startswith("listening bridge ")
    assert reported in captured.err
    assert bool(reported) is ("open to the network at 0.0.0.0" in captured.err)


def test_rejected_clients_are_closed_and_reported_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    # On a loopback address every client is allowed: the test makes 127.0.0.2 a foreign one.
    monkeypatch.setattr("nclient.transports.listener.is_loopback", lambda _host: False)
    with open_listener(options("--listen", "0", "--allow", "192.0.2.0/24"), "bridge") as door:
        port = int(door.name.rpartition(":")[2])
        # Two clients from the same address: the second rejection must not be reported again.
        for _ in range(2):
            with socket.create_connection(("127.0.0.1", port), 10, ("127.0.0.2", 0)) as outsider:
                ends = Deadline.after(10)
                outsider.settimeout(0.01)
                while True:
                    # The listener accepts and closes within this call; the client sees it as the end of the stream.
                    assert not door.has_pending_request()
                    assert ends.remaining()
                    try:
                        assert outsider.recv(1) == b""
                        break
                    except TimeoutError:
                        continue
    assert capsys.readouterr().err.count("127.0.0.2: rejected: that address is not allowed (--allow)") == 1


def test_pseudo_terminal_has_no_pending_clients(tmp_path: Path) -> None:
    with open_listener(options("--link", str(tmp_path / "robot")), "bridge") as door:
        assert not door.has_pending_request()


class WaitingClient:
    """Reports a waiting client, and counts the queries."""

    def __init__(self) -> None:
        self.is_so, self.looks = True, 0

    def __call__(self) -> bool:
        self.looks += 1
        return self.is_so


def test_idle_session_ends_when_another_client_waits(capsys: pytest.CaptureFixture[str]) -> None:
    now_s, wanted = [time.monotonic()], WaitingClient()
    # 1. A client that sends nothing, and a second one that waits, but the limit of 5 s is not over.
    turn = ClientSession(5.0, wanted, lambda: now_s[0])
    assert not turn.should_end(at_rest=True)
    now_s[0] += 5.0
    # 2. The limit is over, but data of the first client is still being processed.
    assert not turn.should_end(at_rest=False)
    # 3. The second client is gone.
    wanted.is_so = False
    now_s[0] += 2 * POLL_INTERVAL_S
    assert not turn.should_end(at_rest=True)
    # 4. The first client sends something: the timer restarts.
    turn.idle_timer.request_received()
    wanted.is_so = True
    now_s[0] += 2 * POLL_INTERVAL_S
    assert not turn.should_end(at_rest=True)
    assert capsys.readouterr().err == ""
    # 5. Silence for 5 s, at rest, and another client waits.
    now_s[0] += 5.0
    assert turn.should_end(at_rest=True)
    assert "idle for 5 s was disconnected for another one (--limit-silent)" in capsys.readouterr().err


def test_idle_client_does_not_count_for_once() -> None:
    came: list[bytes] = []

    def talk(peer: ByteStream, turn: ClientSession) -> None:
        # The first connection is silent and ends by the limit; the second one sends a request.
        if came:
            came.append(peer.receive(Deadline.after(10)))
            return
        came.append(b"silence")
        ends = Deadline.after(10)
        while not turn.should_end(at_rest=True):
            assert ends.remaining()
            time.sleep(0.01)

    given = options("--listen", "0", "--once", "--limit-silent", "0.01")
    with open_listener(given, "bridge") as door:
        place = ("127.0.0.1", int(door.name.rpartition(":")[2]))
        with socket.create_connection(place, 10), socket.create_connection(place, 10) as second:
            # Sent after the first connection was accepted, so that it is that of a waiting client.
            speaks = threading.Timer(0.3, second.sendall, (b"stop",))
            speaks.start()
            serve_clients(door, given, talk)
            speaks.join()
    # --once must count the second connection, since the first one was ended by the limit.
    assert came == [b"silence", b"stop"]


def test_other_clients_are_polled_at_intervals() -> None:
    now_s, wanted = [0.0], WaitingClient()
    turn = ClientSession(5.0, wanted, lambda: now_s[0])
    # Ten checks at one time: one poll. The next poll follows after the interval.
    for _ in range(10):
        turn.should_end(at_rest=False)
    assert wanted.looks == 1
    now_s[0] += 2 * POLL_INTERVAL_S
    turn.should_end(at_rest=False)
    assert wanted.looks == 2
