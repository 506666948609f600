"""Garbage is collected between steps while the daemon runs, and as usual afterwards."""

from __future__ import annotations

import asyncio
import gc
import weakref
from collections.abc import Iterator

import pytest

from nserver_emu import cli
from nserver_emu.server import daemon as garbage
from nserver_emu.server.daemon import (
    GC_THRESHOLD,
    MIN_INTERVAL_RATIO,
    MIN_INTERVAL_S,
    MIN_OBJECTS,
    Daemon,
    GarbageCollector,
    rare_collection,
)
from tests.nserver_emu.server.running_server import running_server


@pytest.fixture
def unfrozen() -> Iterator[None]:
    """Exempt nothing, as in a program of its own; later the objects of all tests again."""
    gc.unfreeze()
    yield
    gc.freeze()


class Ring:
    """An object in a reference cycle."""

    def __init__(self) -> None:
        # Reference counting never frees it; a weak reference shows when the collector has.
        self.whole = self


@pytest.mark.usefixtures("unfrozen")
def test_present_objects_are_exempt_within_the_block() -> None:
    usual = gc.get_threshold()
    with rare_collection():
        # Frozen objects are not examined by the collector.
        assert gc.get_threshold()[0] == GC_THRESHOLD
        assert gc.get_freeze_count() > 0
    assert gc.get_threshold() == usual
    assert gc.get_freeze_count() == 0


@pytest.mark.usefixtures("unfrozen")
def test_objects_exempt_before_stay_exempt() -> None:
    gc.freeze()
    count = gc.get_freeze_count()
    with rare_collection():
        assert gc.get_freeze_count() == count
        assert gc.get_threshold()[0] == GC_THRESHOLD
    assert gc.get_freeze_count() == count


def test_the_daemon_serves_with_rare_collection(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[int, bool]] = []

    async def serve(*_args: object) -> None:
        seen.append((gc.get_threshold()[0], gc.get_freeze_count() > 0))

    monkeypatch.setattr(Daemon, "serve", serve)
    assert cli.main(["--port", "0"]) == 0
    assert seen == [(GC_THRESHOLD, True)]


class Clock:
    """A clock that is set by hand and advances by `look_s` at each reading."""

    def __init__(self, look_s: float = 0.0) -> None:
        self.now_s, self._look_s = 100.0, look_s

    def __call__(self) -> float:
        self.now_s += self._look_s
        return self.now_s


def test_garbage_is_collected_at_intervals_if_there_is_any() -> None:
    clock = Clock()
    with rare_collection():
        collector, first = GarbageCollector(clock), weakref.ref(Ring())
        create_garbage(2 * MIN_OBJECTS)
        # 1. Before the interval nothing is collected.
        clock.now_s += 0.9 * MIN_INTERVAL_S
        collector.run()
        assert first() is not None
        # 2. After 1.1 intervals it is.
        clock.now_s += 0.2 * MIN_INTERVAL_S
        collector.run()
        assert first() is None
        second = weakref.ref(Ring())
        # 3. The interval is over, but one ring is fewer than MIN_OBJECTS.
        clock.now_s += 2.0 * MIN_INTERVAL_S
        collector.run()
        assert second() is not None
        create_garbage(2 * MIN_OBJECTS)
        collector.run()
        assert second() is None


def test_collection_takes_at_most_a_hundredth_of_the_time() -> None:
    # Each collection takes 1 s on this clock: it is read once before and once after.
    clock, took_s = Clock(look_s=1.0), 1.0
    with rare_collection():
        collector = GarbageCollector(clock)
        clock.now_s += MIN_INTERVAL_S
        create_garbage(2 * MIN_OBJECTS)
        collector.run()
        first = weakref.ref(Ring())
        create_garbage(2 * MIN_OBJECTS)
        # Due after 100 times the duration of the last collection.
        clock.now_s += 0.9 * MIN_INTERVAL_RATIO * took_s
        collector.run()
        assert first() is not None
        clock.now_s += 0.2 * MIN_INTERVAL_RATIO * took_s
        collector.run()
        assert first() is None


def create_garbage(rings: int) -> None:
    """Create garbage that only a collection finds."""
    left = [Ring() for _ in range(rings)]
    left.clear()


async def test_a_daemon_collects_what_connections_leave(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(garbage, "MIN_INTERVAL_S", 0.01)
    with rare_collection():
        async with running_server() as server:
            client = await server.connect_client()
            first = weakref.ref(Ring())
            create_garbage(2 * MIN_OBJECTS)
            await client.ask("gs")
            async with asyncio.timeout(30):
                while first() is not None:
                    await asyncio.sleep(0.01)
