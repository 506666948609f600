"""Messages and requests of a page take tokens of a rate limit, and turns of the event loop like connections."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from typing import Any

import pytest

from nserver_emu.server.connection import FairScheduler, TokenBucket
from nserver_emu.server.handlers.table import Emulator
from nserver_emu.viewer import http_port
from nserver_emu.viewer.http_port import PageMessages, wait_for_rate
from tests.nserver_emu.server.wire_client import simulation
from tests.nserver_emu.viewer.page_client import serve_viewer


async def test_messages_beyond_the_rate_wait_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []

    async def sleep(seconds: float) -> None:
        waits.append(seconds)

    # Ten messages a second; the bucket holds five. The clock stands, so the sixth waits 1/10 s, the next 2/10 s.
    limit = TokenBucket(10, 5, 0.0)
    monkeypatch.setattr(http_port, "loop_time", lambda: 0.0)
    monkeypatch.setattr(asyncio, "sleep", sleep)
    for _ in range(8):
        await wait_for_rate(limit)
    assert waits == pytest.approx([0.1, 0.2, 0.3])
    await wait_for_rate(None)
    assert len(waits) == 3


async def test_a_message_waits_for_its_turn() -> None:
    scheduler, handled = FairScheduler(), list[str]()
    pages = [PageMessages(scheduler, handled.append, rate=0) for _ in range(3)]
    handling = [asyncio.create_task(page.handle(f"{number}")) for number, page in enumerate(pages)]
    await asyncio.sleep(0)
    assert handled == []
    await asyncio.gather(*handling)
    assert handled == ["0", "1", "2"]
    assert scheduler.served == 3


async def test_an_error_in_a_message_stops_no_other() -> None:
    def fail(_text: str) -> None:
        raise RuntimeError("of a page")

    errors: list[dict[str, Any]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _loop, context: errors.append(context))
    scheduler, handled = FairScheduler(), list[str]()
    bad, good = PageMessages(scheduler, fail, rate=0), PageMessages(scheduler, handled.append, rate=0)
    await asyncio.gather(bad.handle("bad"), good.handle("good"))
    assert [str(context["exception"]) for context in errors] == ["of a page"]
    assert handled == ["good"]


async def test_all_messages_and_requests_take_tokens(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[TokenBucket | None] = []

    async def counted(limit: TokenBucket | None) -> None:
        taken.append(limit)

    monkeypatch.setattr(http_port, "wait_for_rate", counted)
    async with serve_viewer(Emulator(simulation())) as here:
        here.daemon.admission.limits = replace(here.daemon.admission.limits, page_rate=300)
        for _ in range(5):
            await here.web.get(f"{here.origin}/favicon.ico")
        assert taken == [taken[0]] * 5, "one limit for the address"
        async with here.page() as page:
            taken.clear()
            messages: dict[str, Any] = {"do": "call", "robot": 1, "call": "st", "args": []}
            for number in range(1, 11):
                await page.send_message(id=number, **messages)
            for number in range(1, 11):
                assert (await page.answer(number))["ok"]
            assert len(taken) >= 10
            assert len(set(map(id, taken))) == 1, "one limit for the page"
        here.daemon.admission.limits = replace(here.daemon.admission.limits, page_rate=0)
        taken.clear()
        await here.web.get(f"{here.origin}/favicon.ico")
        assert taken == [None]


async def test_limits_of_addresses_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nserver_emu.viewer.http_port.MAX_RATE_LIMITS", 3)
    async with serve_viewer(Emulator(simulation())) as here:
        admission = here.viewer_server._port.admission
        assert admission is not None
        for number in range(20):
            assert admission.rate_limit(f"10.0.0.{number}", 0.0) is not None
        assert len(admission._rate_limits) <= 3
