"""Programs of the 1990s on an Nserver, byte by byte on real sockets: their assumptions must hold.

The client is an independent implementation of docs/protocol.md with struct only, like the library of those programs.
"""

from __future__ import annotations

import contextlib
import itertools
import re
import signal
import socket
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from tests.programs.forked import Forked

pytestmark = pytest.mark.long

# Types of messages over TCP (docs/protocol.md).
AC, SP, PR, VM, GS, CT, ST, MV, GET_RC, GET_RV, GET_SN, GET_BP = 10, 11, 13, 12, 15, 16, 17, 43, 29, 30, 28, 35
PLACE, CONF_SN, CONF_TM, CONNECT, DISCONNECT, WS, QUIT = 41, 23, 26, 102, 103, 39, 70
STATE, ERROR = 80, 91
# The seven bytes of ct: 40 slots, laser and compass on, no position data.
ALL_SENSORS = (255, 255, 255, 255, 255, 0b1110, 0)
ORDER = (0, 2, 15, 1, 14, 3, 13, 4, 12, 5, 11, 6, 10, 7, 9, 8)
# Tenths of an inch per second: 20 in/s.
TOP_SPEED = 200
END_S = 20


class OldClient:
    """The C library as compiled at the time, or (`wide`) as the same source becomes on 64 bits."""

    def __init__(self, host: str, port: int, wide: bool = False) -> None:
        self._socket = socket.create_connection((host, port), timeout=END_S)
        self._wide = wide

    def ask(self, message_type: int, *words: int) -> tuple[int, list[int]]:
        """Type and words of the answer."""
        self.send(message_type, *words)
        return self.read_reply()

    def read_reply(self) -> tuple[int, list[int]]:
        """Type and words of the next reply."""
        answered, count = struct.unpack(">hH", self._read(4))
        # A reply word of a 64-bit client is the value and four padding bytes; a request word has the padding first.
        layout = ">i4x" if self._wide else ">i"
        data = self._read(count * struct.calcsize(layout))
        return answered, [word for (word,) in struct.iter_unpack(layout, data)]

    def send(self, message_type: int, *words: int) -> None:
        """Send a request and wait for nothing."""
        layout = ">4xi" if self._wide else ">i"
        data = b"".join(struct.pack(layout, word) for word in words)
        self._socket.sendall(struct.pack(">hH", message_type, len(words)) + data)

    def send_in_pieces(self, message_type: int, *words: int) -> None:
        """Write header and words one by one."""
        self._socket.sendall(struct.pack(">hH", message_type, len(words)))
        for word in words:
            self._socket.sendall(struct.pack(">i", word))

    def connect_robot(self) -> int:
        """CONNECT, then the CT that the library sends at once; the port."""
        _, (port,) = self.ask(CONNECT, 1, 4711)
        self.ask(CT, *ALL_SENSORS)
        return port

    def close(self) -> None:
        """Hang up without a word, as programs that end do."""
        self._socket.close()

    def _read(self, count: int) -> bytes:
        data = self._socket.recv(count, socket.MSG_WAITALL)
        assert len(data) == count
        return data


@contextlib.contextmanager
def nserver(*words: str) -> Iterator[int]:
    """A daemon; the port it listens on."""
    with Forked("nserver", *words) as process:
        try:
            line = re.fullmatch(r"listening nserver 127\.0\.0\.1:(\d+)\n", process.stdout.readline())
            assert line
            yield int(line[1])
        finally:
            process.terminate()


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with nserver("--port", "0", "--speed", "5") as number:  # 20 times as fast a busy machine was late
        yield number


@pytest.fixture
def client(port: int) -> Iterator[OldClient]:
    made = OldClient("127.0.0.1", port)
    made.connect_robot()
    # st ends a motion of the last test, then the robot is placed at the origin: all tests share one daemon.
    made.ask(ST)
    made.ask(PLACE, 0, 0, 0, 0)
    yield made
    made.close()


