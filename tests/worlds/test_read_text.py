"""Text files of other programs: encodings and the maximum length."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from nclient.errors import WorldFileError
from nserver_emu.simulation.models import load_models
from nserver_emu.simulation.noise import load_setup
from worlds.io import load_world
from worlds.robots import load_calibration
from worlds.schema import MAX_BYTES, read_text

READERS: dict[str, Callable[[Path], object]] = {
    "world": load_world, "setup": load_setup, "models": load_models,
    "calibration": lambda path: load_calibration(path, "n150"),
}  # fmt: skip


def test_maximum_file_length(tmp_path: Path) -> None:
    file = tmp_path / "long.toml"
    file.write_bytes(b"#" * MAX_BYTES)
    assert len(read_text(file)) == MAX_BYTES
    file.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(WorldFileError, match=rf"long\.toml: .*longer than {MAX_BYTES}"):
        read_text(file)


@pytest.mark.parametrize("kind", READERS)
def test_every_reader_of_such_files_stops_there(kind: str, tmp_path: Path) -> None:
    file = tmp_path / "long.toml"
    with file.open("wb") as hole:
        # A sparse file: large, without using the disk.
        hole.truncate(50 * MAX_BYTES)
    with pytest.raises(WorldFileError, match=rf"long\.toml: .*longer than {MAX_BYTES}"):
        READERS[kind](file)


def test_byte_order_mark_is_skipped_and_bad_bytes_are_named(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_bytes(b"\xef\xbb\xbfname = 'x'")
    assert read_text(file) == "name = 'x'"
    # 0xe4 is "ä" in Latin-1, and begins no character in UTF-8 here.
    file.write_bytes(b"name = '\xe4'")
    with pytest.raises(WorldFileError, match=r"x\.toml: .*UTF-8.* 8: "):
        read_text(file)


@pytest.mark.parametrize(("name", "expected"), [("", "Is a directory"), ("none", "No such file"), ("\0", "null byte")])
def test_unreadable_file_is_named(name: str, expected: str, tmp_path: Path) -> None:
    with pytest.raises(WorldFileError, match=f"cannot be read: .*{expected}"):
        read_text(tmp_path / name)


@pytest.mark.parametrize("kind", READERS)
@pytest.mark.parametrize(("text", "expected"), [("x =", "Invalid value"), ("x = " + 5000 * "[", "nested too deeply")])
def test_every_reader_reports_invalid_toml(kind: str, text: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.toml"
    file.write_text(text)
    with pytest.raises(WorldFileError, match=rf"bad\.toml: .*TOML: {expected}"):
        READERS[kind](file)
