"""Who opened and closed a file: changes are told once, and bystanders make none."""

from __future__ import annotations

import logging
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from nserver_emu.server.pty import Comings

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="inotify is Linux'")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A file that is watched."""
    made = tmp_path / "file"
    made.touch()
    return made


@pytest.fixture
def comings(path: Path) -> Iterator[Comings]:
    made = Comings()
    made.watch(str(path))
    yield made
    made.close()
    made.close()


def opened(path: Path) -> int:
    return os.open(path, os.O_RDWR)


def test_one_who_comes_and_one_who_leaves_are_no_change_and_the_next_one_is(comings: Comings, path: Path) -> None:
    first = opened(path)
    assert not comings.changed()
    os.close(first)
    assert not comings.changed()
    second = opened(path)
    assert comings.changed()
    assert not comings.changed()
    os.close(second)


def test_a_change_that_nobody_looked_at_is_told_later(comings: Comings, path: Path) -> None:
    for _ in range(3):
        os.close(opened(path))
    last = opened(path)
    assert comings.changed()
    assert not comings.changed()
    os.close(last)


def test_a_bystander_changes_nothing_while_another_stays(comings: Comings, path: Path) -> None:
    host = opened(path)
    comings.changed()
    for _ in range(2):
        os.close(opened(path))
        assert not comings.changed()
    os.close(host)
    again = opened(path)
    assert comings.changed()
    os.close(again)


def test_what_is_forgotten_is_not_told(comings: Comings, path: Path) -> None:
    os.close(opened(path))
    comings.forget()
    host = opened(path)
    assert not comings.changed()
    os.close(host)


def test_another_file_is_another_matter(comings: Comings, path: Path) -> None:
    other = path.with_name("other")
    other.touch()
    os.close(opened(path))
    comings.watch(str(other))
    os.close(opened(path))
    host = opened(other)
    assert not comings.changed()
    os.close(host)


def test_notices_that_the_system_lost_count_as_a_change(comings: Comings) -> None:
    reading, writing = os.pipe()
    os.write(writing, struct.pack("iIII", -1, 0x4000, 0, 0))
    comings.close()
    comings.fd = reading
    assert comings.changed()
    os.close(writing)


def test_where_nothing_is_told_nothing_changes(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "darwin")
    comings = Comings()
    comings.watch(str(path))
    for _ in range(2):
        os.close(opened(path))
    assert (comings.changed(), comings.fd) == (False, -1)


def test_a_system_that_gives_no_more_notices_says_so(
    path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    class Full:
        def inotify_init1(self, _flags: int) -> int:
            return -1

    monkeypatch.setattr("ctypes.CDLL", lambda *_, **__: Full())
    with caplog.at_level(logging.WARNING):
        comings = Comings()
    comings.watch(str(path))
    assert not comings.changed()
    assert "max_user_instances" in caplog.text
