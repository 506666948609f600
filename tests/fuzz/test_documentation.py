"""The commands of docs/fuzzing.md are valid, and the command runs as a program."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz import __main__ as command
from fuzz.readers import READERS

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "fuzzing.md").read_text(encoding="utf-8")
# Every line of the page's shell blocks is a command.
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL) for line in block.splitlines()]


GUIDED = "from fuzz import __main__ as command; command.PACKAGES = ('worlds.io',); raise SystemExit(command.main())"
"""Instruments one module; scripts/test runs all readers with all packages instrumented, which takes 9 s."""


def run_fuzz(*options: str, program: tuple[str, ...] = ("-m", "fuzz")) -> str:
    """Run the module, as `scripts/fuzz` does, or another program, and return the output; it must find nothing."""
    command_line = [sys.executable, *program, *options]
    done = subprocess.run(command_line, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_script_runs_the_module() -> None:
    assert 'exec .venv/bin/python -m fuzz "$@"' in (ROOT / "scripts" / "fuzz").read_text()


@pytest.mark.parametrize("line", COMMANDS)
def test_documented_commands_are_valid(line: str) -> None:
    script, *arguments = shlex.split(line, comments=True)
    options = command._parser().parse_args(arguments)
    assert script == "scripts/fuzz"
    assert set(options.readers) <= set(READERS)
    if options.again:
        assert options.again.parent == Path("fuzz/found")
        assert options.again.name.partition("-")[0] in READERS


def test_defaults_are_those_documented() -> None:
    options = command._parser().parse_args([])
    assert (options.runs, options.jobs) == (10_000_000, os.cpu_count())


@pytest.mark.long
def test_list_names_all_readers() -> None:
    assert [line.split()[0] for line in run_fuzz("--list").splitlines()] == list(READERS)


@pytest.mark.long
@pytest.mark.parametrize("blind", [False, True], ids=["guided", "blind"])
def test_reader_runs_the_given_number_of_inputs(blind: bool, tmp_path: Path) -> None:
    if not blind:
        pytest.importorskip("atheris")
    options = "worlds", "--runs", "500", "--corpus", str(tmp_path)
    output = run_fuzz(*options, "--blind") if blind else run_fuzz(*options, program=("-c", GUIDED))
    # 500 inputs were counted.
    assert re.findall(r"^(\w+) +([\d,]+) ", output, re.MULTILINE) == [("worlds", "500")]
    # Only the guided run stores inputs that reached new code.
    assert any((tmp_path / "worlds").glob("*")) != blind
