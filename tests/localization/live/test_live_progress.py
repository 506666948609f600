"""Seconds of work shown on a terminal."""

from __future__ import annotations

import io

import pytest

from nclient.common import process


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_seconds_are_shown_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(process, "PROGRESS_S", 0.001)
    with process.show_seconds("compiling"):
        while not terminal.getvalue():
            pass
    assert terminal.getvalue().startswith("\rcompiling: 0 s")
    assert terminal.getvalue().endswith("s\n")


def test_short_work_and_pipes_show_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    for stderr in (Terminal(), io.StringIO()):
        monkeypatch.setattr("sys.stderr", stderr)
        with process.show_seconds("compiling"):
            pass
        assert not stderr.getvalue()
