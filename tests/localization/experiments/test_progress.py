"""The progress bar, drawn on terminals only."""

from __future__ import annotations

import sys

import pytest

from localization.experiments.execution import progress


def test_a_bar_fills_up_and_never_over(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    with progress(4, "work", "parts") as tally:
        tally(1)
        tally(9)
    output = capsys.readouterr().err
    assert "work: 100%" in output
    assert "4.00/4.00" in output


def test_nothing_is_drawn_into_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    with progress(4, "work", "parts") as tally:
        tally(4)
    assert capsys.readouterr().err == ""


def test_without_tqdm_nothing_is_drawn(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tqdm", None)
    with progress(4, "work", "parts") as tally:
        tally(4)
    assert capsys.readouterr().err == ""
