"""Garbage is looked for between steps, when there may be much, while the daemon runs; as before when it is over."""

from __future__ import annotations

import asyncio
import gc
import weakref

import pytest
from daemon_house import House, with_daemon

from nserver_emu import cli
from nserver_emu.garbage import LEFT_OBJECTS, NEW_OBJECTS, look_between_steps, seldom_sought
from nserver_emu.server.daemon import Daemon


class Ring:
    """Something that holds itself."""

    def __init__(self) -> None:
        self.whole = self


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


def test_a_look_between_steps_is_for_many_only() -> None:
    with seldom_sought():
        first = weakref.ref(Ring())
        look_between_steps()
        assert first() is not None
        rings = [Ring() for _ in range(LEFT_OBJECTS)]
        rings.clear()
        look_between_steps()
        assert first() is None
        assert gc.get_count()[0] < LEFT_OBJECTS


def test_what_visitors_leave_does_not_pile_up_in_a_daemon() -> None:
    async def visits(house: House) -> None:
        client = await house.call()
        first = weakref.ref(Ring())
        for _ in range(3):
            rings = [Ring() for _ in range(LEFT_OBJECTS)]
            rings.clear()
            await client.ask("gs")
        async with asyncio.timeout(30):
            while first() is not None:
                await asyncio.sleep(0.01)

    with seldom_sought():
        with_daemon(visits)
