"""Print what makes a shell complete nomad and nserver: commands, options, choices, addresses, worlds, files.

    eval "$(nomad completion bash)"        in ~/.bashrc; for zsh the same with zsh, in ~/.zshrc after compinit
    nomad completion fish nomad            the script of one program alone

Rules: the scripts are made by shtab (extra `shell`) from the parsers themselves, found by entry point; what an argument
is completed with is read off its metavar. They hold what is installed now: worlds, commands. Made anew, they hold more.
What a program takes instead of its own words is a subparser (`nserver ctl`), and is offered as the first word alone.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterator
from importlib.metadata import entry_points
from pathlib import Path
from string import Template
from typing import Any

import shtab

from nclient.cli.state_text import PARTS
from nclient.common.arguments import Parser
from nclient.common.exit_codes import ExitCode
from nclient.protocol.commands import BY_NAME
from nclient.protocol.types import MODELS
from nclient.url import available_schemes

PROGRAMS, WORDS = "nomad.programs", "nomad.words"
"""Entry points: a program's whole parser by its name; the words that a metavar stands for."""
_FILES = frozenset({"FILE", "FILE.toml", "SETUP", "PATH", "PNG", "file"})
_BEFORE_A_COLON = {"nserver": ("nserver://localhost:7019/1",), "serial": ("serial:///dev/ttyUSB0",),
                   "robotd": ("robotd://",)}  # fmt: skip


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """A shell, and programs."""
    parser.add_argument("shell", choices=("bash", "zsh", "fish"), help="whose script")
    parser.add_argument("programs", nargs="*", metavar="PROGRAM", help="nomad, nserver (default: both)")


def run(options: argparse.Namespace) -> int:
    """Print the scripts; the exit code."""
    programs = {point.name: point for point in entry_points(group=PROGRAMS)}
    for name in options.programs or sorted(programs):
        if name not in programs:
            Parser(prog="nomad completion").error(f"no program {name!r}; there are {', '.join(sorted(programs))}")
        whole: Callable[[], Parser] = programs[name].load()
        print(script(whole(), options.shell, words_of_metavars()))
    return ExitCode.DONE


def words_of_metavars() -> dict[str, tuple[str, ...]]:
    """What stands for itself where a metavar names it, such as WORLD: the worlds that are shipped."""
    found = {point.name: tuple(point.load()()) for point in entry_points(group=WORDS)}
    addresses = [_BEFORE_A_COLON.get(scheme, (f"{scheme}:",)) for scheme in available_schemes()]
    simulated = [f"sim:{world}" for world in found.get("WORLD", ())]
    return {"PART": tuple(PARTS), "COMMAND": tuple(BY_NAME), "call": tuple(BY_NAME), "MODEL": tuple(MODELS),
            "ADDRESS": (*(word for words in addresses for word in words), *simulated)} | found  # fmt: skip


def script(parser: Parser, shell: str, words: dict[str, tuple[str, ...]]) -> str:
    """The script for one program."""
    firsts = _firsts(parser)
    for action in _actions(parser):
        own = action in parser._actions and not action.option_strings
        _mark(action, words, parser.prog, firsts if own else ())
    made = str(shtab.complete(parser, shell=shell))
    match shell:
        case "bash":
            return f"{made}\n\n{_WHOLE_WORDS.substitute(prog=parser.prog)}"
        case "zsh":
            return _with_all_words(made, parser.prog, firsts, alone=parser._subparsers is None)
        case _:
            return re.sub(r"-ge 0(' -a )", rf"-ge 0; {_FISH_FIRST}\1", made)


def _firsts(parser: Parser) -> tuple[str, ...]:
    """The first words that are commands of their own, of a program that takes other words as well."""
    words = [action for action in parser._actions if not action.option_strings]
    commands = [action for action in words if isinstance(action, argparse._SubParsersAction)]
    return tuple(name for action in commands for name in action.choices) if len(words) > len(commands) else ()


def _with_all_words(made: str, prog: str, firsts: tuple[str, ...], *, alone: bool) -> str:
    """shtab has zsh complete the first of several words alone, and looks for that by its mark `(*)`; and it has either
    words or subcommands."""
    made = re.sub(r'^  "\(\*\)::?', '  "*:', made, flags=re.MULTILINE)
    if alone or firsts:
        made = made.replace(f"_shtab_{prog}_defaults_added=0", f"_shtab_{prog}_defaults_added=1")
    begin = f"_shtab_{prog}() {{\n"
    cases = "".join(_zsh_case(made, f"_shtab_{prog}_{first}", first) for first in firsts)
    return made.replace(begin, f"{begin}{_FIRST_WORD.substitute(cases=cases)}", 1) if firsts else made


