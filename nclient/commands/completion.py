"""Print what makes a shell complete `nomad` and `nserver`: commands, options, choices, addresses, worlds, files.

    eval "$(nomad completion bash)"        in ~/.bashrc; for zsh the same with zsh, in ~/.zshrc after compinit
    nomad completion fish nomad            the script of one program alone

Rules: the scripts are made by shtab (extra `shell`) from the parsers themselves, found by entry point; what an argument
is completed with is read off its metavar. They hold what is installed now: worlds, commands. Made anew, they hold more.
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

from nclient.arguments import Parser
from nclient.exit_codes import ExitCode
from nclient.protocol.commands import BY_NAME
from nclient.protocol.models import MODELS
from nclient.schemes import known_schemes
from nclient.shell.glance import PARTS

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
    addresses = [_BEFORE_A_COLON.get(scheme, (f"{scheme}:",)) for scheme in known_schemes()]
    simulated = [f"sim:{world}" for world in found.get("WORLD", ())]
    return {"PART": tuple(PARTS), "COMMAND": tuple(BY_NAME), "MODEL": tuple(MODELS),
            "ADDRESS": (*(word for words in addresses for word in words), *simulated)} | found  # fmt: skip


def script(parser: Parser, shell: str, words: dict[str, tuple[str, ...]]) -> str:
    """The script for one program."""
    for action in _actions(parser):
        _mark(action, words, parser)
    made = str(shtab.complete(parser, shell=shell))
    if shell == "bash":
        return f"{made}\n\n{_WHOLE_WORDS.substitute(prog=parser.prog)}"
    return _with_all_words(made, alone=parser._subparsers is None) if shell == "zsh" else made


def _with_all_words(made: str, *, alone: bool) -> str:
    """shtab has zsh complete the first of several words alone, and looks for that by its mark `(*)`."""
    made = re.sub(r'^  "\(\*\)::?', '  "*:', made, flags=re.MULTILINE)
    return made.replace("_defaults_added=0", "_defaults_added=1") if alone else made


def _actions(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Every action of a parser and of all below it."""
    for action in parser._actions:
        yield action
        if isinstance(action, argparse._SubParsersAction):
            for below in action.choices.values():
                yield from _actions(below)


def _mark(action: argparse.Action, words: dict[str, tuple[str, ...]], parser: Parser) -> None:
    """Say to shtab what completes an action, where its metavar or type tells."""
    metavar = action.metavar if isinstance(action.metavar, str) else action.dest
    names = ["ADDRESS"] if action.dest == "address" else metavar.split(" | ")
    offered = tuple(word for name in names for word in words.get(name, ()))
    files = action.type is Path or not _FILES.isdisjoint(names)
    if action.choices is None and (offered or files):
        first = {} if action.option_strings else parser.followers
        vars(action)["complete"] = _completer(parser.prog, names, offered, first, files) if offered else shtab.FILE


def _completer(
    prog: str, names: list[str], offered: tuple[str, ...], first: dict[str, tuple[str, ...]], files: bool
) -> dict[str, Any]:
    """A shell function that offers words, files as well, or what follows a first word that is a command of its own."""
    kinds = [re.sub(r"\W", "", word).lower() for word in names]
    name = "_".join(("", prog, *kinds, *(["file"] if files and "file" not in kinds else [])))
    words = " ".join((*offered, *first))
    functions = {}
    for shell, (function, case, paths) in _FUNCTIONS.items():
        cases = "".join(case.format(first=verb, then=" ".join(then)) for verb, then in first.items())
        functions[shell] = function.substitute(name=name, words=words, cases=cases, files=paths if files else ":")
    return {"bash": name, "zsh": name, "fish": f"({name})", "preamble": functions}


_FUNCTIONS = {
    "bash": (Template("""\
$name() {
  case "$${COMP_WORDS[1]}" in
$cases    *) compgen -W "$words" -- "$$1"; $files;;
  esac
}"""), '    {first}) compgen -W "{then}" -- "$1";;\n', 'compgen -f -- "$1"'),
    "zsh": (Template("""\
$name() {
  case "$$words[2]" in
$cases    *) compadd -- $words; $files;;
  esac
}"""), "    {first}) compadd -- {then};;\n", "_files"),
    "fish": (Template("""\
function $name
  printf '%s\\n' $words
  $files
end"""), "", "__fish_complete_path (commandline -ct)"),
}  # fmt: skip
"""By shell: the function, its line for a first word, and how it offers files."""
_WHOLE_WORDS = Template("""\
# bash takes a colon for the end of a word; an address is one word
_${prog}_whole_words() {
  local line="$${COMP_LINE:0:COMP_POINT}" place
  local -a COMP_WORDS
  read -ra COMP_WORDS <<<"$$line"
  [[ "$$line" == *" " ]] && COMP_WORDS+=("")
  local COMP_CWORD=$$(( $${#COMP_WORDS[@]} - 1 ))
  local typed="$${COMP_WORDS[COMP_CWORD]}"
  _shtab_${prog} "$$@"
  if [[ "$$typed" == *:* && "$$COMP_WORDBREAKS" == *:* ]]; then
    for place in "$${!COMPREPLY[@]}"; do COMPREPLY[place]="$${COMPREPLY[place]#"$${typed%:*}:"}"; done
  fi
}
complete -o bashdefault -F _${prog}_whole_words ${prog}""")
