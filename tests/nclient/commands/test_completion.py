"""`nomad completion`: what the scripts offer, as text; in real shells: tests/integration/shell."""

from __future__ import annotations

from pathlib import Path

import pytest

from nclient import cli
from nclient.arguments import Parser
from nclient.commands.completion import script, words_of_metavars

WORDS: dict[str, tuple[str, ...]] = {"WORLD": ("hall", "room"), "ADDRESS": ("sim:", "nserver://")}


def parser() -> Parser:
    made = Parser(prog="tool")
    made.add_argument("files", nargs="*", metavar="WORLD | FILE", help="a world")
    made.add_argument("--map", metavar="WORLD")
    made.add_argument("--save", type=Path)
    made.add_argument("--model", choices=("n150", "n200"))
    made.followers["ctl"] = ("pause", "resume")
    return made


def test_words_files_choices_and_what_follows_a_first_word() -> None:
    made = script(parser(), "bash", WORDS)
    assert '    ctl) compgen -W "pause resume" -- "$1";;' in made
    assert '*) compgen -W "hall room ctl" -- "$1"; compgen -f -- "$1";;' in made
    assert '*) compgen -W "hall room" -- "$1"; :;;' in made
    assert "_shtab_tool___save_COMPGEN=_shtab_compgen_files" in made
    assert "_shtab_tool___model_choices=(n150 n200)" in made
    assert made.endswith("complete -o bashdefault -F _tool_whole_words tool")


def test_zsh_completes_every_word_and_not_the_first_alone() -> None:
    made = script(parser(), "zsh", WORDS)
    assert '\n  "*:a world:_tool_world_file"' in made
    assert "ctl) compadd -- pause resume;;" in made
    assert "_shtab_tool_defaults_added=1" in made


def test_a_program_of_subcommands_keeps_what_shtab_does_for_them() -> None:
    made = Parser(prog="tool")
    made.add_subparsers().add_parser("stop", help="stop it").add_argument("address")
    assert "_shtab_tool_defaults_added=0" in script(made, "zsh", WORDS)
    assert "compadd -- sim: nserver://" in script(made, "zsh", WORDS)


def test_fish_has_functions_of_its_own() -> None:
    made = script(parser(), "fish", WORDS)
    assert "function _tool_world_file\n  printf '%s\\n' hall room ctl\n  __fish_complete_path" in made
    assert "function _tool_world\n  printf '%s\\n' hall room\n  :\nend" in made


def test_metavars_stand_for_what_is_installed() -> None:
    words = words_of_metavars()
    assert "thesis_room" in words["WORLD"]
    assert {"nserver://localhost:7019/1", "sim:", "sim:thesis_room", "replay:"} <= set(words["ADDRESS"])
    assert words["MODEL"] == ("n150", "n200", "scout")
    assert "get_sn" in words["COMMAND"]


@pytest.mark.parametrize(("programs", "made"), [([], ["nomad", "nserver"]), (["nserver"], ["nserver"])])
def test_scripts_of_all_programs_or_of_those_named(
    programs: list[str], made: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["completion", "bash", *programs]) == 0
    told = capsys.readouterr().out
    assert [name for name in ("nomad", "nserver") if f"_{name}_whole_words {name}\n" in told] == made


def test_a_program_that_there_is_not(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(["completion", "bash", "nsever"])
    assert "no program 'nsever'; there are nomad, nserver" in capsys.readouterr().err
