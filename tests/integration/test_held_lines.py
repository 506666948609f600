"""nomad bridge and nomad play, whose line is held: by one who says nothing, who talks, or who waits for an answer."""

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
from nclient.protocol.types import N150
from nclient.protocol.wire_state import tcp_terms
from nclient.transports.stream import Deadline
from tests.programs import forked
from tests.programs.forked import Forked

GS = codec.tcp_request(Call("gs"))
STATE = b"\x10\x00\x11\x22"


@contextlib.contextmanager
def listening(*words: str) -> Iterator[list[str]]:
    """A program that ends well when told to: where it listens, as many places as `--serial-link` makes."""
    with Forked(*words) as process:
        try:
            yield [process.stdout.readline().split()[2] for _ in range(1 + ("--serial-link" in words))]
        finally:
            process.send_signal(signal.SIGTERM)
    assert process.returncode == 0


@contextlib.contextmanager
def a_bridge(limit_silent: str) -> Iterator[tuple[str, socket.socket]]:
    """Where it listens, and the port at its far end."""
    with socket.create_server(("127.0.0.1", 0)) as far:
        far.settimeout(10)
        address = f"nserver://127.0.0.1:{far.getsockname()[1]}"
        with listening("nomad", "bridge", address, "--listen", "0", "--limit-silent", limit_silent) as (near,):
            yield near, far


def next_end(far: socket.socket) -> socket.socket:
    """The far end of the next visitor's conversation."""
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


@pytest.mark.parametrize("own_line", [False, True], ids=["nserver", "own line"])
def test_who_holds_a_bridge_and_says_nothing_keeps_no_stop_from_a_robot(own_line: bool, tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with listening("nserver", "--port", "0", "--serial-link", str(link)) as (far, line):
        address = f"serial://{line}?model=n150" if own_line else f"nserver://{far}"
        with (
            listening("nomad", "bridge", address, "--listen", "0", "--limit-silent", "0.3") as (near,),
            connect(f"nserver://{far}") as driver,
            contextlib.ExitStack() as scanner,
        ):
            silent = [scanner.enter_context(called(near)) for _ in range(12)]
            driver.drive(translation_in_s=2)
            brake = f"robotd://{near}?model=n150" if own_line else f"nserver://{near}/1"
            done = forked.done("nomad", "stop", brake, "--patience", "20", timeout=60)
            assert done.stdout.startswith("stands still at x "), done.stdout + done.stderr
            assert not driver.refresh().moving
            assert is_closed(silent[0])


def test_who_talks_keeps_the_line_and_the_next_has_his_turn_then() -> None:
    with a_bridge("1.5") as (near, far), called(near) as talker, called(near) as newcomer:
        end = next_end(far)
        ends = Deadline.after(4)
        while ends.remaining():
            talker.sendall(GS)
            assert received(end, len(GS)) == GS
            newcomer.sendall(b"another,")
            end.sendall(STATE)
            assert received(talker, len(STATE)) == STATE
            time.sleep(0.05)
        newcomer.settimeout(0.05)
        with pytest.raises(TimeoutError):
            newcomer.recv(1)
        talker.close()
        assert is_closed(end)
        end.close()
        with next_end(far) as end:
            assert received(end, 8) == b"another,"


def test_who_waits_for_an_answer_keeps_the_line_until_it_came() -> None:
    ws = codec.tcp_request(Call("ws", (1, 1, 1, 100)))
    with a_bridge("0.3") as (near, far), called(near) as waiting, called(near) as newcomer:
        end = next_end(far)
        waiting.sendall(ws)
        assert received(end, len(ws)) == ws
        newcomer.sendall(b"another")
        waiting.settimeout(1.5)
        with pytest.raises(TimeoutError):
            waiting.recv(1)
        waiting.settimeout(10)
        answer = codec.tcp_reply(BY_NAME["ws"], Reply("state", {34: 7}, clock=20), tcp_terms(N150))
        end.sendall(answer)
        assert received(waiting, len(answer)) == answer
        assert is_closed(waiting)
        end.close()
        with next_end(far) as end:
            assert received(end, 7) == b"another"


def test_who_is_silent_and_alone_stays() -> None:
    with (
        a_bridge("0.1") as (near, far),
        called(near) as alone,
        called(near),  # who has nothing to say, either
        next_end(far) as end,
    ):
        alone.settimeout(1)
        with pytest.raises(TimeoutError):
            alone.recv(1)
        alone.sendall(b"still here")
        assert received(end, 10) == b"still here"


def test_a_recording_is_played_to_who_asks_for_it_not_to_who_is_silent(tmp_path: Path) -> None:
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
