"""Run the commands of the page about other tools."""

from __future__ import annotations

import os
import re
import shutil
import signal
from pathlib import Path

import pytest

from nclient.protocol import codec
from nclient.protocol.commands import BY_NAME, Call
from nclient.protocol.replies import Reply
from nclient.protocol.types import N200, tcp_wire_state
from tests.docs.pages import ROOT, code_blocks, command_lines, run
from tests.nclient.cli.captures import TO_HOST, TO_ROBOT, Conversation, write_pcap
from tests.programs.forked import Forked

PAGE = "interop.md"


@pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed (apt install tshark)")
def test_commands_about_wireshark(tmp_path: Path) -> None:
    state = tcp_wire_state(N200)
    requests = [Call("connect_robot", (1, 4711)), Call("vm", (100, -50, 0)), Call("gs")]
    reply = Reply("state", slots={17: 12, 34: -5}, clock=1)
    segments = [(TO_ROBOT, codec.encode_tcp_request(call)) for call in requests]
    segments.append((TO_HOST, codec.encode_tcp_reply(BY_NAME["vm"], reply, state)))
    write_pcap(tmp_path / "capture.pcap", [Conversation(7019, segments)])
    written, all_messages, drives, near = [line for line in command_lines(PAGE) if "lua" in line]
    assert run(written, tmp_path) == ""
    shown = run(all_messages, tmp_path)
    assert "> vm 100 -50 0" in shown
    # The second packet, 1 ms after the first one, with the first argument of vm.
    assert run(drives, tmp_path).split() == ["0.001000000", "100"]
    # Sonar 0 and the x of the only state with a reading below the page's limit.
    assert run(near, tmp_path).split() == ["12", "-5"]


def test_commands_about_recordings(tmp_path: Path) -> None:
    lines = command_lines(PAGE)
    first = next(k for k, line in enumerate(lines) if "record=run.log" in line)
    # Ten commands in order: each reads the file of an earlier one.
    for line in lines[first : first + 10]:
        shown = run(line, tmp_path)
    assert "sonar" in shown
    assert len(list(tmp_path.glob("run*"))) == 6


def test_program_about_rosbridge(tmp_path: Path) -> None:
    (program,) = code_blocks(PAGE, "python")
    (tmp_path / "drive.py").write_text(program)
    server = Forked("nserver", "thesis_room", "--port", "0", "--rosbridge", "0")
    try:
        _, (_, kind, address) = (server.stdout.readline().split() for _ in range(2))
        assert kind == "rosbridge"
        shown = run(f"python drive.py '{address}'", tmp_path, timeout_s=60)
    finally:
        server.send_signal(signal.SIGTERM)
        server.communicate(timeout=30)
    assert float(shown.split()[-2]) > 0.1


@pytest.mark.long
def test_command_about_ros_2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("cyclonedds", reason="Cyclone DDS has no wheel for this system")
    # Domains of DDS are 0 to 232: one for each process, so that parallel runs do not receive each other's messages.
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % 231))
    (line,) = [line for line in command_lines(PAGE) if "cyclonedds" in line]
    server = Forked("nserver", "thesis_room", "--port", "0", "--ros2")
    try:
        while "ros2" not in server.stdout.readline():
            pass
        shown = run(f"{line} --id $ROS_DOMAIN_ID", tmp_path, timeout_s=60)
    finally:
        server.send_signal(signal.SIGTERM)
        server.communicate(timeout=30)
    assert "struct Odometry_" in shown


def test_udev_rule_names_real_keys() -> None:
    """Each line is a comment, a jump, or matches and assignments with their operators."""
    term = r'[A-Z]+(\{\w+\})?(==|!=|=|\+=)"[^"]*"'
    for line in (ROOT / "packaging" / "60-nomad.rules").read_text().splitlines():
        assert line.startswith("#") or re.fullmatch(f"{term}(, {term})*", line), line
