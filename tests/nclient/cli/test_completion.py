"""`nomad completion`: what the scripts offer, as text; in real shells: tests/integration/shell."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient.cli import main
from nclient.cli.completion import script, words_of_metavars
from nclient.common.arguments import Parser

WORDS: dict[str, tuple[str, ...]] = {"WORLD": ("hall", "room"), "ADDRESS": ("sim:", "nserver://")}


def parser() -> Parser:
    made = Parser(prog="tool")
    made.add_argument("files", nargs="*", metavar="WORLD | FILE", help="a world")
    made.add_argument("--map", metavar="WORLD")
    made.add_argument("--save", type=Path)
    made.add_argument("--model", choices=("n150", "n200"))
    return made


def test_words_files_and_choices() -> None:
    # WORLD | FILE offers world names and files, WORLD names only, a Path option files.
    made = script(parser(), "bash", WORDS)
    assert "_tool_world_file() {\n  compgen -W 'hall room' -- \"$1\"\n  compgen -f -- \"$1\"\n}" in made
    assert "_tool_world() {\n  compgen -W 'hall room' -- \"$1\"\n  \n}" in made
    assert "_shtab_tool___save_COMPGEN=_shtab_compgen_files" in made
    assert "_shtab_tool___model_choices=(n150 n200)" in made


def test_words_in_zsh_and_fish() -> None:
    assert "_tool_world_file() {\n  compadd -- hall room\n  _files\n}" in script(parser(), "zsh", WORDS)
    made = script(parser(), "fish", WORDS)
    assert "function _tool_world_file\n  printf '%s\\n' hall room\n  __fish_complete_path" in made
    assert "function _tool_world\n  printf '%s\\n' hall room\n" in made


def test_options_of_subcommands_have_their_completions() -> None:
    made = Parser(prog="tool")
    made.add_subparsers().add_parser("stop", help="stop it").add_argument("address")
    assert "compadd -- sim: nserver://" in script(made, "zsh", WORDS)
    assert "-eq 0' -a stop" in script(made, "fish", WORDS)


def test_metavars_stand_for_what_is_installed() -> None:
    words = words_of_metavars()
    assert "thesis_room" in words["WORLD"]
    assert {"nserver://localhost:7019/1", "sim:", "sim:thesis_room", "replay:"} <= set(words["ADDRESS"])
    assert words["MODEL"] == ("n150", "n200", "scout")
    assert "get_sn" in words["COMMAND"]
    assert words["CALL"] == words["COMMAND"], "what `nomad wire encode` takes is what `nomad dump --filter` takes"


@pytest.mark.parametrize(("programs", "made"), [([], ["nomad", "nserver"]), (["nserver"], ["nserver"])])
def test_scripts_of_all_programs_or_of_those_named(
    # With no program named, scripts for all programs are written.
    programs: list[str], made: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["completion", "bash", *programs]) == 0
    reported = capsys.readouterr().out
    assert [name for name in ("nomad", "nserver") if f"-F _shtab_{name} {name}\n" in reported] == made


def test_without_a_shell_that_is_asked_for_and_no_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["completion"])
    assert capsys.readouterr().err.splitlines()[0].endswith("error: the following arguments are required: shell")


def test_a_program_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["completion", "bash", "nsever"])
    assert "no program 'nsever'; there are nomad, nserver" in capsys.readouterr().err
