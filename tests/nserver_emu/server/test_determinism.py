"""The same seed and the same requests give the same bytes, with noise on, in lockstep, in whatever process."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import Call
from nclient.protocol.types import EVERYTHING
from tests.nserver_emu.server.lockstep_run import run
from tests.programs.forked import Forked

pytestmark = pytest.mark.long

REPLIES = 1000  # each kind of request twenty times
SCRIPT = Path(__file__).with_name("lockstep_run.py")


ALL_SENSES = "robot=n200&robot=scout&robots=2&setup=measured"


@pytest.mark.parametrize(("replies", "options"), [(REPLIES, "noisy=1"), (60, ALL_SENSES)])
def test_replies_are_the_same_in_two_processes(replies: int, options: str) -> None:
    def start(hash_seed: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(SCRIPT), "11", str(replies), options]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={"PYTHONHASHSEED": hash_seed})

    with start("1") as one, start("2") as other:
        outputs = [process.communicate(timeout=300)[0] for process in (one, other)]
    assert len(outputs[0]) == 65
    assert outputs[0] == outputs[1]


def test_another_seed_gives_other_bytes() -> None:
    assert run(1, 200) == run(1, 200)
    assert run(1, 200) != run(2, 200)


CROWD = ("--robot", "n150", "--robot", "n200", "--robot", "scout", "--start", "20,20,30,0", "--start", "70,70,200,10",
         "--start", "75,25,120,0")  # fmt: skip


@pytest.mark.parametrize("setup", ["building", "worn"])  # the random draws of measured and of noisy, and more
def test_lockstep_is_repeatable_with_three_clients(setup: str) -> None:
    words = ["--port", "0", "--lockstep", "0.1", "--seed", "5", "--setup", setup, *CROWD]
    command = [sys.executable, "-m", "nserver_emu", *words]
    # Two processes with different orders of sets.
    environment = {**os.environ, "PYTHONHASHSEED": "3"}
    with contextlib.ExitStack() as stack:
        daemons: list[Forked | subprocess.Popen[str]] = [
            stack.enter_context(Forked("nserver", *words)),
            stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)),
        ]
        try:
            ports = [int(daemon.stdout.readline().rpartition(":")[2]) for daemon in daemons if daemon.stdout]
            outputs = [exchange(port) for port in ports]
        finally:
            for daemon in daemons:
                daemon.terminate()
    assert outputs[0] == outputs[1]


def exchange(port: int) -> bytes:
    """The replies to three clients that request in turn, with all sensors."""
    with contextlib.ExitStack() as stack:
        clients = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=20)) for _ in range(3)]
        received = b""
        for number in range(48):  # each question twice before and once after the last setting
            for robot_id, client in enumerate(clients, start=1):
                call = Call("connect_robot", (robot_id, 1)) if number == 0 else question(number)
                client.sendall(codec.encode_tcp_request(call))
                answer = whole_reply(client)
                received += b"" if number == 0 else answer
    assert len(received) > 10_000
    return received


def question(number: int) -> Call:
    """A motion, settings of the sensors, then questions and waits."""
    first = {1: Call("vm", (60, 40, -50)), 2: Call("ct", EVERYTHING.with_position(31).smask), 3: Call("conf_cp", (2,)),
             4: Call("conf_sn", (5, *range(16))), 5: Call("conf_ir", (5, *range(16))), 6: Call("get_ls"),
             30: Call("pr", (-60, 900, 300)), 31: Call("ws", (1, 1, 1, 2)), 40: Call("arm_mv", (2, 500, 1, 100)),
             41: Call("arm_ws", (1, 0, 500))}  # fmt: skip
    return first.get(number, Call(("gs", "get_cp", "get_ir", "get_sg", "get_rpx", "sim_truth")[number % 6]))


def whole_reply(client: socket.socket) -> bytes:
    """One reply with its head."""
    head = client.recv(4, socket.MSG_WAITALL)
    return head + client.recv(4 * int.from_bytes(head[2:], "big"), socket.MSG_WAITALL)
