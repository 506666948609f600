"""nomad ros2: a robot at any address as ROS 2 topics, with Cyclone DDS's own tools and programs on the other side."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from nclient import connect
from nclient.cli.main import main
from nserver_emu.ros import options as ros2_options
from nserver_emu.ros.options import LOOPBACK, config_of
from tests.integration.test_rosbridge_command import running
from tests.nserver_emu.ros.other_side import free_domain
from tests.nserver_emu.ros.test_ros2 import SUBSCRIBER
from tests.programs.forked import Forked

DOMAIN = str(free_domain())
TOOL = Path(sys.executable).parent / "cyclonedds"


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Variables of the programs of a test: a domain of their own on loopback."""
    monkeypatch.setenv("ROS_DOMAIN_ID", DOMAIN)
    return os.environ | {"CYCLONEDDS_URI": config_of(LOOPBACK) or "", "COLUMNS": "200"}


def started(bridge: Forked) -> None:
    """Wait until a bridge serves."""
    while "ros2" not in (line := bridge.stdout.readline()):
        assert line, "it has ended"


@pytest.mark.long
def test_other_process_drives_and_is_killed(environment: dict[str, str]) -> None:
    with running("nserver", "--port", "0") as server:
        robot = f"nserver://{server.stdout.readline().split()[2]}/1"
        with running("nomad", "ros2", robot) as bridge:
            started(bridge)
            program = [sys.executable, "-c", SUBSCRIBER, DOMAIN]
            driver = subprocess.Popen(program, env=environment, stdout=subprocess.PIPE)
            assert driver.stdout is not None
            assert driver.stdout.readline() == b"moved\n"
            # SIGKILL: nothing is published any more, so the robot stops by the drive timeout.
            driver.kill()
            driver.communicate()
            with connect(robot) as watcher:
                assert not watcher.wait_until_still(timeout_s=5).moving
            bridge.send_signal(signal.SIGINT)
            assert bridge.wait(30) == 0


@pytest.mark.long
def test_tools_of_cyclone_dds(environment: dict[str, str]) -> None:
    def shown(*words: str) -> str:
        program = [str(TOOL), *words]
        return subprocess.run(program, env=environment, capture_output=True, text=True, timeout=60, check=True).stdout

    with running("nomad", "ros2", "sim:thesis_room", "--map", "thesis_room") as bridge:
        started(bridge)
        domain = ("--id", DOMAIN)
        listed = shown("ls", *domain, "--suppress-progress-bar")
        # Names as DDS has them: rt/ in front of topics, dds_ in types.
        for name in ("rt/robot1/odom", "nav_msgs::msg::dds_::Odometry_", "rt/tf_static", "rt/map", "rt/robot1/cmd_vel"):
            assert name in listed
        assert str(bridge.pid) in shown("ps", *domain, "--suppress-progress-bar")
        assert "struct Odometry_" in shown("typeof", "rt/robot1/odom", *domain, "--suppress-progress-bar")
        program = [str(TOOL), "subscribe", "rt/robot1/odom", *domain]
        with subprocess.Popen(program, env=environment, stdout=subprocess.PIPE, text=True) as subscriber:
            assert subscriber.stdout is not None
            assert any("robot1/base_link" in line for line in subscriber.stdout)
            subscriber.send_signal(signal.SIGINT)
            subscriber.communicate(timeout=30)


@pytest.mark.parametrize(("words", "variables", "code", "text"), [
    (["nserver://127.0.0.1:1"], {}, 1, "127.0.0.1:1"),
    (["sim:", "--interface", "no_such_0"], {}, 1, "network interface"),
    # Domains are 0 to 232.
    (["sim:"], {"ROS_DOMAIN_ID": "233"}, 2, "ROS_DOMAIN_ID"),
    (["sim:", "--rosbridge", "x"], {}, 2, "--rosbridge"),
    (["sim:", "--distro", "jazy"], {}, 2, "jazzy"),
])  # fmt: skip
def test_errors_name_their_cause(
    words: list[str], variables: dict[str, str], code: int, text: str, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    try:
        found = main(["ros2", *words])
    except SystemExit as ended:
        found = int(str(ended.code))
    assert found == code
    assert text in capsys.readouterr().err


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(ros2_options, "_PACKAGES", ("no_such_package",))
    assert main(["ros2", "sim:"]) == 2
    assert "[ros2]" in capsys.readouterr().err


def test_configuration_for_other_programs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ros2", "--print-config"]) == 0
    assert 'address="127.0.0.1"' in capsys.readouterr().out
    assert 'name="eth0"' in (config_of("eth0") or "")
    assert 'address="192.168.1.5"' in (config_of("192.168.1.5") or "")
    assert config_of("any") is None
