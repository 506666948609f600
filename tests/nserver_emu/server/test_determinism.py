"""The same seed and the same requests give the same bytes, with noise on, in lockstep, in whatever process."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from lockstep_run import run

REPLIES = 10_000
SCRIPT = Path(__file__).with_name("lockstep_run.py")


ALL_SENSES = "robot=n200&robot=scout&robots=2&setup=measured"


@pytest.mark.parametrize(("replies", "options"), [(REPLIES, "noisy=1"), (120, ALL_SENSES)])
def test_replies_are_the_same_in_two_processes(replies: int, options: str) -> None:
    def start(hash_seed: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(SCRIPT), "11", str(replies), options]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={"PYTHONHASHSEED": hash_seed})

    with start("1") as one, start("2") as other:
        said = [process.communicate(timeout=300)[0] for process in (one, other)]
    assert len(said[0]) == 65
    assert said[0] == said[1]


def test_another_seed_says_something_else() -> None:
    assert run(1, 200) == run(1, 200)
    assert run(1, 200) != run(2, 200)
