"""Garbage is looked for seldom while the daemon runs, and as before when it is over."""

from __future__ import annotations

import gc

import pytest

from nserver_emu import cli
from nserver_emu.garbage import NEW_OBJECTS, seldom_sought
from nserver_emu.server.daemon import Daemon


def test_what_was_there_is_left_alone_until_the_end() -> None:
    usual = gc.get_threshold()
    with seldom_sought():
        assert gc.get_threshold()[0] == NEW_OBJECTS
        assert gc.get_freeze_count() > 0
    assert gc.get_threshold() == usual
    assert gc.get_freeze_count() == 0


def test_the_daemon_serves_so(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, bool]] = []

    async def serve(*told: object) -> None:
        del told
        seen.append((gc.get_threshold()[0], gc.get_freeze_count() > 0))

    monkeypatch.setattr(Daemon, "serve", serve)
    assert cli.main(["--port", "0"]) == 0
    assert seen == [(NEW_OBJECTS, True)]
