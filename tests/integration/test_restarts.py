"""A client survives killed and restarted servers and hung-up pseudo-terminals, and reports each loss.

    pytest -s tests/integration/test_restarts.py --restarts 100
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient import ConnectionLost, Robot, connect
from nserver_emu.control import cli
from tests.programs.forked import Forked
from tests.programs.ports import reserved

BACK_S = 30.0
SET_IN = 12.5
"""Encoder position set by the test: a robot that was not restarted still has it."""
PULL = """
[[rule]]
name = "pull"
do = "hang_up"
command = "gs"
first = 1
"""


class Daemon:
    """An nserver on a link that is killed and restarted; `places`: the folder for link and socket."""

    def __init__(self, places: Path) -> None:
        self.link, self._socket, self._plan = places / "robot", places / "ctl.sock", places / "pull.toml"
        self._plan.write_text(PULL)
        self.start()

    def kill(self) -> None:
        """Kill it, like a power failure."""
        self._process.kill()
        self._process.communicate()

    def pull(self) -> None:
        """Hang up the pseudo-terminal with the next state; the link then leads to another."""
        assert cli.main(["--control", str(self._socket), "faults", "set", str(self._plan)]) == 0

    def start(self) -> None:
        """Start another one behind the same link."""
        words = ["--port", "0", "--serial-link", str(self.link), "--control", str(self._socket)]
        self._process = Forked("nserver", *words)
        for _ in range(3):
            assert self._process.stdout.readline().startswith("listening ")


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    running = Daemon(tmp_path)
    try:
        yield running
    finally:
        running.kill()


def expect_loss(robot: Robot) -> None:
    """Check that the next call reports the loss, once."""
    assert robot.link is not None
    losses = robot.link.losses
    with pytest.raises(ConnectionLost):
        robot.refresh()
    assert robot.link.losses == losses + 1


def reconnect_time_s(robot: Robot) -> float:
    """Return the seconds until a call succeeds; until then calls raise ConnectionLost."""
    start_s = time.monotonic()
    while time.monotonic() < start_s + BACK_S:
        with contextlib.suppress(ConnectionLost):
            robot.refresh()
            return time.monotonic() - start_s
    raise AssertionError(f"not back within {BACK_S:g} s")


@pytest.mark.usefixtures("serial_ports")
def test_client_survives_killed_servers_and_hangups(daemon: Daemon, request: pytest.FixtureRequest) -> None:
    times = request.config.getoption("--restarts")
    after_s: dict[str, list[float]] = {"pulled": [], "killed": []}
    with connect(f"serial://{daemon.link}?reconnect=0.2&feed=0") as robot:
        for _ in range(times):
            robot.set_position(x_in=SET_IN)
            daemon.pull()
            expect_loss(robot)
            after_s["pulled"].append(reconnect_time_s(robot))
            # The pseudo-terminal was replaced, the robot is the same.
            assert robot.state.x_in == SET_IN
            with reserved(daemon.link):
                daemon.kill()
                expect_loss(robot)
                # Nothing is there yet: further calls fail at once, without another loss.
                with pytest.raises(ConnectionLost, match="yet"):
                    robot.refresh()
                daemon.start()
            after_s["killed"].append(reconnect_time_s(robot))
            # A new robot: its encoders are at 0.
            assert robot.state.x_in == 0
        assert robot.link is not None
        assert (robot.link.losses, robot.link.reconnects) == (2 * times, 2 * times)
        assert robot.link.implausible == robot.link.misfits == 0
    for what, seconds in after_s.items():
        print(f"{what} {len(seconds)} times: each reported, reconnected within {max(seconds):.2f} s")
