"""Choice of the line editor, history file, and completion with readline."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from nclient.cli import shell
from nclient.cli.shell import PlainReader, default_history, open_reader
from nclient.cli.shell_prompt import PromptReader
from nclient.protocol.types import N150, WireState, tcp_wire_state


def wire_state() -> WireState:
    return tcp_wire_state(N150)


def test_history_stands_where_the_users_states_do() -> None:
    assert default_history({"XDG_STATE_HOME": "/x"}) == Path("/x/nomad/history")
    assert default_history({}) == Path.home() / ".local" / "state" / "nomad" / "history"


def test_prompt_toolkit_reads_where_it_is_installed(tmp_path: Path) -> None:
    history = tmp_path / "deep" / "history"
    assert isinstance(open_reader(wire_state, lambda: "", history), PromptReader)
    # Readable and writable for its owner alone.
    assert history.stat().st_mode & 0o777 == 0o600


def test_readline_does_where_it_is_not(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    # As if prompt_toolkit were not installed.
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    plain = open_reader(wire_state, lambda: "", tmp_path / "history")
    assert isinstance(plain, PlainReader)


def test_without_readline_it_is_input_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "readline", None)
    monkeypatch.setattr("builtins.input", lambda prompt: f"{prompt}gs")
    plain = PlainReader(wire_state, tmp_path / "history")
    assert plain.read("n150> ") == "n150> gs"
    plain.close()
    assert not (tmp_path / "history").exists()


def test_readline_is_given_one_name_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    readline = pytest.importorskip("readline")
    monkeypatch.setattr(readline, "get_line_buffer", lambda: "help get_s")
    # The cursor stands within the word.
    monkeypatch.setattr(readline, "get_endidx", lambda: 10)
    plain = PlainReader(wire_state, None)
    # readline calls with 0, 1, 2, .. until it gets None.
    assert [plain.complete("get_s", number) for number in range(3)] == ["get_sn", "get_sg", None]
    plain.close()


def test_readline_keeps_the_lines_and_has_them_again(tmp_path: Path) -> None:
    readline = pytest.importorskip("readline")
    history = tmp_path / "history"
    readline.clear_history()
    plain = PlainReader(wire_state, history)
    readline.add_history("pr 240 0 0")
    plain.close()
    readline.clear_history()
    PlainReader(wire_state, history)
    assert readline.get_history_item(1) == "pr 240 0 0"
    readline.clear_history()


def test_no_history_is_wanted(tmp_path: Path) -> None:
    assert isinstance(open_reader(wire_state, lambda: "", None), PromptReader)
    assert not list(tmp_path.iterdir())


def test_libedit_has_its_own_key_binding(monkeypatch: pytest.MonkeyPatch) -> None:
    readline = pytest.importorskip("readline")
    bound: list[str] = []
    # libedit, the readline of macOS, is recognized by its docstring.
    monkeypatch.setattr(readline, "__doc__", "as libedit has it")
    monkeypatch.setattr(readline, "parse_and_bind", bound.append)
    PlainReader(wire_state, None)
    assert bound == ["bind ^I rl_complete"]


def test_unwritable_history_is_reported_and_ignored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    # A file in the place of the directory.
    (tmp_path / "file").write_text("")
    saved = shell._create_history(tmp_path / "file" / "history")
    assert saved is None
    assert "nomad: no history is saved: " in capsys.readouterr().err
