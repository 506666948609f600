"""Files that are whole or the old ones: what a link leads to, what is no file, and what a full disk leaves behind."""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

import pytest

from nclient.common.files import write_atomic
from nclient.errors import EstimateFileError


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_write_replaces_the_file_and_leaves_no_other(tmp_path: Path) -> None:
    # More bytes than characters, and more than one buffer.
    long = "é" * 100_000
    for text in ("old", long):
        write_atomic(tmp_path / "file", text, EstimateFileError)
    assert (tmp_path / "file").read_text("utf-8") == long
    assert names(tmp_path) == ["file"]


def test_similar_file_names_are_not_overwritten(tmp_path: Path) -> None:
    # A file of another program with a similar name.
    (tmp_path / "file.part").write_text("mine")
    write_atomic(tmp_path / "file", "new", EstimateFileError)
    assert (tmp_path / "file.part").read_text() == "mine"


def test_leftover_temporary_file_is_overwritten(tmp_path: Path) -> None:
    # The rest of a run that was killed.
    (tmp_path / ".file.saving").write_text("half of")
    write_atomic(tmp_path / "file", "new", EstimateFileError, "saving")
    assert names(tmp_path) == ["file"]


def test_a_link_stays_and_what_it_leads_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    for held in ("there", "not there yet"):
        link, real = tmp_path / f"link to {held}", tmp_path / "disk" / held
        link.symlink_to(real)
        if held == "there":
            real.write_text("old")
        write_atomic(link, "new", EstimateFileError)
        assert link.is_symlink()
        assert real.read_text() == "new"
    assert names(tmp_path / "disk") == ["not there yet", "there"]


def test_what_is_no_file_keeps_its_place(tmp_path: Path) -> None:
    # A FIFO must be written to, and not be replaced by a file.
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    try:
        for name in ("pipe", "link"):
            write_atomic(tmp_path / name, f"to the {name}", EstimateFileError)
            assert os.read(reader, 100) == f"to the {name}".encode()
    finally:
        os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
    assert (tmp_path / "link").is_symlink()
    assert names(tmp_path) == ["link", "pipe"]


def a_full_device(folder: Path) -> Path:
    """One of our own where we may make it: nothing of the system's is lost, should it be replaced after all."""
    try:
        # Major 1, minor 7: the device that is always full. Only root may create it.
        os.mknod(folder / "device", stat.S_IFCHR | 0o666, os.makedev(1, 7))
        (folder / "device").open("w").close()
    except OSError:
        (folder / "device").unlink(missing_ok=True)
        return Path("/dev/full")
    return folder / "device"


@pytest.mark.skipif(sys.platform != "linux", reason="a device that is full is Linux's")
def test_full_device_is_reported_and_not_replaced(tmp_path: Path) -> None:
    device = a_full_device(tmp_path)
    (tmp_path / "link").symlink_to(device)
    with pytest.raises(EstimateFileError, match=r"link: .*No space"):
        write_atomic(tmp_path / "link", "text", EstimateFileError)
    assert (tmp_path / "link").is_symlink()
    assert device.is_char_device()


def test_disk_full_at_the_end_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("old")

    def full(_fd: int) -> None:
        raise OSError(28, "No space left on device")

    # fsync is the last step before the new file replaces the old one.
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(EstimateFileError, match=r"file: .*No space"):
        write_atomic(tmp_path / "file", "new", EstimateFileError)
    assert (tmp_path / "file").read_text() == "old"
    assert names(tmp_path) == ["file"]


@pytest.mark.parametrize("text", ["half a \ud800", "whole"])
def test_whatever_ends_it_leaves_the_old_one_and_no_more(
    text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").write_text("old")

    def interrupted(_fd: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "fsync", interrupted)
    with pytest.raises((EstimateFileError, KeyboardInterrupt)) as ended:
        write_atomic(tmp_path / "file", text, EstimateFileError)
    assert ended.type is (KeyboardInterrupt if text == "whole" else EstimateFileError)
    assert (tmp_path / "file").read_text() == "old"
    assert names(tmp_path) == ["file"]


def test_missing_folder_and_invalid_name_are_reported(tmp_path: Path) -> None:
    with pytest.raises(EstimateFileError, match=r"file: .*No such file"):
        write_atomic(tmp_path / "none" / "file", "text", EstimateFileError)
    with pytest.raises(EstimateFileError, match=r"'.*a\\x00b': .*null byte"):
        write_atomic(tmp_path / "a\0b", "text", EstimateFileError)


def test_file_is_written_where_folders_cannot_be_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Some file systems do not let a folder be opened for fsync.
    def refused(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", refused)
    write_atomic(tmp_path / "file", "new", EstimateFileError)
    assert (tmp_path / "file").read_text() == "new"


def test_a_link_planted_as_temporary_file_is_not_followed(tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.write_text("precious")
    # A link with the name of the temporary file, as an attacker would place it in a shared folder.
    (tmp_path / ".file.saving").symlink_to(other)
    write_atomic(tmp_path / "file", "new", EstimateFileError, "saving")
    assert (tmp_path / "file").read_text() == "new"
    assert not (tmp_path / "file").is_symlink()
    assert other.read_text() == "precious"
