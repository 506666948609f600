"""Check the commands, the unit and the overrides of docs/service.md.

Commands that would change this machine are not run. The daemon is started with the arguments of the unit.
"""

from __future__ import annotations

import re
import shlex
import shutil
import signal
import subprocess
import tomllib
import urllib.request
from pathlib import Path

import pytest

from nserver_emu.cli import main
from tests.programs.forked import Forked

ROOT = Path(__file__).parents[2]
UNIT = ROOT / "packaging/nserver.service"
PAGE = (ROOT / "docs/service.md").read_text(encoding="utf-8")
(TYPED,) = re.findall(r"^```sh\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
ADDED, OPTIONS = re.findall(r"^```ini\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
ENVIRONMENT = "/opt/nserver/bin/"


def test_commands_name_existing_files() -> None:
    venv, install, unit, pages, *systemd, status = [shlex.split(line) for line in TYPED.splitlines()]
    assert venv == ["python3", "-m", "venv", str(Path(ENVIRONMENT).parent)]
    extra = re.fullmatch(r"\.\[(\w+)\]", install[-1])
    assert extra is not None
    assert extra[1] in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert (ROOT / unit[-2]).samefile(UNIT)
    assert UNIT.read_text().startswith(f"# Run nserver as a service: {unit[-1]}. ")
    assert f"Documentation=file://{pages[pages.index('-t') + 1]}/service.md\n" in UNIT.read_text()
    assert [line[0] for line in systemd] == ["systemd-analyze", "systemctl", "systemctl"]
    assert status[0] == f"{ENVIRONMENT}nserver"


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd-analyze is not on this machine")
def test_systemd_verifies_unit_and_override(tmp_path: Path) -> None:
    program, place = tmp_path / "nserver", tmp_path / "nserver.service"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    # systemd-analyze checks that the program exists, which is not installed here.
    place.write_text(UNIT.read_text().replace(f"{ENVIRONMENT}nserver", str(program)))
    (tmp_path / "nserver.service.d").mkdir()
    override = tmp_path / "nserver.service.d/override.conf"
    for added in ("", ADDED):
        override.write_text(added)
        done = subprocess.run(["systemd-analyze", "verify", str(place)], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
    # A control: without the check of a wrong value, "no errors" would prove nothing.
    override.write_text("[Service]\nPrivateDevices=perhaps\n")
    done = subprocess.run(["systemd-analyze", "verify", str(place)], capture_output=True, text=True, check=False)
    assert "perhaps" in done.stderr, "systemd reports errors"


def test_daemon_of_the_unit_serves_control_and_viewer(
    tmp_path_factory: pytest.TempPathFactory, capsys: pytest.CaptureFixture[str]
) -> None:
    # Short: the path of a Unix socket has at most about a hundred bytes.
    folder = tmp_path_factory.mktemp("s")
    (command,) = re.findall(r"^ExecStart=(.*)$", UNIT.read_text(), re.MULTILINE)
    for name in ("${STATE_DIRECTORY}", "${RUNTIME_DIRECTORY}"):
        command = command.replace(name, str(folder))
    options = OPTIONS.partition("=")[2].strip().strip('"').replace("/var/lib/nserver", str(folder))
    words = shlex.split(command.replace("$NSERVER_OPTIONS", options))
    socket = shlex.split(TYPED.splitlines()[-1])[-2].replace("/run/nserver", str(folder))
    assert words[words.index("--control") + 1] == socket
    with Forked("nserver", *words[1:], "--port", "0", "--viewer", "0") as daemon:
        try:
            # One line each for the port, the control socket and the window.
            places = dict(daemon.stdout.readline().split()[1:] for _ in range(3))
            assert main(["ctl", "--control", socket, "status"]) == 0
            assert "robot 2: n150" in capsys.readouterr().out
            # The first token of the file allows control; the printed address contains it.
            act = (folder / "tokens").read_text().splitlines()[0]
            page = f"{places['viewer'].partition('?')[0]}?token={act}"
            assert page == places["viewer"]
            with urllib.request.urlopen(page) as answer:
                assert answer.status == 200
        finally:
            daemon.send_signal(signal.SIGTERM)
    assert daemon.wait(60) == 0
    assert (folder / "now.json").exists()
