"""Serial lines of a running server: pseudo-terminals, TCP, two robots in one world, and the links of killed servers.

The host is an independent implementation of docs/protocol.md with struct only, like the robots' own library.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import struct
import termios
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from nclient import connect
from tests.programs import forked
from tests.programs.forked import Forked
from tests.waiting import wait_until

# Types of frames on the serial line (docs/protocol.md).
VM, GS, ST, GET_RV, GET_RC, WS, CT = 5, 7, 9, 22, 21, 31, 6
TIMEOUT_S = 20.0
NO_SENSORS = bytes((0, 0, 0, 0, 0xFE, 0, 0))
"""A mask with pose and velocities only."""


def signed(number: int) -> int:
    """Decode a 16-bit sign-magnitude number."""
    return -(number & 0x7FFF) if number & 0x8000 else number


class OldHost:
    """A host like the robots' C library: flushes its input, sends a request, waits for a frame of the same type."""

    def __init__(self, fd: int, flush: Callable[[], None]) -> None:
        self._fd, self._flush = fd, flush

    def ask(self, kind: int, data: bytes = b"") -> bytes:
        """Send a request and return the data of its reply."""
        self._flush()
        # Start 01, length of type, data and checksum (low byte first), type, data.
        body = struct.pack("<BHB", 1, len(data) + 2, kind) + data
        os.write(self._fd, body + bytes((sum(body) & 255, 0x5C)))
        head = self.read(3)
        # Length counts the type and the checksum; the end byte comes after it.
        rest = self.read(int.from_bytes(head[1:], "little") + 1)
        assert (head[0], rest[0], rest[-1]) == (1, kind, 0x5C)
        assert sum(head + rest[:-2]) & 255 == rest[-2]
        return rest[1:-2]

    def read(self, count: int) -> bytes:
        """Read this number of bytes."""
        found, deadline = b"", time.monotonic() + TIMEOUT_S
        while len(found) < count:
            ready, _, _ = select.select([self._fd], [], [], max(0.0, deadline - time.monotonic()))
            assert ready, f"{len(found)} of {count} bytes came"
            found += os.read(self._fd, count - len(found))
        return found

    def drive(self, *velocities: int) -> None:
        """Send vm, in tenths."""
        # Sign-magnitude: bit 15 is the sign.
        self.ask(VM, struct.pack("<3H", *(0x8000 - v if v < 0 else v for v in velocities)))

    def velocities(self) -> tuple[int, ...]:
        """Return the velocities from get_rv."""
        return tuple(map(signed, struct.unpack("<3H", self.ask(GET_RV))))


@contextlib.contextmanager
def at_link(path: Path) -> Iterator[OldHost]:
    """Connect a host to a serial line."""
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    tty.setraw(fd)
    try:
        yield OldHost(fd, lambda: termios.tcflush(fd, termios.TCIFLUSH))
    finally:
        os.close(fd)


@contextlib.contextmanager
def at_port(port: str) -> Iterator[OldHost]:
    """Connect a host to a robot over TCP."""
    with socket.create_connection(("127.0.0.1", int(port)), timeout=TIMEOUT_S) as line:
        line.setblocking(True)
        yield OldHost(line.fileno(), lambda: None)


