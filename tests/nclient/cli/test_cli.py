"""The command `nomad`: finding subcommands by entry point, tolerating broken ones, exit codes."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path

import pytest

from nclient.cli import main
from nclient.errors import ExtraMissing, StartError, install_command

# Modules for entry points: one that works, one that lacks a dependency, one with an import error, one without a
# docstring.
MODULES = {
    "fine": '"""Does nothing, well.\n\nRules: secret."""\n\n\ndef add_arguments(parser):\n'
    '    parser.add_argument("number", type=int)\n\n\ndef run(options):\n    return options.number\n',
    "extra": '"""Draws something."""\nimport no_such_extra\n',
    "odd": "from sys import no_such_name\n",
    "nameless": "def add_arguments(parser):\n    pass\n\n\ndef run(options):\n    return 0\n",
}
POINTS = {name: f"nomad_test_{name}" for name in MODULES} | {
    "gone": "no_such_package.module", "absent": "no_such_module", "builtin": "sys"
}


@pytest.fixture(autouse=True)
def _commands(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Subcommands of our own, in place of the installed ones."""
    for name, source in MODULES.items():
        (tmp_path / f"nomad_test_{name}.py").write_text(source)
        # A module of an earlier test would hide the file that was just written.
        monkeypatch.delitem(sys.modules, f"nomad_test_{name}", raising=False)
    monkeypatch.syspath_prepend(tmp_path)
    points = [EntryPoint(name, module, main.GROUP) for name, module in POINTS.items()]
    monkeypatch.setattr(main, "entry_points", lambda group: [point for point in points if point.group == group])


def replace_run(monkeypatch: pytest.MonkeyPatch, run: Callable[[argparse.Namespace], int]) -> None:
    monkeypatch.setattr(import_module("nomad_test_fine"), "run", run)


@pytest.mark.parametrize("number", [0, 3])
def test_the_exit_code_is_the_subcommands(number: int) -> None:
    assert main.main(["fine", str(number)]) == number


def test_only_the_named_subcommand_is_imported() -> None:
    main.main(["fine", "0"])
    assert "nomad_test_fine" in sys.modules
    assert "nomad_test_nameless" not in sys.modules