def _zsh_case(made: str, name: str, first: str) -> str:
    """shtab writes a function for a subcommand that has subcommands, and an array of options for one that has none."""
    does = name if f"\n{name}() {{\n" in made else f"_arguments -C -s ${name}_options"
    return f"      {first}) shift words; (( CURRENT -= 1 )); {does}; return;;\n"


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every action of a parser and of all below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)


def _mark(action: argparse.Action, words: dict[str, tuple[str, ...]], prog: str, firsts: tuple[str, ...]) -> None:
    """Say to shtab what completes an action, where its metavar or type tells; `firsts`: words for the first place."""
    metavar = action.metavar if isinstance(action.metavar, str) else action.dest
    names = ["ADDRESS"] if action.dest == "address" else metavar.split(" | ")
    offered = tuple(word for name in names for word in words.get(name, ()))
    files = action.type is Path or not _FILES.isdisjoint(names)
    if action.choices is None and (offered or files):
        vars(action)["complete"] = _completer(prog, names, offered, firsts, files) if offered else shtab.FILE


def _completer(
    prog: str, names: list[str], offered: tuple[str, ...], firsts: tuple[str, ...], files: bool
) -> dict[str, Any]:
    """A shell function that offers words, others in the first place, and files as well."""
    kinds = [re.sub(r"\W", "", word).lower() for word in names]
    kinds += [*(["file"] if files and "file" not in kinds else []), *(["first"] if firsts else [])]
    name = "_".join(("", prog, *kinds))
    functions = {}
    for shell, (function, first, paths) in _FUNCTIONS.items():
        more = [first.format(words=" ".join(firsts))] if firsts and first else []
        lines = "\n  ".join([*more, *([paths] if files else [])]) or ":"
        functions[shell] = function.substitute(name=name, words=" ".join(offered), more=lines)
    return {"bash": name, "zsh": name, "fish": f"({name})", "preamble": functions}


_FUNCTIONS = {
    "bash": (Template("""\
$name() {
  compgen -W "$words" -- "$$1"
  $more
}"""), '(( COMP_CWORD > 1 )) || compgen -W "{words}" -- "$1"', 'compgen -f -- "$1"'),
    "zsh": (Template("""\
$name() {
  compadd -- $words
  $more
}"""), "(( CURRENT > 2 )) || compadd -- {words}", "_files"),
    "fish": (Template("""\
function $name
  printf '%s\\n' $words
  $more
end"""), "", "__fish_complete_path (commandline -ct)"),
}  # fmt: skip
"""By shell: the function, how it offers words for the first place (fish does by itself), and how files."""
_FISH_FIRST = "and test (count (commandline -opc)) -eq 1"
"""Beside other words shtab has fish offer a subcommand in every place."""
_FIRST_WORD = Template("""\
  if (( CURRENT > 2 )); then
    case "$$words[2]" in
$cases    esac
  fi
""")
"""The beginning of zsh's function for a program, where a first word is a command of its own."""
_WHOLE_WORDS = Template("""\
# bash takes a colon and a = for the end of a word; an address is one word, and so is KEY=VALUE
_${prog}_whole_words() {
  local line="$${COMP_LINE:0:COMP_POINT}" place breaks="$${COMP_WORDBREAKS//[^:=]/}"
  local -a COMP_WORDS
  read -ra COMP_WORDS <<<"$$line"
  [[ "$$line" == *" " ]] && COMP_WORDS+=("")
  local COMP_CWORD=$$(( $${#COMP_WORDS[@]} - 1 ))
  local typed="$${COMP_WORDS[COMP_CWORD]}"
  _shtab_${prog} "$$@"
  local last="$${typed##*["$$breaks"]}"
  if [[ -n "$$breaks" && "$$last" != "$$typed" ]]; then
    for place in "$${!COMPREPLY[@]}"; do COMPREPLY[place]="$${COMPREPLY[place]#"$${typed%"$$last"}"}"; done
  fi
}
complete -o bashdefault -F _${prog}_whole_words ${prog}""")
