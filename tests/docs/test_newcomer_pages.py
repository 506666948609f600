"""Pages for newcomers: their commands exist, their worlds are valid, their samples are read."""

from __future__ import annotations

import json
import re
import shlex
import tomllib
from pathlib import Path
from typing import cast

import pytest
from PIL import Image

from nclient.cli.main import GROUP
from nserver_emu.cli import nserver_parser, read_options
from nserver_emu.control.commands import answer_line
from nserver_emu.server.config import read_setups
from nserver_emu.server.daemon import Daemon
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.simulation.simulation import Simulation
from tests.docs.pages import DOCS, ROOT, code_blocks, command_lines, run
from worlds.io import load_world, parse_world, world_names
from worlds.validate import validate_world

COMMANDS = set(
    tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["entry-points"][GROUP]
)


def test_every_command_has_a_purpose_and_every_purpose_a_command() -> None:
    page = (DOCS / "which-command.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\| `?[^|]*`nomad (\w+)", page))
    assert named == COMMANDS
    options = {f"--{option}" for option in re.findall(r"`nserver [^`]*?--([\w-]+)", page)}
    assert options <= {name for action in nserver_parser()._actions for name in action.option_strings}


def test_programs_named_by_the_platforms_page_exist() -> None:
    text = (DOCS / "platforms.md").read_text(encoding="utf-8")
    assert set(re.findall(r"scripts/\w+", text)) == {"scripts/run"}
    for words in re.findall(r"^ *\$ \.venv/bin/nserver (.*)$", text, re.MULTILINE):
        assert read_options(nserver_parser(), shlex.split(words)).real
    assert set(re.findall(r"bin/nomad (\w+)", text)) <= COMMANDS


@pytest.mark.parametrize("page", ["worlds.md", "map-your-room.md"])
def test_world_of_a_page_is_well(page: str) -> None:
    (text,) = code_blocks(page, "toml")
    assert validate_world(parse_world(text, page, "page"), 9.0) == []


def test_room_measured_with_a_tape_can_be_driven_in(tmp_path: Path) -> None:
    (text,) = code_blocks("map-your-room.md", "toml")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "my_room.toml").write_text(text, encoding="utf-8")
    check, localize = command_lines("map-your-room.md")
    assert "no problems" in run(check, tmp_path)
    assert "2 of 2 waypoints reached" in run(localize, tmp_path)


class _Server:
    """The parts of a server that the commands of the page need."""

    def __init__(self, emulator: Emulator) -> None:
        self.emulator = emulator

    def record_change(self, change: object) -> None:
        """Do nothing: there is no recording."""


def test_commands_of_the_worlds_page_run() -> None:
    listing, check, serve, *controls = command_lines("worlds.md")
    assert read_options(nserver_parser(), shlex.split(serve, comments=True)[1:]).world == "two_rooms"
    # The commands are sent to the control interface without a daemon process.
    emulator = Emulator(Simulation(load_world("two_rooms")))
    for line in controls:
        _, _, name, *argument = shlex.split(line, comments=True)
        words = f"{name} {argument.pop()}" if name == "world" else name
        request = json.dumps({"command": words, "argument": "".join(argument) or None}).encode()
        assert json.loads(answer_line(cast(Daemon, _Server(emulator)), request))["ok"]
    # The result of all commands of the page, in their order: two walkers, and a closed door.
    assert (len(emulator.simulation.walkers), emulator.simulation.world.doors[0].is_open) == (2, False)
    assert "several_walls" in run(listing, ROOT)
    assert "no problems" in run(check, ROOT)


def test_samples_of_setup_files_are_read() -> None:
    setup = read_setups([DOCS / "samples" / name for name in ("robot.setup", "world.setup")])
    assert (setup.robot, setup.port) == ("n200", 7019)
    assert setup.unused == ("[laser] calibration", "[laser] offset")


def test_gallery_shows_every_shipped_world() -> None:
    page = (DOCS / "worlds.md").read_text(encoding="utf-8")
    assert set(re.findall(r"figures/worlds/(\w+)\.svg", page)) == set(world_names())


def test_first_screen_shows_a_small_moving_picture() -> None:
    # About the first screen of the page on a code host.
    first_screen = (ROOT / "README.md").read_text(encoding="utf-8")[:1200]
    (picture,) = re.findall(r"!\[[^]]+\]\((\S+\.gif)\)", first_screen)
    assert (ROOT / picture).stat().st_size < 500_000
    with Image.open(ROOT / picture) as image:
        assert getattr(image, "n_frames", 1) > 20
