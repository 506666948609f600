"""nomad bridge and nomad play with silent clients, active clients, and clients that wait for a reply."""

from __future__ import annotations

import contextlib
import signal
import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import ConnectionLost, connect
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, tcp_wire_state
from nclient.transports.stream import Deadline
from tests.programs import forked, ports
from tests.programs.forked import Forked

GS = codec.encode_tcp_request(Call("gs"))
# Stands for a reply of the server.
STATE = b"\x10\x00\x11\x22"


@contextlib.contextmanager
def listening(*words: str) -> Iterator[list[str]]:
    """Run a program, yield its listening addresses, and end it with exit code 0."""
    with Forked(*words) as process:
        try:
            yield [process.stdout.readline().split()[2] for _ in range(1 + ("--serial-link" in words))]
        finally:
            process.send_signal(signal.SIGTERM)
    assert process.returncode == 0


@contextlib.contextmanager
def a_bridge(limit_silent: str) -> Iterator[tuple[str, socket.socket]]:
    """Run a bridge; yield its address and the listener of its server side."""
    with socket.create_server(("127.0.0.1", 0)) as far:
        far.settimeout(10)
        address = f"nserver://127.0.0.1:{far.getsockname()[1]}"
        with listening("nomad", "bridge", address, "--listen", "0", "--limit-silent", limit_silent) as (near,):
            yield near, far


def next_end(far: socket.socket) -> socket.socket:
    """Accept the next connection on the server side."""
    end, _ = far.accept()
    end.settimeout(10)
    return end


def called(place: str) -> socket.socket:
    host, _, port = place.rpartition(":")
    return socket.create_connection((host, int(port)), 10)


def received(peer: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = peer.recv(count - len(data))
        assert more, f"it closed after {data!r}"
        data += more
    return data


def is_closed(peer: socket.socket) -> bool:
    try:
        return peer.recv(1) == b""
    except ConnectionResetError:
        return True


@pytest.mark.parametrize(
    ("own_line", "is_portable"), [(False, False), (True, False), (True, True)], ids=["nserver", "own line", "portable"]
)
def test_silent_bridge_clients_do_not_block_stop(
    own_line: bool, is_portable: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if is_portable:
        monkeypatch.setenv(ports.VARIABLE, "1")
    link = tmp_path / "robot"
    with listening("nserver", "--port", "0", "--serial-link", str(link)) as (far, line):
        address = f"serial://{line}?model=n150" if own_line else f"nserver://{far}"
        with (
            listening("nomad", "bridge", address, "--listen", "0", "--limit-silent", "0.3") as (near,),
            connect(f"nserver://{far}") as driver,
            contextlib.ExitStack() as scanner,
        ):
            # Clients that connect and send nothing, as a port scanner does.
            silent = [scanner.enter_context(called(near)) for _ in range(12)]
            driver.drive(translation_in_s=2)
            brake = f"robotd://{near}?model=n150" if own_line else f"nserver://{near}/1"
            done = forked.run_forked("nomad", "stop", brake, "--patience", "20", timeout=60)
            assert done.stdout.startswith("stands still at x "), done.stdout + done.stderr
            assert not driver.refresh().moving
            assert is_closed(silent[0])


def test_active_client_holds_line_until_it_closes() -> None:
    with a_bridge("1.5") as (near, far), called(near) as active, called(near) as waiting_client:
        end = next_end(far)
        # Longer than the limit of 1.5 s, in which the active client sends all the time.
        ends = Deadline.after(4)
        while ends.remaining():
            active.sendall(GS)
            assert received(end, len(GS)) == GS
            waiting_client.sendall(b"another,")
            end.sendall(STATE)
            assert received(active, len(STATE)) == STATE
            time.sleep(0.05)
        # The waiting client has received nothing so far.
        waiting_client.settimeout(0.05)
        with pytest.raises(TimeoutError):
            waiting_client.recv(1)
        active.close()
        assert is_closed(end)
        end.close()
        # Its bytes were stored and are passed on when its turn comes.
        with next_end(far) as end:
            assert received(end, 8) == b"another,"


def test_client_waiting_for_reply_holds_line() -> None:
    ws = codec.encode_tcp_request(Call("ws", (1, 1, 1, 100)))
    with a_bridge("0.3") as (near, far), called(near) as waiting, called(near) as waiting_client:
        end = next_end(far)
        waiting.sendall(ws)
        assert received(end, len(ws)) == ws
        waiting_client.sendall(b"another")
        # Five times the limit of 0.3 s, but with a reply outstanding.
        waiting.settimeout(1.5)
        with pytest.raises(TimeoutError):
            waiting.recv(1)
        waiting.settimeout(10)
        answer = codec.encode_tcp_reply(BY_NAME["ws"], Reply("state", {34: 7}, clock=20), tcp_wire_state(N150))
        end.sendall(answer)
        assert received(waiting, len(answer)) == answer
        # After its reply it is silent, and another client waits.
        assert is_closed(waiting)
        end.close()
        with next_end(far) as end:
            assert received(end, 7) == b"another"


def test_single_silent_client_stays_connected() -> None:
    with (
        a_bridge("0.1") as (near, far),
        called(near) as alone,
        called(near),  # also silent
        next_end(far) as end,
    ):
        # No other client has sent anything, so the line stays assigned to this one.
        alone.settimeout(1)
        with pytest.raises(TimeoutError):
            alone.recv(1)
        alone.sendall(b"still here")
        assert received(end, 10) == b"still here"


def test_recording_is_played_to_active_client(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    with connect(f"sim:thesis_room?record={path}") as robot:
        robot.refresh()
    with (
        listening("nomad", "play", str(path), "--listen", "0", "--limit-silent", "0.3") as (place,),
        connect(f"nserver://{place}/1") as silent,
        connect(f"nserver://{place}/1?timeout_s=20") as robot,
    ):
        robot.refresh()
        with pytest.raises(ConnectionLost):
            silent.refresh()
