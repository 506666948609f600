"""`nserver --real` as a program: its robot is a second nserver, which is killed and restarted."""

from __future__ import annotations

import contextlib
import csv
import json
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import connect
from nclient.errors import ConnectionLost, RobotRefused
from nclient.robot import Robot
from tests.programs.forked import Forked
from tests.programs.ports import reserved
from tests.waiting import wait_until

TIMEOUT_S = 30.0


class Program:
    """A running nserver and its port."""

    def __init__(self, process: Forked) -> None:
        line = process.stdout.readline()
        found = re.fullmatch(r"listening nserver 127\.0\.0\.1:(\d+)\n", line)
        assert found, line
        self.process, self.port = process, int(found[1])
        self.address = f"nserver://127.0.0.1:{self.port}/1"

    def other_line(self) -> str:
        """Return its next listening address, such as `serial /tmp/nomad`."""
        return str(self.process.stdout.readline()).removeprefix("listening ").strip()

    def end(self, how: signal.Signals = signal.SIGTERM) -> str:
        """End it and return its stderr."""
        self.process.send_signal(how)
        return str(self.process.communicate(timeout=TIMEOUT_S)[1])


@contextlib.contextmanager
def nserver(*words: str) -> Iterator[Program]:
    with Forked("nserver", *words, stderr=True) as process:
        try:
            yield Program(process)
        finally:
            if process.poll() is None:
                process.kill()


def error_code(robot: Robot) -> int | None:
    """Return the error code of a request; None if it succeeds."""
    try:
        robot.refresh()
    except RobotRefused as error:
        return error.code
    return None


def test_gateway_drives_robot_and_shadow_follows(tmp_path: Path) -> None:
    report = tmp_path / "shadow.json"
    with (
        nserver("--port", "0") as robot,
        connect(robot.address) as observer,
        nserver("--port", "0", "--real", robot.address, "--shadow-report", str(report)) as gateway,
    ):
        with connect(gateway.address) as driver:
            driver.set_speeds(translation_in_s=10)
            driver.move(translation_in=12)
            state = driver.wait_until_still(timeout_s=20)
            # The gateway's state and the ground truth of the robot agree: 12 in.
            assert (state.x_in, observer.truth().x_in) == (12.0, 12.0)
            # The robot drives when its client disconnects, so that the stop is visible.
            driver.drive(translation_in_s=5)
        wait_until(lambda: not observer.refresh().moving)
        gateway.end()
        assert gateway.process.returncode == 0
    found = json.loads(report.read_text())["quantities"]
    # Half a second at 10 in/s: two servers on a busy machine.
    assert abs(found["x_in"]["max"]) < 5.0
    assert abs(found["x_in"]["mean"]) < 1.0
    assert found["sonars_in"]["count"] > 16


def test_lost_robot_is_error_6_until_it_returns() -> None:
    with contextlib.ExitStack() as again, nserver("--port", "0") as robot:
        port = str(robot.port)
        gateway = again.enter_context(nserver("--port", "0", "--real", robot.address))
        with connect(gateway.address) as driver, connect(gateway.address) as watcher:
            driver.drive(translation_in_s=5)
            # SIGKILL: the robot's server cannot send anything before its end.
            robot.end(signal.SIGKILL)
            wait_until(lambda: error_code(watcher) == 6)
            assert error_code(driver) == 6
            again.enter_context(nserver("--port", port))
            wait_until(lambda: error_code(watcher) is None)
            # The keep-alive thread has noticed the loss first.
            wait_until(lambda: error_code(driver) is None)
            assert driver.move(translation_in=1).raw[38] > 0
        errors = gateway.end()
    assert errors.count("the real robot does not answer") == 1
    assert errors.count("the real robot answers again") == 1


@pytest.mark.usefixtures("serial_ports")
def test_gateway_limits_speed_and_reconnects_to_line(tmp_path: Path) -> None:
    link, report = tmp_path / "nomad", tmp_path / "shadow.csv"
    robot_words = ("--port", "0", "--serial-link", str(link))
    gateway_words = ("--port", "0", "--real", f"serial://{link}?model=n150", "--max-speed", "8")
    with contextlib.ExitStack() as again, nserver(*robot_words) as robot:
        assert robot.other_line() == f"serial {link}"
        gateway = again.enter_context(nserver(*gateway_words, "--shadow-report", str(report)))
        with connect(gateway.address) as driver, connect(gateway.address) as watcher:
            with connect(robot.address) as observer:
                # 12 in/s are limited to 8: 80 tenths.
                assert driver.move(translation_in=12).raw[38] == 80
                assert driver.wait_until_still(timeout_s=20).x_in == 12.0
                assert observer.truth().x_in == 12.0
                assert driver.refresh().bumpers == ()
                assert driver.refresh().raw[33] == 0
                # A N150's compass shows the turret, which has not moved.
                assert watcher.read_compass().raw[43] == 0
                # The client's own timeout of 1 s applies at the robot; the gateway must not feed it meanwhile.
                driver.set_timeout(1)
                driver.drive(translation_in_s=2)
                time.sleep(2.5)
                assert not observer.refresh().moving
            with reserved(link):
                robot.end(signal.SIGKILL)
                wait_until(lambda: error_code(watcher) == 6)
                link.unlink(missing_ok=True)
            again.enter_context(nserver(*robot_words))
            wait_until(lambda: error_code(watcher) is None)
            # The keep-alive thread has noticed the loss first.
            wait_until(lambda: error_code(driver) is None)
            assert driver.move(translation_in=1).raw[38] > 0
        gateway.end()
        assert gateway.process.returncode == 0
    rows = {row["quantity"]: row for row in csv.DictReader(report.read_text().splitlines())}
    assert abs(float(rows["x_in"]["mean"])) < 12.0
    assert int(rows["sonars_in"]["count"]) > 16


def test_gateway_passes_stamps_and_laser_of_n200() -> None:
    with nserver("--port", "0", "--robot", "n200", "--robotd", "0") as robot:
        address = f"robotd://{robot.other_line().removeprefix('robotd ')}?model=n200"
        with nserver("--port", "0", "--real", address) as gateway:
            with connect(f"{gateway.address}?model=n200") as driver, connect(f"{robot.address}?model=n200") as observer:
                driver.position_data(sonars=True)
                driver.set_position(x_in=30.0, y_in=-40.0)
                # Stamps of the robot come through: their pose is the new one.
                wait_until(lambda: {stamp.x for stamp in driver.refresh().raw_stamps.values()} == {300})
                laser, wanted = driver.read_laser().laser, observer.read_laser().laser
                assert laser[0] == wanted[0] > 100
                off = max(abs(a - b) for a, b in zip(laser, wanted, strict=True))
                assert off < 100  # tenths; the camera has few rows
                assert driver.read_infrareds().infrareds == observer.read_infrareds().infrareds
            gateway.end()


def test_killed_gateway_stops_its_robot() -> None:
    with (
        nserver("--port", "0", "--robot", "n200") as robot,
        connect(f"{robot.address}?model=n200") as observer,
        nserver("--port", "0", "--real", f"{robot.address}?model=n200") as gateway,
    ):
        with contextlib.suppress(ConnectionLost), connect(gateway.address) as driver:
            driver.drive(translation_in_s=2)
            assert observer.refresh().moving
            # SIGKILL: the gateway cannot send a stop. Its connection to the robot's server closes, which stops the
            # robot.
            gateway.end(signal.SIGKILL)
        wait_until(lambda: not observer.refresh().moving)
