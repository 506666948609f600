"""`scripts/fuzz` as a program with atheris: interrupting it, and the corpus that remains.

Only the module of one reader is instrumented, which takes no time; scripts/test runs all readers.
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


def test_interrupted_run_keeps_its_corpus(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FUZZ, "--corpus", str(tmp_path), "hello", "--jobs", "1"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        until_s = time.monotonic() + 200
        while not any((tmp_path / "hello").glob("*")) and time.monotonic() < until_s:
            time.sleep(0.05)
        time.sleep(0.5)
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=60)
    assert run.returncode == 130, err
    assert str(tmp_path) in err
    row = out.splitlines()[-1].split()
    assert (row[0], int(row[1].replace(",", "")) > 0) == ("hello", True)
    assert any((tmp_path / "hello").iterdir())