@contextlib.contextmanager
def nserver(*words: str, end: int = signal.SIGTERM) -> Iterator[list[str]]:
    """Run a server and yield its listening addresses, that of Nserver first."""
    with Forked("nserver", "--port", "0", *words, stderr=True) as process:
        try:
            count = 1 + sum(word.startswith(("--serial-link", "--robotd")) for word in words)
            yield [process.stdout.readline().split()[2] for _ in range(count)]
        finally:
            process.send_signal(end)
            process.wait(TIMEOUT_S)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Return the path for the link."""
    return tmp_path / "nomad"


def test_lines_and_nserver_share_one_robot(path: Path) -> None:
    with nserver("--serial-link", str(path), "--robotd", "0", "--speed", "5") as (port, modem, link):
        assert Path(link) == path
        address = f"nserver://{port}/1"
        with at_link(path) as host, at_port(modem.rpartition(":")[2]) as other, connect(address) as robot:
            # Bumper bytes at rest: f0 00 00.
            assert host.ask(GS)[16:19] == b"\xf0\x00\x00"
            host.drive(0, -50, 20)
            assert other.velocities() == (0, -50, 20)
            assert robot.refresh().raw[38:41] == (0, -50, 20)
            other.ask(ST)
            assert host.velocities() == (0, 0, 0)
            # The steering turns when the host closes the line.
            host.drive(0, 450, 0)
        wait_until(lambda: still(address))
    assert not os.path.lexists(path)


def still(address: str) -> bool:
    """Return True if robot 1 stands still, as seen by an observing client."""
    with connect(address) as robot:
        return not robot.refresh().moving


def test_each_robot_has_its_own_line_and_mask(tmp_path: Path) -> None:
    links = [tmp_path / name for name in ("first", "second", "third")]
    words = [f"--serial-link={links[0]}", f"--serial-link={links[1]}", f"--serial-link={links[2]}@1"]
    with nserver("--robot", "n150", "--robot", "n200", "--robotd=0@2", *words) as (_, modem, *paths):
        assert paths == [str(link) for link in links]
        with contextlib.ExitStack() as hosts:
            first, second, again = (hosts.enter_context(at_link(link)) for link in links)
            over_tcp = hosts.enter_context(at_port(modem.rpartition(":")[2]))
            # The handshake of a N200: everything selected, laser mode 51 (33 hexadecimal).
            assert over_tcp.read(11) == bytes.fromhex("ffffffffff010133000000")
            assert len(first.ask(GS)) == 42
            # Seven numbers of 2 bytes; motors (1), clock (4) and voltages (2) are always sent.
            assert len(second.ask(CT, NO_SENSORS)) == 14 + 7
            # All lines of a robot share its mask.
            assert len(over_tcp.ask(GS)) == 14 + 7
            first.drive(0, 30, 0)
            assert again.velocities() == (0, 30, 0)
            assert second.velocities() == (0, 0, 0)


def test_next_start_replaces_link_of_killed_server(path: Path) -> None:
    for _ in range(2):
        with nserver("--serial-link", str(path), end=signal.SIGKILL), at_link(path) as host:
            assert len(host.ask(GS)) == 42
        assert path.is_symlink()
        assert not path.exists()
    with nserver("--serial-link", str(path)), at_link(path) as host:
        assert host.velocities() == (0, 0, 0)
    assert not os.path.lexists(path)


def test_host_gets_error_after_server_is_killed(path: Path) -> None:
    with contextlib.ExitStack() as ending:
        with nserver("--serial-link", str(path), end=signal.SIGKILL):
            host = ending.enter_context(at_link(path))
            host.drive(0, 50, 0)
        with pytest.raises(termios.error, match="Input/output error"):
            host.ask(GS)


def test_existing_file_is_not_replaced_by_link(path: Path) -> None:
    path.write_text("precious")
    done = forked.run_forked("nserver", "--port", "0", "--serial-link", str(path), timeout=TIMEOUT_S)
    assert (done.returncode, done.stdout) == (1, "")
    assert f"{path} exists and is no symbolic link" in done.stderr
    assert path.read_text() == "precious"


def test_second_server_does_not_replace_the_link(path: Path) -> None:
    with nserver("--serial-link", str(path)):
        done = forked.run_forked("nserver", "--port", "0", "--serial-link", str(path), timeout=TIMEOUT_S)
        assert done.returncode == 1
        assert f"{path} is the serial line of another running nserver" in done.stderr
        with at_link(path) as host:
            assert len(host.ask(GS)) == 42


def test_lockstep_and_pause_on_a_line(path: Path) -> None:
    with nserver("--serial-link", str(path), "--lockstep", "0.1"), at_link(path) as host:
        # Bytes 36 to 39 are the clock: one step of 0.1 s per request.
        clocks = [int.from_bytes(host.ask(GS)[36:40], "little") for _ in range(4)]
        assert clocks == [100, 200, 300, 400]
        host.drive(0, 100, 0)
        # ws with a timeout of 1 s; bytes 27 to 32 are the velocities.
        assert host.ask(WS, bytes((1, 1, 1, 1)))[27:33] == bytes((0, 0, 100, 0, 0, 0))
        # vm at 0.5 s, ws at 0.6 s, its timeout at 1.6 s, this gs at 1.7 s.
        assert int.from_bytes(host.ask(GS)[36:40], "little") == 1700


def test_rate_limited_line_has_speed_of_its_cable(path: Path) -> None:
    """An exchange has 54 bytes: at 38400 baud never faster, and not much slower on a busy machine."""
    with nserver("--serial-link", str(path), "--baud", "38400"), at_link(path) as host:
        host.ask(GS)
        start_s, count = time.monotonic(), 60
        for _ in range(count):
            host.ask(GS)
        exchange_s = (time.monotonic() - start_s) / count
        assert 0.98 * 54 * 10 / 38400 < exchange_s < 3 * 54 * 10 / 38400