def test_teambots_waits_for_a_motion_by_asking_for_velocities(client: OldClient) -> None:
    """mv relative, then get_rv until all three are 0: never 0 before the robot is there."""
    client.ask(SP, 100, 300, 300)
    asked = 0
    # Forth, back, and the shortest motion there is, 0.1 in.
    for distance, target in ((300, 300), (-300, 0), (1, 1)):
        client.ask(MV, 2, distance, 0, 0, 0, 0)
        while client.ask(GET_RV)[1] != [0, 0, 0]:
            asked += 1
        assert client.ask(GET_RC)[1][0] == target
    # Over all three: a tenth of an inch may be gone between two questions on a busy machine.
    assert asked > 0


def test_an_mv_that_leaves_all_axes_changes_nothing(client: OldClient) -> None:
    # Steering at 5 deg/s. Mode 0 of mv leaves an axis as it is.
    client.ask(VM, 0, 50, 0)
    for _ in range(20):
        kind, state = client.ask(MV, 0, 0, 0, 0, 0, 0)
        assert kind == STATE
        assert state[38:41] == [0, 50, 0]
    client.ask(ST)
    assert client.ask(MV, 0, 0, 0, 0, 0, 0)[1][38:41] == [0, 0, 0]


def test_a_fast_loop_of_queries_and_motions(client: OldClient) -> None:
    # At 1 in/s forth and back the robot never reaches a wall; the timeout of 5 s is never reached either.
    client.ask(PLACE, 450, 450, 0, 0)
    client.ask(CONF_SN, 15, *ORDER)
    client.ask(CONF_TM, 5)
    for turn in range(300):
        speed = 10 if turn % 2 else -10
        assert len(client.ask(GET_RC)[1]) == 4
        assert len(client.ask(GET_SN)[1]) == 17
        assert client.ask(GET_BP)[1][0] == 0
        assert client.ask(MV, 1, speed, 0, 0, 0, 0)[0] == STATE
        kind, state = client.ask(MV, 0, 0, 1, 20, 1, -20)
        assert (kind, state[38:41]) == (STATE, [speed, 20, -20])


def test_swapped_limits_are_clamped_silently(client: OldClient) -> None:
    """Steering's numbers first, translation's last, one of them negative, some far too high."""
    assert client.ask(AC, 500, 500, 300)[0] == STATE
    # Translation gets 450, above its top speed of 200.
    assert client.ask(SP, 450, 450, TOP_SPEED)[0] == STATE
    client.ask(PR, 400, 0, 0)
    assert client.ask(GET_RV)[1][0] == TOP_SPEED
    client.ask(WS, 1, 1, 1, 30)
    # Of a speed only the amount counts: the robot goes back at 5 in/s.
    assert client.ask(SP, -50, 1_000_000, -1)[0] == STATE
    client.ask(PR, -400, 0, 0)
    assert client.ask(GET_RV)[1][0] == -50
    client.ask(WS, 1, 1, 1, 30)
    # vm clamps each axis to its own top speed.
    assert client.ask(VM, 99_999, -99_999, 0)[1][38:41] == [TOP_SPEED, -450, 0]
    client.ask(SP, 200, 450, 450)


@pytest.mark.parametrize("wide", [False, True])
def test_a_second_connection_continues_without_connect(port: int, wide: bool) -> None:
    first = OldClient("127.0.0.1", port, wide)
    returned = first.connect_robot()
    second = OldClient("127.0.0.1", returned, wide)
    first.close()
    # Both connections are of one client, so the second continues as robot 1 without CONNECT.
    assert second.ask(PLACE, 100, 200, 0, 0) == (82, [0])
    kind, state = second.ask(GS)
    assert (kind, state[34:36]) == (STATE, [100, 200])
    second.send(DISCONNECT, 1, 4711)
    second.close()


def test_connect_to_robot_0_is_answered(port: int) -> None:
    client = OldClient("127.0.0.1", port)
    assert client.ask(CONNECT, 0, 4711) == (82, [0])
    assert client.ask(CONNECT, 1, 4711) == (82, [port])
    client.close()


