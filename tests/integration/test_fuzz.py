"""`scripts/fuzz` as a program, where atheris is installed: a short slice under its instrumentation, and Ctrl-C.

Instrumented is the room of its reader alone, which takes no time; all of them are in the minute of scripts/test.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("atheris", reason="atheris has no wheel for this system")
ROOT = Path(__file__).parents[2]
FUZZ = """
from fuzz import __main__ as command
command.PACKAGES = ("nclient.protocol.client_state",)
raise SystemExit(command.main())
"""


def test_a_slice_finds_nothing_and_one_that_is_stopped_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FUZZ, "--work", str(tmp_path), "hello", "--jobs", "1"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        counts = tmp_path / "hello.json"
        until_s = time.monotonic() + 200
        while not counts.exists() and time.monotonic() < until_s:
            time.sleep(0.05)
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=60)
    assert run.returncode == 130, err
    assert f"stopped; --work {tmp_path} goes on from here" in err
    row = out.splitlines()[-1].split()
    assert (row[0], int(row[1].replace(",", "")) > 0) == ("hello", True)
