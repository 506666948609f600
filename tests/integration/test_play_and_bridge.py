"""nomad play and nomad bridge as programs: TCP ports, pseudo-terminals, and an nserver."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import select
import signal
import socket
import subprocess
import threading
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO

import pytest

from nclient import ConnectionLost, Robot, connect
from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N150, serial_wire_state
from nclient.recording.format import read_recording
from nserver_emu import cli as nserver_cli
from tests.programs import forked
from tests.programs.forked import Forked

NSERVER = ("nserver", "--port", "0", "--lockstep", "0.1")
GS = codec.encode_serial_request(Call("gs"), serial_wire_state(N150))
STATE = codec.encode_serial_reply(BY_NAME["gs"], Reply("state", {34: 7}, clock=20), serial_wire_state(N150))


class Program:
    """A process whose output lines are read with a time-out."""

    def __init__(self, process: Forked) -> None:
        # Threads read the pipes, so that a program that prints nothing cannot block the test.
        self._readers: list[threading.Thread] = []
        self.out, self.err = (self._lines(pipe) for pipe in (process.stdout, process.stderr))

    def rest(self) -> list[str]:
        """Return the unread lines of stderr."""
        with contextlib.suppress(queue.Empty):
            return [self.err(0.5), *self.rest()]
        return []

    def wait_for_readers(self) -> None:
        """Wait until all lines of a program that has ended are read: then its pipes may be closed."""
        for reader in self._readers:
            reader.join(10.0)

    def _lines(self, pipe: IO[str] | None) -> Callable[..., str]:
        lines: queue.Queue[str] = queue.Queue()

        def read() -> None:
            assert pipe
            for line in pipe:
                lines.put(line)

        self._readers.append(threading.Thread(target=read, daemon=True))
        self._readers[-1].start()
        return lambda patience_s=10.0: lines.get(timeout=patience_s)


@contextlib.contextmanager
def program(
    *words: str, ends: int = 0, by_signal: bool = True, ending: signal.Signals = signal.SIGTERM
) -> Iterator[tuple[str, Program]]:
    """Run a program; yield its listening address and its output; check its exit code."""
    with Forked(*words, stderr=True) as process:
        output = Program(process)
        try:
            first = output.out().split()
            assert first[:1] == ["listening"]
            yield first[2], output
        finally:
            if by_signal:
                process.send_signal(ending)
            try:
                code = process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                raise
            output.wait_for_readers()
        assert code == ends, "".join(output.rest())


def drive(robot: Robot) -> list[tuple[int, ...]]:
    with robot:
        # Motions and readings with noise: a replay that is out of step would differ.
        seen = [robot.drive(translation_in_s=6), robot.wait_until_still(1), *[robot.refresh() for _ in range(5)]]
        return [state.raw for state in seen]


def test_recording_is_played_to_one_client_after_another(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    seen = drive(connect(f"sim:thesis_room?noisy=1&record={path}"))
    with program("nomad", "play", str(path), "--listen", "0", ends=1) as (place, process):
        for _ in range(2):
            assert drive(connect(f"nserver://{place}/1")) == seen
        # Another request than the recorded one ends the connection, and the program explains which.
        robot = connect(f"nserver://{place}/1")
        with pytest.raises(ConnectionLost):
            robot.move(translation_in=1)
        assert "recorded was `vm 60 0 0`, the program sends `pr 10 0 0`" in process.err()


def test_sighup_ends_play(tmp_path: Path) -> None:
    drive(connect(f"sim:thesis_room?record={tmp_path / 'run.log'}"))
    with program("nomad", "play", str(tmp_path / "run.log"), "--listen", "0", ending=signal.SIGHUP) as (place, _):
        assert place.startswith("127.0.0.1:")


def test_public_port_gives_warning(tmp_path: Path) -> None:
    drive(connect(f"sim:thesis_room?record={tmp_path / 'run.log'}"))
    open_to_all = ("--listen", "0", "--bind", "0.0.0.0")
    with program("nomad", "play", str(tmp_path / "run.log"), *open_to_all) as (_, process):
        assert "any client that reaches it may have the recording answer; --allow" in process.err()
    with program(*NSERVER) as (far, _), program("nomad", "bridge", f"nserver://{far}", *open_to_all) as (_, process):
        assert "any client that reaches it may drive the robots; --allow" in process.err()


def serial_recording(path: Path, answer_after_s: float) -> None:
    header = {"format": "nomad recording", "version": 1, "wire": "serial", "model": "n150"}
    # Half of the reply after half of the time, then the rest; the last line of the file is cut off.
    lines = [header, {"t": 1.0, "dir": "out", "bytes": GS.hex()},
             {"t": 1.0 + answer_after_s / 2, "dir": "in", "bytes": STATE[:20].hex()},
             {"t": 1.0 + answer_after_s, "dir": "in", "bytes": STATE[20:].hex()}]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"t":')


def open_pty(link: str) -> int:
    fd = os.open(link, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    return fd


def read(fd: int, count: int) -> bytes:
    """Read this number of bytes from a pseudo-terminal."""
    got = b""
    while len(got) < count:
        assert select.select([fd], [], [], 10)[0], f"only {got!r} came"
        got += os.read(fd, count - len(got))
    return got


def test_recorded_line_is_played_with_recorded_timing(tmp_path: Path) -> None:
    serial_recording(tmp_path / "run.log", 0.4)
    words = ("play", str(tmp_path / "run.log"), "--link", str(tmp_path / "robot"), "--pace", "recorded", "--once")
    with program("nomad", *words, ends=1, by_signal=False) as (link, process):
        fd = open_pty(link)
        start_s = time.monotonic()
        os.write(fd, GS)
        assert read(fd, len(STATE)) == STATE
        # The recorded delay is respected.
        assert 0.4 <= time.monotonic() - start_s < 5
        os.write(fd, GS)
        assert "cut short" in process.err()
        assert "the recording ends here, and the program sends `gs`" in process.err()
        os.close(fd)
    assert not (tmp_path / "robot").is_symlink()


def test_bridge_records_and_prints(tmp_path: Path) -> None:
    path = tmp_path / "run.log"
    with program(*NSERVER) as (far, _), program(
        "nomad", "bridge", f"nserver://{far}?model=n150", "--listen", "0", "--record", str(path), "--dump"
    ) as (near, process):
        for _ in range(2):
            drive(connect(f"nserver://{near}/1"))
        shown = [process.out()]
        while sum("> disconnect_robot" in line for line in shown) < 2:
            shown.append(process.out())
        assert "> connect_robot 1" in shown[0]
        # The recording is written after the line on the screen.
        while path.read_text().count('"disconnect_robot"') < 2:  # printed before it is written
            time.sleep(0.01)
    recording = read_recording(path)
    assert recording.connections() == ("1", "2")
    calls = [found["call"] for entry in recording.entries if entry.kind == "out" for found in entry.decoded]
    once = ["connect_robot", "ct", "vm", "ws", *["gs"] * 5, "st", "disconnect_robot"]
    # Both clients sent the same; keep-alive settings (conf_tm) depend on time.
    assert [call for call in calls if call != "conf_tm"] == once * 2


def test_bridge_reconnects_to_its_server(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as far:
        far.settimeout(10)
        address = f"nserver://127.0.0.1:{far.getsockname()[1]}"
        with program("nomad", "bridge", address, "--link", str(tmp_path / "robot")) as (link, process):
            # Stays open, as in old programs: the bridge reconnects for it.
            fd = open_pty(link)
            # The server closes after each exchange, as if it was restarted.
            for word in (b"one", b"two"):
                end, _ = far.accept()
                with end:
                    end.settimeout(10)
                    os.write(fd, word)
                    assert end.recv(100) == word
                    end.sendall(word[::-1])
                    assert read(fd, 3) == word[::-1]
                assert "is gone: it closed the connection" in process.err()
            os.close(fd)


def test_bridge_without_clients_and_without_server() -> None:
    with socket.create_server(("127.0.0.1", 0)) as far:
        address = f"nserver://127.0.0.1:{far.getsockname()[1]}"
        with program("nomad", "bridge", address, "--listen", "0"):
            pass
        with program("nomad", "bridge", address, "--listen", "0") as (near, process):
            host, _, port = near.rpartition(":")
            with socket.create_connection((host, int(port))):
                pass
            assert "has disconnected" in process.err()
            far.close()
            with socket.create_connection((host, int(port))) as client:
                # The server is gone: the client's connection is closed, and the reason printed.
                client.settimeout(10)
                assert client.recv(10) == b""
            assert "127.0.0.1" in process.err()


@pytest.mark.parametrize(("words", "output", "code"), [
    (("bridge", "sim:thesis_room", "--listen", "0"), "`nserver` serves a simulation", 2),
    (("bridge", "replay:run.log", "--listen", "0"), "`nomad play` serves a recording", 2),
    (("bridge", "nserver://127.0.0.1:1", "--listen", "0"), "127.0.0.1:1", 1),
    (("play", "/no/run.log", "--listen", "0"), "cannot be read", 1),
])
def test_errors(words: tuple[str, ...], output: str, code: int) -> None:
    done = forked.run_forked("nomad", *words, timeout=30)
    assert done.returncode == code
    assert output in done.stderr


@pytest.mark.parametrize("words", [("play", "x", "--listen", "-1"), ("play", "x"), ("bridge", "x", "--listen", "a")])
def test_usage_errors(words: tuple[str, ...]) -> None:
    done = forked.run_forked("nomad", *words, timeout=30)
    assert done.returncode == 2


@pytest.mark.usefixtures("serial_ports")
def test_lines_recorded_at_both_ends_replay(tmp_path: Path) -> None:
    link, whole = tmp_path / "robot", tmp_path / "daemon.log"
    words = ("--robot", "n200", "--robotd", "0", "--serial-link", str(link), "--record", str(whole))
    with program(*NSERVER, *words) as (_, process):
        robotd = process.out().split()[2]
        for number, address in enumerate((f"robotd://{robotd}?model=n200", f"serial://{link}?model=n200")):
            path = tmp_path / f"{number}.log"
            seen = drive(connect(f"{address}&record={path}"))
            # The replayed line must give the same states as the live one did.
            assert drive(connect(f"replay:{path}")) == seen
    assert nserver_cli.main(["--replay", str(whole)]) == 0
