"""A connection that is closed is gone at once: it does not wait for Python to look for garbage, which is seldom."""

from __future__ import annotations

import asyncio
import gc
import weakref

import pytest

from nclient.faults.plan import Delay, Plan, Rule
from nserver_emu.server.connection import ConnectionHandler, TcpConnection
from tests.nserver_emu.server.running_server import running_server


@pytest.mark.long
@pytest.mark.parametrize("faults", [False, True])
@pytest.mark.parametrize("talks", [False, True])
async def test_nothing_of_it_is_left(talks: bool, faults: bool) -> None:
    plan = Plan((Rule("late", (Delay(0.001),), commands=("gs",)),))

    gc.collect()
    gc.disable()
    try:
        async with running_server() as server:
            if faults:
                server.daemon.faults.put(plan, server.daemon.lines())
            client = await (server.connect_client() if talks else server.open_client())
            if talks:
                await client.ask("gs")
            while not server.daemon.connections:
                await asyncio.sleep(0.005)
            gone: list[weakref.ref[ConnectionHandler]] = [weakref.ref(one) for one in server.daemon.connections]
            assert [type(one()) for one in gone] == [TcpConnection]
            client.writer.close()
            async with asyncio.timeout(30):
                while any(one() for one in gone):
                    await asyncio.sleep(0.01)
    finally:
        gc.enable()