def test_two_programs_never_get_each_others_robots() -> None:
    """Both go on over second connections, without CONNECT and at the same time."""
    with nserver("--port", "0", "--robots", "2") as port, contextlib.ExitStack() as clients:
        one, two = (OldClient("127.0.0.1", port) for _ in range(2))
        # Two clients of one address with different robots: a connection without CONNECT is ambiguous.
        assert [client.ask(CONNECT, robot, 4711)[1] for robot, client in ((1, one), (2, two))] == [[port]] * 2
        for _ in range(2):
            second = OldClient("127.0.0.1", port)
            clients.callback(second.close)
            assert second.ask(GS) == (ERROR, [3])
        for client in (two, one):
            client.send(DISCONNECT, 1, 4711)
            client.close()
        # one after another
        for robot, x in ((1, 20), (2, 600)):
            first = OldClient("127.0.0.1", port)
            first.ask(CONNECT, robot, 4711)
            second = OldClient("127.0.0.1", port)
            assert second.ask(PLACE, x, 600, 0, 0) == (82, [0])
            for client in (first, second):
                clients.callback(client.close)
        assert second.ask(GS)[1][34] == 600


def test_signals_while_quitting_are_no_error() -> None:
    words = ("--port", "0", "--allow-quit")
    with subprocess.Popen([sys.executable, "-m", "nserver_emu", *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True) as daemon:  # fmt: skip
        assert daemon.stdout is not None
        client = OldClient("127.0.0.1", int(daemon.stdout.readline().rpartition(":")[2]))
        client.connect_robot()
        assert client.ask(QUIT) == (82, [0])
        # Signals arrive while the daemon ends, which ignores them from then on (daemon.py, ignore_signals).
        for number in itertools.cycle((signal.SIGTERM, signal.SIGINT, signal.SIGHUP)):
            if daemon.poll() is not None:
                break
            daemon.send_signal(number)
            time.sleep(0.0005)
        client.close()
        assert (daemon.returncode, daemon.communicate()[1]) == (0, "")


@pytest.mark.skipif(not hasattr(socket, "TCP_QUICKACK"), reason="only Linux acknowledges at once on request")
def test_request_in_pieces_is_not_delayed(port: int) -> None:
    """Programs wrote header and words one by one, and did not switch Nagle's algorithm off."""
    client = OldClient("127.0.0.1", port)
    client.connect_robot()
    times_s = []
    # The median, as single requests may be delayed by a busy machine. A delayed acknowledgement takes 40 ms.
    for _ in range(21):
        before_s = time.perf_counter()
        client.send_in_pieces(VM, 0, 0, 0)
        client.read_reply()
        times_s.append(time.perf_counter() - before_s)
    assert statistics.median(times_s) < 0.02
    client.close()


def test_a_client_on_64_bits_drives_and_reads(port: int) -> None:
    client = OldClient("127.0.0.1", port, wide=True)
    assert client.connect_robot() == port
    client.ask(PLACE, 0, 0, 0, 0)
    kind, state = client.ask(VM, -30, 0, 0)
    assert (kind, state[38]) == (STATE, -30)
    assert client.ask(ST)[1][38] == 0
    # An unknown type gets an error, and the session stays synchronised.
    assert client.ask(999, 1)[0] == ERROR
    assert client.ask(GS)[0] == STATE
    client.close()


def test_the_port_option_of_the_original(free_port: int) -> None:
    with nserver("-port", str(free_port)) as number:
        assert number == free_port
        client = OldClient("127.0.0.1", free_port)
        assert client.connect_robot() == free_port
        client.close()


@pytest.fixture
def free_port() -> int:
    """Return the port 7654, which many programs use, or another one if it is in use."""
    with contextlib.closing(socket.socket()) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", 7654))
        except OSError:
            probe.bind(("127.0.0.1", 0))
        number: int = probe.getsockname()[1]
        return number
