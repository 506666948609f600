"""docs/fuzzing.md: its commands as the program itself reads them; those that are soon done are run.

Rules: what takes hours is run with few inputs, and of one reader; nothing is kept of a run.
"""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import __main__ as command
from fuzz.table import READERS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "fuzzing.md").read_text(encoding="utf-8")
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]
FEW = "500"


def words(typed: str) -> list[str]:
    script, *given = shlex.split(typed, comments=True)
    assert script == "scripts/fuzz"
    return given


def the_one(word: str) -> list[str]:
    (typed,) = [typed for typed in COMMANDS if word in words(typed)]
    return words(typed)


def fuzz(*given: str) -> str:
    """What it prints, as `scripts/fuzz` runs it; it must find nothing."""
    done = subprocess.run([sys.executable, "-m", "fuzz", *given], cwd=ROOT, capture_output=True, text=True, timeout=300,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_script_is_the_program_of_these_tests() -> None:
    assert 'exec .venv/bin/python -m fuzz "$@"' in (ROOT / "scripts" / "fuzz").read_text()


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_command_of_the_page_is_understood(typed: str) -> None:
    options = command._parser().parse_args(words(typed))
    assert set(options.readers) <= set(READERS)
    if options.again:
        assert options.again.parent == Path("fuzz/found")
        assert options.again.name.partition("-")[0] in READERS


def test_what_the_page_says_beside_its_commands_is_so() -> None:
    comments = dict(re.findall(r"^(scripts/fuzz.*?) +# (.*)$", PAGE, re.MULTILINE))
    options = command._parser().parse_args([])
    assert comments["scripts/fuzz"] == "ten million inputs per reader, one reader per core"
    assert (options.runs, options.jobs) == (10_000_000, os.cpu_count())
    assert "scripts/test does this each time" in comments["scripts/fuzz --seconds 60"]
    assert "-m fuzz --seconds 60;" in (ROOT / "scripts" / "test").read_text()


def test_the_readers_are_told() -> None:
    assert [line.split()[0] for line in fuzz(*the_one("--list")).splitlines()] == list(READERS)


@pytest.mark.long
@pytest.mark.parametrize("blind", [False, True], ids=["led", "blind"])
def test_a_reader_has_the_inputs_that_were_asked_for(blind: bool) -> None:
    if not blind:
        pytest.importorskip("atheris")
    given = the_one("worlds")
    given[given.index("--runs") + 1] = FEW
    told = fuzz(*given, *(the_one("--blind") if blind else []))
    assert re.findall(r"^(\w+) +([\d,]+) ", told, re.MULTILINE) == [("worlds", FEW)]
