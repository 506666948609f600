"""The file of --save: now and then, never an older state over a newer one, and a disk that refuses."""

from __future__ import annotations

import asyncio
import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from nclient.errors import SnapshotError
from nserver_emu.cli import nserver_parser, read_options
from nserver_emu.control import snapshot
from nserver_emu.control.recording import SaveFile, autosaved
from nserver_emu.server.handlers.table import Emulator
from tests.nserver_emu.server.wire_client import simulation


def saved_s(path: Path) -> float:
    """The clock of the simulation in a file."""
    emulator = Emulator(simulation())
    snapshot.restore(emulator, path)
    return emulator.simulation.time_s


async def until(there: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not there():
            await asyncio.sleep(0.005)


async def test_saves_at_intervals_while_open(tmp_path: Path) -> None:
    emulator, path = Emulator(simulation()), tmp_path / "saved.json"
    async with autosaved(SaveFile(emulator, path), 0.01):
        await until(path.exists)
        emulator.pass_time(3.0)
        await until(lambda: saved_s(path) == 3.0)
    path.unlink()
    async with autosaved(None, None), autosaved(SaveFile(emulator, path), None):
        await asyncio.sleep(0.05)
    assert list(tmp_path.iterdir()) == []


async def test_a_slow_older_save_does_not_replace_a_newer_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    emulator, path, gate = Emulator(simulation()), tmp_path / "saved.json", asyncio.Event()

    # The save in a thread has serialized the state already, and is delayed before it writes.
    async def late(write: Callable[..., None], *args: Any) -> None:
        await gate.wait()
        write(*args)

    monkeypatch.setattr(asyncio, "to_thread", late)
    file = SaveFile(emulator, path)
    saving = asyncio.create_task(file.save_in_thread())
    # The older save reaches the gate; meanwhile a newer one is written at once.
    await asyncio.sleep(0)
    emulator.pass_time(2.0)
    file.save()
    gate.set()
    await saving
    assert saved_s(path) == 2.0


async def test_a_failing_save_is_logged_once_and_its_recovery(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "folder" / "saved.json"
    file = SaveFile(Emulator(simulation()), path)
    with caplog.at_level(logging.WARNING):
        # Three failures are one log entry; the first success after them is another.
        for _ in range(3):
            await file.save_in_thread()
        path.parent.mkdir()
        for _ in range(2):
            await file.save_in_thread()
    assert [record.getMessage() for record in caplog.records] == [
        f"not saved: {path}: cannot be written: No such file or directory; name a file in a folder that is there and "
        "may be written to; the run goes on, and it is tried again each time",
        f"{path}: saved again",
    ]
    assert json.loads(path.read_text())["format"] == snapshot.FORMAT


# Opening a pipe without reader would block.
@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/null")])
async def test_a_pipe_or_a_device_is_not_written(
    tmp_path: Path, make: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "other"
    make(path)
    file = SaveFile(Emulator(simulation()), path)
    with pytest.raises(SnapshotError, match="regular"):
        file.save()
    await asyncio.wait_for(file.save_in_thread(), 30)
    assert "regular" in caplog.text
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(("words", "message"), [
    (["--autosave", "60"], "--autosave needs a file: add --save FILE"),
    (["--save", "x", "--autosave", "0.5"], "seconds from 1 to 86400, not '0.5'"),
    (["--save", "x", "--autosave", "nan"], "not 'nan'"),
    (["--save", "x", "--autosave", "often"], "not 'often'"),
])
def test_wrong_usage(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        read_options(nserver_parser(), words)
    assert message in capsys.readouterr().err


def test_right_usage() -> None:
    for words in ([], ["--save", "x"], ["--save", "x", "--autosave", "1"]):
        assert read_options(nserver_parser(), words).autosave in (None, 1.0)
