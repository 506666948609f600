"""Keys read by prompt_toolkit from a pipe; a real terminal is in tests/integration/shell."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from prompt_toolkit.application import create_app_session
from prompt_toolkit.buffer import Buffer
from prompt_toolkit.completion import CompleteEvent
from prompt_toolkit.document import Document
from prompt_toolkit.input import create_pipe_input
from prompt_toolkit.output import DummyOutput

from nclient.cli.shell_prompt import CommandCompleter, PromptReader
from nclient.protocol.types import N150, WireState, tcp_wire_state


def wire_state() -> WireState:
    return tcp_wire_state(N150)


@contextmanager
def typed(keys: str, history: Path | None = None) -> Iterator[PromptReader]:
    with create_pipe_input() as pipe, create_app_session(input=pipe, output=DummyOutput()):
        pipe.send_text(keys)
        yield PromptReader(wire_state, lambda: "standing", history)


def test_lines_are_read_and_saved(tmp_path: Path) -> None:
    with typed("pr 240 0 0\rgs\r", tmp_path / "history") as reader:
        assert [reader.read("n150> "), reader.read("n150> ")] == ["pr 240 0 0", "gs"]
        reader.close()
    # prompt_toolkit writes each line with a leading "+".
    assert "+pr 240 0 0" in (tmp_path / "history").read_text()


# 0x03 is Ctrl-C, 0x04 is Ctrl-D.
@pytest.mark.parametrize(("key", "raised"), [("\x03", KeyboardInterrupt), ("\x04", EOFError)])
def test_ctrl_c_and_ctrl_d(key: str, raised: type[BaseException]) -> None:
    with typed(key) as reader, pytest.raises(raised):
        reader.read("n150> ")


@pytest.mark.parametrize(("line", "completed"), [
    ("get_rp", "get_rpx"), ("st; get_rp", "st; get_rpx"), ("help new", "help new_world"), ("st;get_rp", "st;get_rpx"),
])
def test_a_name_takes_the_place_of_what_was_typed_of_it(line: str, completed: str) -> None:
    (one,) = CommandCompleter(wire_state).get_completions(Document(line), CompleteEvent())
    # `start_position` is negative: the completion replaces that many characters before the cursor.
    assert line[: len(line) + one.start_position] + one.text == completed


def test_names_come_with_what_they_are_for() -> None:
    found = list(CommandCompleter(wire_state).get_completions(Document("pr 1 2 3; get_s"), CompleteEvent()))
    assert [(one.text, one.start_position, one.display_meta_text) for one in found] == [
        ("get_sn", -5, "ask for the sonars"), ("get_sg", -5, "ask for the laser's line segments"),
    ]


def test_below_stand_the_usage_of_what_is_typed_and_the_state() -> None:
    with typed("") as reader:
        assert reader._toolbar() == "standing"
        buffer: Buffer = reader._session.default_buffer
        buffer.reset(Document("pr 240"))
        assert reader._toolbar() == "pr translation steering turret\nstanding"
