"""A gateway in a running daemon: sockets, the robot's thread, and a clean end. The robot is another emulator."""

from __future__ import annotations

import argparse
import asyncio
import csv
import json
import logging
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest

from nclient import connect
from nclient.connector import Connector, open_backend
from nclient.errors import AddressError, ConnectionLost, RobotRefused
from nclient.protocol.commands import Call
from nserver_emu import cli
from nserver_emu.gateway import run as gateway_options
from nserver_emu.gateway.gateway import Gateway, RealRobotProxy
from nserver_emu.gateway.run import RealTimeSimulation, connected, model_of, run_gateway
from nserver_emu.server.daemon import Daemon
from tests.nserver_emu.gateway.harness import ScriptedRobot, emulated
from tests.nserver_emu.server.running_server import serving

WHOLE_S = 30


def parsed(*words: str) -> argparse.Namespace:
    """Return the options of a command line."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--lockstep")
    parser.add_argument("--record")
    gateway_options.add_options(parser)
    options = parser.parse_args(words)
    gateway_options.refuse(parser, options)
    return options


Scenario = Callable[[str], Awaitable[None]]


async def serve(proxy: RealRobotProxy, scenario: Scenario, *, shadow: bool = False, every_s: float = 60.0) -> None:
    """Run a daemon with a gateway to this robot while the scenario, which gets its address, runs."""
    emulator = emulated()
    gateway = Gateway(emulator, {1: proxy}, shadow=shadow)
    daemon = Daemon(emulator, 1.0, gateway)
    port = await daemon.listen("127.0.0.1", 0)
    async with run_gateway(gateway, daemon, every_s), serving(daemon, WHOLE_S):
        await scenario(f"nserver://127.0.0.1:{port}/1")


async def test_a_driving_client_does_not_block_others() -> None:
    def drive(address: str) -> None:
        with connect(address) as driver, connect(address) as watcher:
            driver.move(translation_in=6)
            # 6 in at the robot, seen by both clients.
            assert driver.wait_until_still(timeout_s=20).x_in == 6.0
            assert watcher.refresh().x_in == 6.0
            # Error 5: another client owns the robot. Error 4: a real robot has no ground truth.
            with pytest.raises(RobotRefused, match="error 5"):
                watcher.move(translation_in=1)
            with pytest.raises(RobotRefused, match="error 4"):
                watcher.truth()

    with connected(parsed("--real", "sim:thesis_room")) as proxies:
        assert model_of(proxies) == "n150"
        await serve(proxies[1], lambda address: asyncio.to_thread(drive, address), every_s=0.01)


def test_simulation_in_this_process_runs_in_real_time() -> None:
    now_s = 0.0
    robot = RealTimeSimulation(open_backend("sim:thesis_room"), lambda: now_s)
    robot.execute(Call("vm", (50, 0, 0)))
    now_s = 2.0
    # 5 in/s for 2 s, less the acceleration.
    assert robot.execute(Call("gs")).slots[34] == pytest.approx(100, abs=15)


async def test_a_shadow_is_summarized_and_reported(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def drive(address: str) -> None:
        with connect(address) as robot:
            robot.set_position(x_in=5.0)
            refreshed = 0
            # Until a summary is in the log, and for 20 states.
            while "real less simulated" not in caplog.text or refreshed < 20:
                robot.refresh()
                refreshed += 1

    for name in ("shadow.json", "shadow.csv"):
        caplog.clear()
        with connected(parsed("--real", "sim:thesis_room?seed=2", "--shadow-report", str(tmp_path / name))) as proxies:
            await serve(proxies[1], lambda address: asyncio.to_thread(drive, address), shadow=True, every_s=0.2)
    report = json.loads((tmp_path / "shadow.json").read_text())
    assert report["robot"] == "sim:thesis_room?seed=2"
    assert report["quantities"]["x_in"]["max"] == 0.0
    rows = list(csv.DictReader((tmp_path / "shadow.csv").read_text().splitlines()))
    assert int(rows[0]["count"]) > 10


def test_without_a_real_robot_there_is_no_proxy() -> None:
    with connected(parsed()) as proxies:
        assert (proxies, model_of(proxies)) == ({}, None)


def test_wrappers_that_the_gateway_replaces_are_off(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = list[Connector]()

    def open_scripted(connector: Connector) -> ScriptedRobot:
        opened.append(connector)
        return ScriptedRobot()

    monkeypatch.setattr(Connector, "open", open_scripted)
    with connected(parsed("--real", "serial:///dev/ttyUSB0?tm_s=7&retries=1&max_speed_in_s=6", "--max-turn", "9")):
        pass
    values = opened[0].address.options
    # The gateway feeds the watchdog and reconnects by itself; the wrappers of the address would do so as well.
    assert (values.tm_s, values.feed, values.reconnect) == (None, None, None)
    assert (values.retries, values.max_speed_in_s) == (1, 6.0)


@pytest.mark.parametrize(
    ("words", "args"),
    [
        # 4 in/s are 40 tenths; a limit of 5 deg/s holds for steering and turret.
        ((), (100, 200, 300)), (("--max-speed", "4"), (40, 200, 300)), (("--max-turn", "5"), (100, 50, 50)),
        (("--max-speed", "4", "--max-turn", "5"), (40, 50, 50)),
    ],
)  # fmt: skip
def test_speed_limits_are_those_of_the_command_line(words: tuple[str, ...], args: tuple[int, ...]) -> None:
    robot = ScriptedRobot()
    gateway_options.speed_limiter(parsed("--real", "sim:", *words))(robot).execute(Call("vm", (100, 200, 300)))
    assert robot.calls == [Call("vm", args)]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--max-speed", "8"], "--max-speed is about a real robot: name it with --real ADDRESS"),
        (["--shadow-report", "x.json"], "--shadow is about a real robot"),
        (["--real-read-only"], "--real-read-only is about"),
        (["--real", "sim:", "--lockstep", "0.1"], "--lockstep and --real do not go together"),
        (["--real", "sim:", "--record", "x.jsonl"], "record=FILE"),
        (["--real", "sim:", "--max-turn", "0"], "a number above 0, not '0'"),
        (["--real", "sim:", "--max-turn", "fast"], "a number above 0, not 'fast'"),
    ],
)
def test_wrong_usage_names_the_remedy(words: list[str], expected: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(words)
    assert stop.value.code == 2
    assert expected in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "expected", "code"),
    [
        (["--real", "simm:thesis_room"], "did you mean sim:", 2),
        (["--real", "nserver://127.0.0.1:1/1"], "127.0.0.1", 1),
        (["--real", "sim:thesis_room?robot=n200", "--robot", "n150"], "really a n200", 2),
    ],
)
def test_exit_1_if_unreachable_and_2_for_a_wrong_address(
    words: list[str], expected: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["--port", "0", *words]) == code
    assert expected in capsys.readouterr().err


def test_errors_are_those_of_connect() -> None:
    with pytest.raises(AddressError), connected(parsed("--real", "nowhere")):
        pass
    with pytest.raises(ConnectionLost), connected(parsed("--real", "nserver://127.0.0.1:1/1")):
        pass


async def test_a_reply_after_the_end_is_ignored(caplog: pytest.LogCaptureFixture) -> None:
    proxy = RealRobotProxy(ScriptedRobot, lambda: 0.0)

    async def nothing(_address: str) -> None:
        return None

    with caplog.at_level(logging.ERROR):
        await serve(proxy, nothing)
        # A result of the robot's thread may arrive when the loop is closed.
        proxy.robot.on_result()
    assert not caplog.records


