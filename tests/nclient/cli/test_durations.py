"""Seconds as people type them."""

from __future__ import annotations

import argparse

import pytest

from nclient.cli import main
from nclient.common.arguments import seconds


@pytest.mark.parametrize(("text", "value"), [("0", 0), ("2.5", 2.5), ("1e3", 1000)])
def test_times(text: str, value: float) -> None:
    assert seconds(text) == value


@pytest.mark.parametrize("text", ["inf", "nan", "-1", "-0.1", "soon", ""])
def test_no_times(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(argparse.ArgumentTypeError, match="number of seconds"):
        seconds(text)
    for command, option in (("stop", "--patience"), ("doctor", "--interval")):
        with pytest.raises(SystemExit, match="2"):
            main.main([command, "sim:thesis_room", f"{option}={text}"])
        assert "a number of seconds, 0 or more" in capsys.readouterr().err
