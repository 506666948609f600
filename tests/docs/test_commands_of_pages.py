"""Check that every page with commands has a test, and that commands that take hours have valid arguments."""

from __future__ import annotations

import importlib
import re
import runpy
import shlex
from pathlib import Path

import pytest

from localization.experiments import __main__
from nclient.cli import main
from nserver_emu.cli import nserver_parser

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TESTS_OF_PAGES = {
    "calibration.md": "docs/test_calibration_and_maps_pages.py",
    "batch.md": "nserver_emu/simulation/test_batch.py",
    "c-programs.md": "docs/test_pages.py",
    "challenge.md": "docs/test_course_page.py",
    "class.md": "docs/test_class_page.py",
    "course.md": "docs/test_course_page.py",
    "examples.md": "docs/test_examples.py",
    "faults.md": "docs/test_pages.py",
    "files.md": "nclient/cli/test_schema.py",
    "from-c.md": "docs/test_from_c_page.py",
    "fuzzing.md": "fuzz/test_documentation.py",
    "gym.md": "docs/test_gym_page.py",
    "interop.md": "docs/test_interop_page.py",
    "localization.md": "docs/test_pages.py",
    "map-your-room.md": "docs/test_newcomer_pages.py",
    "maps.md": "docs/test_calibration_and_maps_pages.py",
    "mapping.md": "docs/test_calibration_and_maps_pages.py",
    "missions.md": "docs/test_missions_page.py",
    "own-filter.md": "docs/test_own_filter_page.py",
    "protocol.md": "docs/test_protocol_page.py",
    "real-data.md": "localization/experiments/test_corridor.py",
    "real-robot.md": "docs/test_pages.py",
    "rings.md": "docs/test_rings_page.py",
    "security.md": "docs/test_tunnels.py",
    "sensors.md": "docs/test_pages.py",
    "service.md": "docs/test_service_page.py",
    "setups.md": "nserver_emu/simulation/test_setup_files.py",
    "shell.md": "docs/test_shell_page.py",
    "start.md": "docs/test_pages.py",
    "window.md": "docs/test_window_page.py",
    "worlds.md": "docs/test_newcomer_pages.py",
}
"""Pages with commands or programs, and the test that runs them."""
HOURS = ("methods.md", "results.md")
"""Pages whose commands take hours: only their arguments are checked, here."""
BENCHMARK = "python benchmarks/"
EXPERIMENTS = "python -m localization.experiments "
TYPED = ("sh", "python", "c", "nomad", "toml", "ini")
"""Languages of blocks for the reader to type or to save."""
COMMAND = re.compile(r"^(?:\$ )?(?:\w+=\S+ )*(?:nomad|nserver|scripts/|python|pytest|make)\b", re.MULTILINE)
"""A command of this project, in a block of any language."""


def blocks(text: str) -> list[str]:
    """Return the code blocks of a page that are to be typed or that contain a command of this project."""
    found = re.findall(r"^ *```([^\n]*)\n(.*?)^ *```", text, re.MULTILINE | re.DOTALL)
    return [str(block) for kind, block in found if kind in TYPED or COMMAND.search(block)]


def lines(path: Path) -> list[str]:
    return [line for block in blocks(path.read_text(encoding="utf-8")) for line in block.splitlines()]


def test_every_page_with_commands_has_a_test() -> None:
    typed = {path.relative_to(DOCS).as_posix() for path in PAGES if blocks(path.read_text(encoding="utf-8"))}
    # A page with a new command fails here until a test is entered for it.
    assert typed - set(HOURS) == set(TESTS_OF_PAGES)
    assert all((ROOT / "tests" / test).is_file() for test in TESTS_OF_PAGES.values())


def test_commands_are_found_in_any_block() -> None:
    for typed in ("$ scripts/fuzz --list", "nomad state sim:", "NOMAD_ROBOT=sim: ./a\nnserver --version"):
        for kind in ("console", "", "text"):
            assert blocks(f"```{kind}\n{typed}\n```\n") == [f"{typed}\n"]
    # A command of another program, and a word that begins with the name of one.
    assert blocks("```console\n$ ssh lab\n```\n") == blocks("```text\nnomads\n```\n") == []


@pytest.mark.parametrize("command", [
    line for path in PAGES for line in lines(path) if path.name in HOURS or line.startswith(BENCHMARK)
])  # fmt: skip
def test_long_commands_have_valid_arguments(command: str) -> None:
    if command.startswith(BENCHMARK):
        _, script, *words = shlex.split(command)
        # Arguments behind -- are those of the command that the benchmark runs.
        cut = words.index("--") if "--" in words else len(words)
        assert runpy.run_path(str(ROOT / script))["options_parser"]().parse_args(words[:cut])
        if words[cut:]:
            assert script == "benchmarks/calibration.py"
            assert main.whole_parser().parse_args(["calibrate", "sim:", *words[cut + 1 :]])
        return
    if command.startswith("nomad "):
        assert main.whole_parser().parse_args(shlex.split(command)[1:])
        return
    assert command.startswith(EXPERIMENTS)
    kind, *words = shlex.split(command.removeprefix(EXPERIMENTS))
    if kind in ("disturbed", "live", "lost", "plan"):
        experiment = importlib.import_module(f"localization.experiments.{kind}")
        assert experiment._parser().parse_args(words)
    else:
        assert __main__._parser().parse_args([kind, *words]).figures[0] == kind


def test_service_options_are_valid() -> None:
    page = (DOCS / "service.md").read_text(encoding="utf-8")
    found = re.findall(r'NSERVER_OPTIONS="?([^"`\n]+)', page)
    assert len(found) == 2
    for words in found:
        assert nserver_parser().parse_args(shlex.split(words)).robots == 2
