"""Old setup files by their grammar, and their faults by file and line."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nclient.errors import SetupFileError
from nserver_emu.server import config
from nserver_emu.server.config import LegacySetup, parse_setup, read_setups

ROBOT = r"""
; the robot of room 12
[robot]
type = N200   ; with laser
Type = scout  ; keys are case-sensitive: this is another one
[laser]
calibration = 1.5 2 3 4 \
              5 6 7 \   ; the last comes on the next line
              -8e-1
offset = 0 0.25
offset = 10 20
colour = red
"""
WORLD = "[server]\nport=7654\n"


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="latin-1")
    return path


def test_both_files_are_read_for_supported_keys(tmp_path: Path) -> None:
    files = [written(tmp_path, "robot.setup", ROBOT), written(tmp_path, "world.setup", WORLD)]
    assert read_setups(files) == LegacySetup(7654, "n200", (1.5, 2, 3, 4, 5, 6, 7, -0.8), (10, 20))
    assert read_setups([]) == LegacySetup()
    assert read_setups(files).unused == ("[laser] calibration", "[laser] offset")
    assert read_setups(files[1:]).unused == ()


def test_the_later_file_wins(tmp_path: Path) -> None:
    files = [written(tmp_path, name, f"[server]\nport = {port}\n") for name, port in (("a", 1), ("b", 2))]
    assert read_setups(files).port == 2


def test_a_text_at_its_end_may_be_joined_to_nothing() -> None:
    assert parse_setup("[a]\nb = 1 2 \\")["a", "b"].words == ["1", "2"]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[robot\n", r"line 1: expected \[section\]"),
        ("\n[robot]\ntype\n", "line 3: expected key = value"),
        ("= 5\n", "line 1: expected key = value"),
        ("[robot]\ntype = r2d2\n", "line 2: no robot model 'r2d2'"),
        ("[server]\nport = many\n", "line 2: port is a number"),
        ("[server]\nport = 70000\n", "line 2: port is a number"),
        ("[server]\nport = 1 2\n", "line 2: port is a number"),
        ("[laser]\noffset = 1\n", "line 2: offset is 2 numbers"),
        ("[laser]\n\ncalibration = 1 2 3 \\\n 4 5 6 7 x\n", "line 3: calibration is 8 numbers"),
        ("[laser]\noffset = nan 1\n", "line 2: offset is 2 numbers"),
    ],
)
def test_a_fault_is_named_by_file_and_line(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(SetupFileError, match=f"robot.setup, {match}"):
        read_setups([written(tmp_path, "robot.setup", text)])


def test_an_unreadable_file_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SetupFileError, match=r"nothing\.setup: .*be read"):
        read_setups([tmp_path / "nothing.setup"])
    monkeypatch.setattr(config, "MAX_BYTES", 10)
    with pytest.raises(SetupFileError, match="is longer than"):
        read_setups([written(tmp_path, "big.setup", "; 123456789")])


@given(st.text(max_size=200))
@settings(max_examples=200)
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(SetupFileError):
        assert all(key for _, key in parse_setup(text))
