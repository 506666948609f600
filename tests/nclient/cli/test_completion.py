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


def with_first_words() -> Parser:
    """The same, where a first word may be a command of its own: one with commands below it, one without."""
    made = parser()
    first = made.add_subparsers()
    first.add_parser("ctl", help="say").add_subparsers().add_parser("pause", help="stand")
    first.add_parser("help", help="tell", add_help=False)
    return made


def test_words_files_and_choices() -> None:
    made = script(parser(), "bash", WORDS)
    assert '_tool_world_file() {\n  compgen -W "hall room" -- "$1"\n  compgen -f -- "$1"\n}' in made
    assert '_tool_world() {\n  compgen -W "hall room" -- "$1"\n  :\n}' in made
    assert "_shtab_tool___save_COMPGEN=_shtab_compgen_files" in made
    assert "_shtab_tool___model_choices=(n150 n200)" in made
    assert made.endswith("complete -o bashdefault -F _tool_whole_words tool")


def test_subcommands_complete_as_first_word_only() -> None:
    bash = script(with_first_words(), "bash", WORDS)
    assert '\n  (( COMP_CWORD > 1 )) || compgen -W "ctl help" -- "$1"\n' in bash
    assert "_shtab_tool_ctl_subparsers=(pause)" in bash
    zsh = script(with_first_words(), "zsh", WORDS)
    assert "\n  (( CURRENT > 2 )) || compadd -- ctl help\n" in zsh
    assert "\n      ctl) shift words; (( CURRENT -= 1 )); _shtab_tool_ctl; return;;\n" in zsh
    assert "help) shift words; (( CURRENT -= 1 )); _arguments -C -s $_shtab_tool_help_options; return;;" in zsh
    assert "_shtab_tool_defaults_added=1" in zsh
    assert "_shtab_tool_ctl_defaults_added=0" in zsh
    fish = script(with_first_words(), "fish", WORDS)
    assert "-ge 0; and test (count (commandline -opc)) -eq 1' -a ctl" in fish
    assert "function _tool_world_file_first\n  printf '%s\\n' hall room\n  __fish_complete_path" in fish


def test_zsh_completes_every_word_and_not_the_first_alone() -> None:
    made = script(parser(), "zsh", WORDS)
    assert '\n  "*:a world:_tool_world_file"' in made
    assert "shift words" not in made
    assert "_shtab_tool_defaults_added=1" in made


def test_a_program_of_subcommands_keeps_what_shtab_does_for_them() -> None:
    made = Parser(prog="tool")
    made.add_subparsers().add_parser("stop", help="stop it").add_argument("address")
    zsh = script(made, "zsh", WORDS)
    assert "_shtab_tool_defaults_added=0" in zsh
    assert "shift words" not in zsh
    assert "compadd -- sim: nserver://" in zsh
    assert "-eq 0' -a stop" in script(made, "fish", WORDS)


def test_fish_has_functions_of_its_own() -> None:
    made = script(parser(), "fish", WORDS)
    assert "function _tool_world_file\n  printf '%s\\n' hall room\n  __fish_complete_path" in made
    assert "function _tool_world\n  printf '%s\\n' hall room\n  :\nend" in made


def test_metavars_stand_for_what_is_installed() -> None:
    words = words_of_metavars()
    assert "thesis_room" in words["WORLD"]
    assert {"nserver://localhost:7019/1", "sim:", "sim:thesis_room", "replay:"} <= set(words["ADDRESS"])
    assert words["MODEL"] == ("n150", "n200", "scout")
    assert "get_sn" in words["COMMAND"]
    assert words["call"] == words["COMMAND"], "what `nomad wire encode` takes is what `nomad dump --filter` takes"


@pytest.mark.parametrize(("programs", "made"), [([], ["nomad", "nserver"]), (["nserver"], ["nserver"])])
def test_scripts_of_all_programs_or_of_those_named(
    programs: list[str], made: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main.main(["completion", "bash", *programs]) == 0
    reported = capsys.readouterr().out
    assert [name for name in ("nomad", "nserver") if f"_{name}_whole_words {name}\n" in reported] == made


def test_without_a_shell_that_is_asked_for_and_no_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["completion"])
    assert capsys.readouterr().err.endswith("error: the following arguments are required: shell\n")


def test_a_program_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main(["completion", "bash", "nsever"])
    assert "no program 'nsever'; there are nomad, nserver" in capsys.readouterr().err