# Help is read from the source text: importing all commands would take seconds, and fail for some.
@pytest.mark.parametrize("arguments", [["--help"], ["-h"], []])
def test_help_lists_all_and_imports_none(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main.main(arguments)
    reported = capsys.readouterr().out
    listed = dict(line.strip().partition("  ")[::2] for line in reported.partition("commands")[2].splitlines()[1:])
    assert sorted(listed) == sorted(POINTS)
    assert listed["fine"].strip() == "Does nothing, well."
    assert listed["extra"].strip() == "Draws something."
    assert listed["nameless"] == listed["builtin"] == listed["absent"] == ""
    assert listed["gone"].strip() == "(not installed whole)"
    assert not any(module.startswith("nomad_test_") for module in sys.modules)


@pytest.mark.parametrize(("words", "option"), [
    (["help"], ["--help"]), (["help", "help"], ["--help"]), (["help", "fine"], ["fine", "--help"]),
])
def test_help_is_a_word_as_well(words: list[str], option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    reported = []
    for arguments in (words, option):
        with pytest.raises(SystemExit, match="0"):
            main.main(arguments)
        reported.append(capsys.readouterr().out)
    assert reported[0] == reported[1]
    assert f"usage: nomad {option[0] if len(option) > 1 else 'COMMAND'}" in reported[0]


def test_help_of_what_is_not_there_says_what_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main(["help", "fien"]) == 2
    assert capsys.readouterr().err == "nomad: no command 'fien'; did you mean fine?\n"


# With the entry points that are really installed.
def test_every_command_has_a_one_line_description(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    for point in entry_points(group=main.GROUP):
        assert re.fullmatch(r"[A-Z][^`()]+\.", main.summary(point)), point.name


def test_help_of_a_subcommand_leaves_its_rules_out(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main.main(["fine", "--help"])
    reported = capsys.readouterr().out
    assert "usage: nomad fine" in reported
    assert "Does nothing, well." in reported
    assert "secret" not in reported
    assert main.main(["nameless"]) == 0


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="0"):
        main.main(["--version"])
    assert capsys.readouterr().out == f"nomad {version('nomad-nserver')}\n"


def test_no_arguments_given_are_those_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["nomad", "fine", "4"])
    assert main.main() == 4


@pytest.mark.parametrize("argument", ["--", "--fast"])
def test_options_alone_are_no_command(argument: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        main.main([argument])
    assert "nomad: error: " in capsys.readouterr().err


@pytest.mark.parametrize(("name", "reported"), [
    ("fien", "no command 'fien'; did you mean fine?"),
    ("hlep", "no command 'hlep'; did you mean help?"),
    ("xyzzy", "no command 'xyzzy'; there are: absent, builtin, extra, fine, gone, nameless, odd"),
    ("extra", f"the command 'extra' needs no_such_extra, which is not installed: {install_command('all')}"),
    ("odd", "the command 'odd' cannot be loaded: cannot import name 'no_such_name'"),
    ("gone", "the command 'gone' needs no_such_package, which is not installed"),
])
def test_subcommands_that_are_not_there(name: str, reported: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main.main([name]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith(f"nomad: {reported}")
    # One line, and no traceback.
    assert printed.err.count("\n") == 1


def test_nomad_error_is_printed_and_exits_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: argparse.Namespace) -> int:
        raise StartError("the start touches wall 3")

    replace_run(monkeypatch, refuse)
    assert main.main(["fine", "0"]) == 1
    assert capsys.readouterr().err == "nomad: the start touches wall 3\n"


def test_missing_extra_exits_with_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(_: argparse.Namespace) -> int:
        raise ExtraMissing("pictures need matplotlib")

    replace_run(monkeypatch, refuse)
    assert main.main(["fine", "0"]) == 2
    assert capsys.readouterr().err == "nomad: pictures need matplotlib\n"


def test_whole_parser_has_commands_that_cannot_be_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [EntryPoint(name, POINTS[name], main.GROUP) for name in ("fine", "extra", "odd", "gone")]
    monkeypatch.setattr(main, "entry_points", lambda group: points if group == main.GROUP else [])
    parser = main.whole_parser()
    assert parser.parse_args(["fine", "3"]).number == 3
    assert parser.parse_args(["extra"]).command == "extra"
    assert parser.parse_args(["help", "odd"]).name == "odd"
    with pytest.raises(SystemExit, match="2"):
        parser.parse_args(["extra", "--option"])


def test_ctrl_c_ends_with_130(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(_: argparse.Namespace) -> int:
        raise KeyboardInterrupt

    replace_run(monkeypatch, interrupt)
    assert main.main(["fine", "0"]) == 130


def test_a_reader_that_goes_away_under_a_captured_stdout(monkeypatch: pytest.MonkeyPatch) -> None:
    def write(_: argparse.Namespace) -> int:
        raise BrokenPipeError

    # stdout is replaced, as by pytest: it has no file descriptor to redirect to /dev/null.
    replace_run(monkeypatch, write)
    monkeypatch.setattr(sys, "stdout", open_ended := _NoFile())
    # 141 = 128 + 13, as a shell shows the death by SIGPIPE.
    assert main.main(["fine", "0"]) == 141
    assert open_ended.asked == 1


class _NoFile:
    """A stdout that is no file of the system."""

    def __init__(self) -> None:
        self.asked = 0

    def fileno(self) -> int:
        self.asked += 1
        raise OSError("no file")


def test_a_reader_that_goes_away_as_processes() -> None:
    command = [sys.executable, "-c", "import sys; from nclient.cli.main import main; sys.exit(main())", "wire", "dump"]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout
        # The reader closes its end before the command writes its first line.
        process.stdout.close()
        process.stdout = None
        _, errors = process.communicate("> 000f0000\n" * 3, timeout=20)
    assert (process.returncode, errors) == (141, "")
