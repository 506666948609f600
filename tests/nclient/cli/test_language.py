"""Command language of the shell: lines as typed and as in C, and errors of invalid ones."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nclient.cli.shell_session import Element, ParsedCommand, parse
from nclient.errors import ShellError


@pytest.mark.parametrize(("text", "orders"), [
    ("", ()),
    ("   # all of it a comment", ()),
    (";;", ()),
    ("st", (ParsedCommand("st"),)),
    ("pr 240 -5 0", (ParsedCommand("pr", (240, -5, 0)),)),
    ("pr 240, -5, +0 # forward", (ParsedCommand("pr", (240, -5, 0)),)),
    ("pr(240, 0, 0); ws(1,1,1,20);", (ParsedCommand("pr", (240, 0, 0)), ParsedCommand("ws", (1, 1, 1, 20)))),
    ("st()", (ParsedCommand("st"),)),
    ("conf_sn 15 {0, 2,255}", (ParsedCommand("conf_sn", (15, (0, 2, 255))),)),
    ("conf_sn(15, [0 2])", (ParsedCommand("conf_sn", (15, (0, 2))),)),
    ('tk "a # b; \\"c\\""', (ParsedCommand("tk", ('a # b; "c"',)),)),
    ("tk 'no more' words 2", (ParsedCommand("tk", ("no more", "words", 2)),)),
    ("sleep .5; sleep 1e-1; sleep 2.", tuple(ParsedCommand("sleep", (time_s,)) for time_s in (0.5, 0.1, 2.0))),
    ("State[34]", (Element("State", 34),)),
    ("Smask [ 17 ] = 0; Laser", (Element("Smask", 17, 0), Element("Laser"))),
    ("help 12abc", (ParsedCommand("help", ("12abc",)),)),
])
def test_what_a_line_means(text: str, orders: tuple[ParsedCommand | Element, ...]) -> None:
    assert parse(text) == orders


@pytest.mark.parametrize(("text", "reported"), [
    ("12", "begins with a command, not with '12'"),
    ("(st)", "begins with a command, not with '\\('"),
    ('tk "open', 'a quote that does not end: "open'),
    ("pr(1, 2", r"pr: a call is pr\(1, 2, 3\)"),
    ("pr(1, (2), 3)", "one pair of parentheses"),
    ("pr 1 = 2", "pr: '=' does not belong there"),
    ("conf_sn 15 {0, x}", "conf_sn: a list holds numbers, not 'x'"),
    ("conf_sn 15 {0, 2", "the list does not end; } is missing"),
    ("conf_sn 15 {0, 2]", "']' does not belong there"),
    ("conf_sn 15 0}", "'}' does not belong there"),
    ("State 34", r"State: it is written State or State\[0\]"),
    (f"State[{'9' * 5000}]", r"it is written State or State\[0\]"),
    (f"Smask[1] = {'1' * 5000}", r"it is written Smask\[17\] = 0"),
    ("State[34] = 1", r"it is written State or State\[0\]"),
    ("Smask[-1] = 1", r"Smask: it is written Smask\[17\] = 0"),
    ("Smask[1.5]", "Smask: it is written"),
    ("Smask[1] = -1", "Smask: it is written"),
])
def test_unreadable_lines_are_reported(text: str, reported: str) -> None:
    with pytest.raises(ShellError, match=reported):
        parse(text)


@given(st.text(max_size=60))
def test_any_text_parses_or_raises_shell_error(text: str) -> None:
    try:
        found = parse(text)
    except ShellError:
        return
    assert all(isinstance(command, ParsedCommand | Element) for command in found)


@given(st.lists(st.integers(-(2**31), 2**31 - 1), max_size=8))
def test_whole_numbers_come_as_they_were_written(numbers: list[int]) -> None:
    written = ", ".join(map(str, numbers))
    assert parse(f"add_obstacle({written})") == parse(f"add_obstacle {written}") == (
        ParsedCommand("add_obstacle", tuple(numbers)),
    )
