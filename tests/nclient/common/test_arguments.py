"""Error messages of the argument parser for unknown options and choices."""

from __future__ import annotations

import argparse

import pytest

from nclient.common.arguments import Parser


@pytest.fixture
def parser() -> Parser:
    parser = Parser(prog="tool")
    parser.add_argument("file")
    parser.add_argument("--line", choices=("tcp", "serial"))
    parser.add_argument("-v", "--verbose", action="store_true")
    return parser


@pytest.fixture
def grouped() -> Parser:
    parser = Parser(prog="tool")
    verbs = parser.add_subparsers(dest="verb", required=True)
    verbs.add_parser("encode").add_argument("--model")
    return parser


def first_line(reported: str) -> str:
    """Return the error, which is followed by one line with a hint."""
    error, hint = reported.splitlines()
    assert hint.endswith(" --help lists all options")
    return error


def refused(parser: Parser, *words: str, capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit, match="2"):
        parser.parse_args(words)
    return first_line(capsys.readouterr().err)


@pytest.mark.parametrize(("words", "reported"), [
    (["--hlep"], "no option --hlep; did you mean --help?"),
    (["x", "--verbos3"], "no option --verbos3; did you mean --verbose?"),
    (["--lien=tcp", "x"], "no option --lien; did you mean --line?"),
    # No option is near enough for a suggestion.
    (["--zzz"], "no option --zzz"),
    (["--lxxe"], "no option --lxxe"),
    (["x", "-q"], "no option -q"),
    (["x", "y"], "too many arguments: y"),
    (["x", "--line", "seriall"], "argument --line: no 'seriall'; there are tcp, serial; did you mean serial?"),
    ([], "the following arguments are required: file"),
])
def test_what_is_unknown_comes_with_the_nearest(
    words: list[str], reported: str, parser: Parser, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(parser, *words, capsys=capsys).startswith(f"tool: error: {reported}")


@pytest.mark.parametrize("count", ["*", "?"])
def test_what_may_be_left_out_is_not_asked_for(count: str, parser: Parser, capsys: pytest.CaptureFixture[str]) -> None:
    parser.add_argument("others", nargs=count)
    assert refused(parser, capsys=capsys) == "tool: error: the following arguments are required: file"
    assert refused(parser, "--line", "tcp", capsys=capsys).endswith("required: file")
    assert parser.parse_args(["x"]).others in (None, [])


# Abbreviations and the separator work as in argparse.
@pytest.mark.parametrize("words", [["x", "--line", "tcp"], ["--li=tcp", "x"], ["--line", "tcp", "--", "x"]])
def test_what_is_known_is_read_as_ever(words: list[str], parser: Parser) -> None:
    assert parser.parse_args(words) == argparse.Namespace(file="x", line="tcp", verbose=False)


def test_options_may_stand_among_other_words() -> None:
    parser = Parser()
    parser.add_argument("words", nargs="*")
    parser.add_argument("--line")
    assert parser.parse_args(["a", "--line", "tcp", "b"]) == argparse.Namespace(words=["a", "b"], line="tcp")


def test_behind_two_dashes_all_is_a_value(parser: Parser) -> None:
    assert parser.parse_args(["--", "--hlep"]).file == "--hlep"


@pytest.mark.parametrize(("words", "reported"), [
    (["encode", "--modle", "n150"], "tool encode: error: no option --modle; did you mean --model?"),
    (["encoed"], "tool: error: argument verb: no 'encoed'; there are encode; did you mean encode?"),
    (["--modle", "encode"], "tool: error: no option --modle"),
])
def test_subparsers_do_so_too(
    words: list[str], reported: str, grouped: Parser, capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused(grouped, *words, capsys=capsys).startswith(reported)


def test_a_subparser_reads_its_own(grouped: Parser) -> None:
    assert grouped.parse_args(["encode", "--model", "n200"]).model == "n200"
