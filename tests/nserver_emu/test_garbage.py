"""Garbage is looked for between steps, now and then, while the daemon runs; as before when it is over."""

from __future__ import annotations

import asyncio
import ctypes
import gc
import sys
import weakref
from pathlib import Path

import pytest

from nserver_emu import cli, garbage
from nserver_emu.garbage import FEW_OBJECTS, NEW_OBJECTS, SHARE, TIDY_S, Tidying, seldom_sought
from nserver_emu.server.daemon import Daemon
from tests.nserver_emu.server.daemon_house import House, with_daemon


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


class Clock:
    """Shows what it is set to, and a look's time later each time that it is looked at."""

    def __init__(self, look_s: float = 0.0) -> None:
        self.now_s, self._look_s = 100.0, look_s

    def __call__(self) -> float:
        self.now_s += self._look_s
        return self.now_s


def test_it_is_tidied_now_and_then_where_somebody_was() -> None:
    clock = Clock()
    with seldom_sought():
        tidying, first = Tidying(clock), weakref.ref(Ring())
        leave(2 * FEW_OBJECTS)
        clock.now_s += 0.9 * TIDY_S
        tidying.tidy()
        assert first() is not None
        clock.now_s += 0.2 * TIDY_S
        tidying.tidy()
        assert first() is None
        second = weakref.ref(Ring())
        clock.now_s += 2.0 * TIDY_S
        tidying.tidy()
        assert second() is not None
        leave(2 * FEW_OBJECTS)
        tidying.tidy()
        assert second() is None


def test_it_takes_a_hundredth_of_the_time_at_most() -> None:
    clock, took_s = Clock(look_s=1.0), 1.0
    with seldom_sought():
        tidying = Tidying(clock)
        clock.now_s += TIDY_S
        leave(2 * FEW_OBJECTS)
        tidying.tidy()
        first = weakref.ref(Ring())
        leave(2 * FEW_OBJECTS)
        clock.now_s += 0.9 * SHARE * took_s
        tidying.tidy()
        assert first() is not None
        clock.now_s += 0.2 * SHARE * took_s
        tidying.tidy()
        assert first() is None


def leave(rings: int) -> None:
    """Garbage that only a look finds."""
    left = [Ring() for _ in range(rings)]
    left.clear()


def test_what_visitors_leave_does_not_pile_up_in_a_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garbage, "TIDY_S", 0.01)

    async def visits(house: House) -> None:
        client = await house.call()
        first = weakref.ref(Ring())
        leave(2 * FEW_OBJECTS)
        await client.ask("gs")
        async with asyncio.timeout(30):
            while first() is not None:
                await asyncio.sleep(0.01)

    with seldom_sought():
        with_daemon(visits)


@pytest.mark.parametrize("system", ["win32", "linux"])
def test_a_system_without_malloc_trim(system: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", system)
    monkeypatch.setattr(ctypes, "CDLL", lambda _: object())
    monkeypatch.setattr(garbage, "_trim", garbage._malloc_trim())
    assert garbage._trim is None
    garbage.give_back()


@pytest.mark.skipif(garbage._trim is None, reason="no glibc")
def test_what_is_free_goes_back_to_the_system() -> None:
    def resident_kib() -> int:
        rows = Path("/proc/self/status").read_text().splitlines()
        return int(next(row for row in rows if row.startswith("VmRSS")).split()[1])

    pieces = [bytes(50_000) for _ in range(1000)]
    held = pieces[::2]
    pieces.clear()
    before_kib = resident_kib()
    garbage.give_back()
    assert resident_kib() < before_kib - 15_000, "of the holes between those that are held, 25 MB"
    assert len(held) == 500
