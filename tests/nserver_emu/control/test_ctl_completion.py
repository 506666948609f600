"""Completion of `nserver ctl` offers nothing that ctl would refuse."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

import pytest

from nclient.common.arguments import Parser
from nserver_emu import cli
from nserver_emu.control import cli as ctl
from nserver_emu.control import cli as ctl_completion
from nserver_emu.control.commands import BY_NAME
from worlds.io import world_names


def tree() -> Parser:
    parser = Parser(prog="ctl")
    ctl_completion.add_commands(parser)
    return parser


def commands_below(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    return {name: command for action in below for name, command in action.choices.items()}


def leaves(parser: argparse.ArgumentParser, before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name, command in commands_below(parser).items():
        if commands_below(command):
            yield from leaves(command, (*before, name))
        else:
            yield (*before, name)


def test_every_command_of_the_table_and_no_other() -> None:
    assert sorted(" ".join(words) for words in leaves(tree())) == sorted(BY_NAME)


@pytest.mark.parametrize("words", list(leaves(tree())), ids=" ".join)
def test_options_are_ctls_at_every_word(words: tuple[str, ...]) -> None:
    wanted = {option for action in ctl._parser()._actions for option in action.option_strings}
    parser: argparse.ArgumentParser = tree()
    for word in words:
        parser = commands_below(parser)[word]
        assert {option for action in parser._actions for option in action.option_strings} == wanted


@pytest.mark.parametrize(("words", "argument"), [
    (["faults", "set", "p.toml"], Path("p.toml")), (["world", "set", "thesis_room"], Path("thesis_room")),
    (["save", "x"], Path("x")), (["speed", "max"], "max"), (["stop", "2"], "2"),
    (["noise", "sensors=measured", "motion=worn"], ["sensors=measured", "motion=worn"]),
])  # fmt: skip
def test_what_a_command_takes(words: list[str], argument: object) -> None:
    assert tree().parse_args(words).argument == argument


def test_it_is_a_first_word_of_the_program() -> None:
    assert sorted(commands_below(cli.whole_parser())) == sorted(["ctl", "help", *world_names()])
    assert list(commands_below(commands_below(cli.whole_parser())["ctl"])) == list(commands_below(tree()))
