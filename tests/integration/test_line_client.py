"""The client of a robot's own line with a running nserver: pseudo-terminals, TCP lines, killed programs."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from nclient import ConnectionLost, capi, connect
from nclient.errors import ReplyTimeout
from nclient.robot import Robot
from tests.programs.forked import Forked
from tests.programs.ports import reserved
from tests.waiting import CLOSE_NOTICED_S, wait_until

TIMEOUT_S = 30.0


class Server:
    """An nserver with lines; `addresses`: where it listens, by kind."""

    def __init__(self, *words: str) -> None:
        self.process = Forked("nserver", "--port", "0", *words)
        count = 1 + sum(word in ("--serial-link", "--robotd") for word in words)
        lines = [self.process.stdout.readline().split() for _ in range(count)]
        self.addresses = {kind: where for _, kind, where in lines}

    def end(self, how: signal.Signals = signal.SIGTERM) -> None:
        self.process.send_signal(how)
        self.process.communicate(timeout=TIMEOUT_S)


@contextlib.contextmanager
def run_server(*words: str) -> Iterator[Server]:
    running = Server(*words)
    try:
        yield running
    finally:
        if running.process.poll() is None:
            running.end()


def has_all_answers(robot: Robot) -> bool:
    """Return True if every exchange on the line had an answer."""
    link = robot.link
    return link is not None and link.answers == link.exchanges


@pytest.mark.usefixtures("serial_ports")
@pytest.mark.parametrize("model", ["n150", "n200", "scout"])
def test_drive_on_serial_line_and_over_tcp(model: str, tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with run_server("--robot", model, "--serial-link", str(link), "--robotd", "0") as server:
        for address in (f"serial://{link}", f"robotd://{server.addresses['robotd']}"):
            with connect(f"{address}?model={model}") as robot:
                start = robot.read_pose().y_in
                robot.set_position(x_in=0, y_in=0)
                robot.move(translation_in=5)
                assert robot.wait_until_still(20).x_in == pytest.approx(5, abs=0.3)
                assert robot.state.bumpers == ()
                assert robot.link is not None
                # The keep-alive may be in the midst of an exchange.
                wait_until(partial(has_all_answers, robot))
                assert start == 0


def test_capi_opens_a_line(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with run_server("--serial-link", str(link)):
        try:
            assert capi.connect_robot(1, capi.MODEL_N150, str(link), 38400) == capi.TRUE
            assert capi.gs() == capi.TRUE
            # The rest value of the bumper bits, as old programs see it.
            assert capi.State[33] == 0xF00000
            assert capi.connect_robot(1, capi.MODEL_N150, str(tmp_path / "none"), 38400) == capi.FALSE
        finally:
            capi.disconnect_robot(1)


def count_losses(robot: Robot) -> int:
    """Return how many calls fail until one succeeds."""
    lost = 0
    while True:
        try:
            robot.refresh()
        except (ConnectionLost, ReplyTimeout):
            lost += 1
            assert lost < 100
            continue
        return lost


@pytest.mark.usefixtures("serial_ports")
@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_client_reconnects_to_restarted_server(how: signal.Signals, tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with run_server("--serial-link", str(link)) as first, connect(f"serial://{link}?reconnect=0.2") as robot:
        robot.refresh()
        with reserved(link):
            first.end(how)
            with pytest.raises(ConnectionLost):
                robot.refresh()
            with run_server("--serial-link", str(link)):
                count_losses(robot)
                assert robot.link is not None
                # One loss and one reconnection, however many calls failed in between.
                assert (robot.link.losses, robot.link.reconnects) == (1, 1)


DRIVES_AND_SLEEPS = """
import sys, time
from nclient import connect
from tests.programs.ports import select_ports
select_ports()
robot = connect(sys.argv[1])
robot.drive(translation_in_s=0.5)
print("driving", flush=True)
time.sleep(60)
"""


@pytest.mark.usefixtures("serial_ports")
def test_keep_alive_while_sleeping_and_stop_after_kill(tmp_path: Path) -> None:
    link = tmp_path / "robot"
    with (
        run_server("--serial-link", str(link)) as server,
        connect(f"nserver://{server.addresses['nserver']}/1?tm_s=0") as observer,
    ):
        command = [sys.executable, "-c", DRIVES_AND_SLEEPS, f"serial://{link}?tm_s=2"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
            assert program.stdout is not None
            assert program.stdout.readline() == "driving\n"
            # Longer than the timeout of 2 s: only the keep-alive thread has sent anything.
            time.sleep(3.0)
            assert observer.truth().x_in > 0.5 * 2.5
            program.kill()
        wait_until(lambda: not is_moving(observer))


def is_moving(observer: Robot) -> bool:
    """Return True if the true position changes within 0.1 s. The requests reset the time-out of the robot."""
    before = observer.truth()
    wait_until(lambda: observer.truth().time_s > before.time_s + 0.1)
    return observer.truth().x_in != before.x_in


@pytest.mark.usefixtures("serial_ports")
def test_next_connection_finds_robot_stopped(tmp_path: Path) -> None:
    with run_server("--serial-link", str(tmp_path / "nomad")):
        address = f"serial://{tmp_path / 'nomad'}?model=n150"
        for _ in range(3):
            first = connect(address)
            first.drive(turret_deg_s=10)
            # The port is closed without a stop, as by a program that is killed.
            first._backend.close()
            time.sleep(CLOSE_NOTICED_S)
            with connect(address) as second:
                assert second.refresh().raw[38:41] == (0, 0, 0)
