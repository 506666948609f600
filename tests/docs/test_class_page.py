"""The command of docs/class.md with its class file, and the example program on one of its robots."""

from __future__ import annotations

import csv
import os
import re
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.docs.pages import DOCS, ROOT, command_lines, environment_with_venv

pytestmark = pytest.mark.long


def test_class_of_the_page(tmp_path: Path) -> None:
    page = (DOCS / "class.md").read_text(encoding="utf-8")
    # The class file of the page: its first line names the column.
    (names,) = re.findall(r"```text\n(name\n.*?)```", page, re.DOTALL)
    (tmp_path / "students.csv").write_text(names)
    (command,) = command_lines("class.md")
    words = [*shlex.split(command), "--port", "0", "--viewer", "0"]
    environment = environment_with_venv()
    with subprocess.Popen(words, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            # One line for each listener: the robots' port, and the page of the window.
            assert [server.stdout.readline().split()[1] for _ in range(2)] == ["nserver", "viewer"]
            students = list(csv.DictReader((tmp_path / "students.links.csv").read_text().splitlines()))
            assert [student["name"] for student in students] == names.split()[1:]
            for column in ("name", "robot", "page", "program"):
                assert f"`{column}`" in page
                assert students[1][column]
            # The second student's address, with the password that belongs to it.
            client = [sys.executable, str(ROOT / "examples" / "class_client.py"), students[1]["program"], "0.2"]
            done = subprocess.run(client, capture_output=True, text=True, env=os.environ, timeout=60, check=True)
            assert "nearest thing ahead" in done.stdout
        finally:
            server.send_signal(signal.SIGTERM)
    assert server.returncode == 0
